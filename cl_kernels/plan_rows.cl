// Reductions over the rows of the transport plan (Eq. 2),
//
//     log2 pi_ij = e_ij + offset_i,
//
// with e_ij as row_loop.cl has it: pairs above a threshold, first and second moments of each row, and
// columns drawn from each row. The host chooses the row offsets: those of the plan itself, or those that
// make every row sum to 1.
//
// Launch: as in row_loop.cl. Row offsets come as two float32: the nearest, and what that rounds off.

#include "row_loop.cl"

// log2 pi_ij = e_ij + offset_i; a small number where pi_ij matters, unlike both its terms.
static inline vreal log2_plan(const ereal e, const vreal offset, const vreal offset_low)
{
    return e_above(e, -offset) + offset_low;
}

// A pair is kept when its log2 pi_ij exceeds the smaller of its row's and its column's
// threshold.
#define KEEP(log2_pi) ((log2_pi) > min(row_threshold, (vreal)(column_thresholds[q * TILE + j])))

// Number of kept pairs of each row.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void count_plan_rows(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_offsets,       // (2, row_stride)
    const __global float* restrict row_thresholds,    // (row_stride,)
    const __global float* restrict column_thresholds, // (column_stride,)
    __global int* restrict counts)                    // (n_rows,) of this launch
{
    ROW_SETUP;
    const vreal offset = VLOAD(row, row_offsets);
    const vreal offset_low = VLOAD((size_t)row_stride + row, row_offsets);
    const vreal row_threshold = VLOAD(row, row_thresholds);
    vreal count = (vreal)(0.0f); // exact: a cloud has at most 2^24 points
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = STAGE_TILE(n);
        for (uint j = 0; j < TILE; ++j)
            count += select((vreal)(0.0f), (vreal)(1.0f),
                            KEEP(log2_plan(exponent(u, staged, j), offset, offset_low)));
    }
    VSTORE(CONVERT_VINT(count), local_row, counts);
}

// Column index and log2 pi_ij of the kept pairs, each row at its own place.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void fill_plan_rows(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_offsets,       // (2, row_stride)
    const __global float* restrict row_thresholds,    // (row_stride,)
    const __global float* restrict column_thresholds, // (column_stride,)
    const __global uint* restrict starts,             // (n_rows,) first slot of each row
    const uint step,                                  // from one slot of a row to the next
    __global int* restrict columns,                   // (slots of this launch,)
    __global float* restrict log2_masses)             // (slots of this launch,)
{
    ROW_SETUP;
    const vreal offset = VLOAD(row, row_offsets);
    const vreal offset_low = VLOAD((size_t)row_stride + row, row_offsets);
    const vreal row_threshold = VLOAD(row, row_thresholds);
    uint slot[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane)
        slot[lane] = starts[local_row + lane];
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = STAGE_TILE(n);
        for (uint j = 0; j < TILE; ++j) {
            const vreal log2_pi = log2_plan(exponent(u, staged, j), offset, offset_low);
            const vint keep = KEEP(log2_pi);
            if (ANY(keep)) {
                float log2_pi_lane[WIDTH];
                int keep_lane[WIDTH];
                VSTORE(log2_pi, 0, log2_pi_lane);
                VSTORE(keep, 0, keep_lane);
                for (int lane = 0; lane < WIDTH; ++lane) {
                    if (keep_lane[lane]) {
                        columns[slot[lane]] = q * TILE + j;
                        log2_masses[slot[lane]] = log2_pi_lane[lane];
                        slot[lane] += step;
                    }
                }
            }
        }
    }
}

// Sum, first and second moments of each plan row, relative to its tile's center p:
// with w_j = pi_ij / (the row's mass) the sums of w, w z and w z z^T, z = k (Y_j - p).
#define MOMENTS (1 + DIM + DIM * (DIM + 1) / 2)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void plan_moments(
    CLOUD_ARGUMENTS,
    const uint n_rows,
    const __global float* restrict row_offsets, // (2, row_stride): log2 w_j = e_ij + offset_i
    __global float* restrict moments)           // (MOMENTS, n_rows) of this launch
{
    ROW_SETUP;
    const vreal offset = VLOAD(row, row_offsets);
    const vreal offset_low = VLOAD((size_t)row_stride + row, row_offsets);
    vreal total[MOMENTS];
    for (int m = 0; m < MOMENTS; ++m)
        total[m] = (vreal)(0.0f);
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = STAGE_TILE(n);
        vreal of_tile[MOMENTS];
        for (int m = 0; m < MOMENTS; ++m)
            of_tile[m] = (vreal)(0.0f);
        for (uint j = 0; j < TILE; ++j) {
            const vreal w =
                exp2_nonpositive(log2_plan(exponent(u, staged, j), offset, offset_low));
            of_tile[0] += w;
            int m = 1;
#pragma unroll
            for (int d = 0; d < DIM; ++d) {
                const vreal wz = w * (float)staged[d * TILE + j];
                of_tile[m++] += wz;
#pragma unroll
                for (int e = 0; e <= d; ++e)
                    of_tile[m++] += wz * (float)staged[e * TILE + j];
            }
        }
        for (int m = 0; m < MOMENTS; ++m)
            total[m] += of_tile[m];
    }
    for (int m = 0; m < MOMENTS; ++m)
        VSTORE(total[m], (size_t)m * n_rows + local_row, moments);
}

// Columns drawn from each plan row: the first whose running sum of w_j exceeds each of the
// row's thresholds, which ascend.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void sample_plan_rows(
    CLOUD_ARGUMENTS,
    const uint n_draws,
    const __global float* restrict row_offsets, // (2, row_stride): log2 w_j = e_ij + offset_i
    const __global float* restrict thresholds,  // (n_rows, n_draws), in [0, 1)
    __global int* restrict draws)               // (n_rows, n_draws), filled with -1 before
{
    ROW_SETUP;
    const vreal offset = VLOAD(row, row_offsets);
    const vreal offset_low = VLOAD((size_t)row_stride + row, row_offsets);
    float next[WIDTH];
    uint drawn[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane) {
        drawn[lane] = 0;
        next[lane] = thresholds[(size_t)(local_row + lane) * n_draws];
    }
    vreal limit = VLOAD(0, next);
    vreal before = (vreal)(0.0f); // sum over the tiles so far; their sums round less
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = STAGE_TILE(n);
        vreal of_tile = (vreal)(0.0f);
        for (uint j = 0; j < TILE; ++j) {
            of_tile += exp2_nonpositive(log2_plan(exponent(u, staged, j), offset, offset_low));
            const vreal sum = before + of_tile;
            if (ANY(sum > limit)) {
                float sum_lane[WIDTH];
                VSTORE(sum, 0, sum_lane);
                for (int lane = 0; lane < WIDTH; ++lane) {
                    while (sum_lane[lane] > next[lane]) {
                        const size_t first = (size_t)(local_row + lane) * n_draws;
                        draws[first + drawn[lane]] = q * TILE + j;
                        ++drawn[lane];
                        // 3: more than any sum
                        next[lane] = drawn[lane] < n_draws ? thresholds[first + drawn[lane]] : 3.0f;
                    }
                }
                limit = VLOAD(0, next);
            }
        }
        before += of_tile;
    }
}
