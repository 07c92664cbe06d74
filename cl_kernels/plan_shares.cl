// Moments of each row of the transport plan, and columns drawn from it, by the shares
//
//     w_j = pi_ij / (pi 1)_i = 2^(e_ij + offset_i),   sum_j w_j = 1,
//
// with e_ij as row_loop.cl has it, and a row offset that the host chooses.
//
// Launch: as in row_loop.cl. Row offsets come as two float32: the nearest, and what that rounds off.

#include "row_loop.cl"

// Sum, first and second moments of each plan row, relative to its tile's center p:
// with w_j = pi_ij / (the row's mass) the sums of w, w z and w z z^T, z = k (Y_j - p).
#define MOMENTS (1 + DIM + DIM * (DIM + 1) / 2)
#define MOMENT_AT(number) ((size_t)(number) * n_rows + local_row)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void plan_moments(
    CLOUD_ARGUMENTS
    MASK_ARGUMENTS,
    const uint n_rows,
    const __global float* restrict row_offsets, // (2, row_stride): log2 w_j = e_ij + offset_i
    __global float* restrict moments)           // (MOMENTS, n_rows) of this launch
{
    ROW_SETUP;
    OFFSET_SETUP;
#ifdef SLICE
    // Moments stand in global memory, and columns are staged again, slice by slice, to be added to them.
    if (!tiles_before)
        for (uint m = 0; m < MOMENTS; ++m)
            VSTORE((vreal)(0.0f), MOMENT_AT(m), moments);
    for (uint n = first_tile; n < end_tile; ++n) {
        if (IS_EMPTY(n, 0))
            continue;
        const uint q = STAGE_TILE(n);
        vreal w[TILE];
        for (uint j = 0; j < TILE; ++j)
            w[j] = (vreal)(0.0f);
        vreal of_tile = (vreal)(0.0f);
        FOR_COLUMNS(OWN_MASK(n, 0), j)
        {
            w[j] = exp2_nonpositive(WITH_OFFSET(u[j]));
            of_tile += w[j];
        }
        VSTORE(VLOAD(MOMENT_AT(0), moments) + of_tile, MOMENT_AT(0), moments);
        for (uint first = 0; first < DIM; first += SLICE) {
            const uint count = min((uint)SLICE, DIM - first);
            STAGE_SLICE(q, first, count);
            for (uint i = 0; i < count; ++i) {
                const size_t d = first + i;
                const size_t own = 1 + d * (d + 3) / 2; // of w z_d, before those of w z_d z_e
                vreal wz[TILE];
                vreal sum = (vreal)(0.0f);
                for (uint j = 0; j < TILE; ++j) {
                    wz[j] = w[j] * (float)staged[i * STAGED_ROW + j];
                    sum += wz[j];
                }
                VSTORE(VLOAD(MOMENT_AT(own), moments) + sum, MOMENT_AT(own), moments);
                for (uint e = 0; e <= d; ++e) {
                    const float shift = row_centers[row_tile * DIM + e] - column_centers[q * DIM + e];
                    const __global float* v = column_shifts + (size_t)e * column_stride + q * TILE;
                    sum = (vreal)(0.0f);
                    for (uint j = 0; j < TILE; ++j)
                        sum += wz[j] * (k * (v[j] - shift));
                    VSTORE(VLOAD(MOMENT_AT(own + 1 + e), moments) + sum, MOMENT_AT(own + 1 + e), moments);
                }
            }
        }
    }
#else
    vreal total[MOMENTS];
    for (int m = 0; m < MOMENTS; ++m)
        total[m] = tiles_before ? VLOAD((size_t)m * n_rows + local_row, moments) : (vreal)(0.0f);
    for (uint n = first_tile; n < end_tile; ++n) {
        if (IS_EMPTY(n, 0))
            continue;
        STAGE_TILE(n);
        vreal of_tile[MOMENTS];
        for (int m = 0; m < MOMENTS; ++m)
            of_tile[m] = (vreal)(0.0f);
        FOR_COLUMNS(OWN_MASK(n, 0), j)
        {
            const vreal w =
                exp2_nonpositive(WITH_OFFSET(exponent(u, staged, j)));
            of_tile[0] += w;
            int m = 1;
#pragma unroll
            for (int d = 0; d < DIM; ++d) {
                const vreal wz = w * (float)staged[d * STAGED_ROW + j];
                of_tile[m++] += wz;
#pragma unroll
                for (int e = 0; e <= d; ++e)
                    of_tile[m++] += wz * (float)staged[e * STAGED_ROW + j];
            }
        }
        for (int m = 0; m < MOMENTS; ++m)
            total[m] += of_tile[m];
    }
    for (int m = 0; m < MOMENTS; ++m)
        VSTORE(total[m], (size_t)m * n_rows + local_row, moments);
#endif
}

// Columns drawn from each plan row: the first whose running sum of w_j exceeds each of the
// row's thresholds, which ascend.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void sample_plan_rows(
    CLOUD_ARGUMENTS
    MASK_ARGUMENTS,
    const uint n_draws,
    const __global float* restrict row_offsets, // (2, row_stride): log2 w_j = e_ij + offset_i
    const __global float* restrict thresholds,  // (n_rows, n_draws), in [0, 1)
    __global int* restrict draws,               // (n_rows, n_draws), filled with -1 before
    __global uint* restrict counts,             // (n_rows,) draws so far
    __global float* restrict sums)              // (n_rows,) of w_j so far
{
    ROW_SETUP;
    OFFSET_SETUP;
    float next[WIDTH];
    uint drawn[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane) {
        drawn[lane] = counts[local_row + lane];
        // 3: more than any sum
        next[lane] = drawn[lane] < n_draws
            ? thresholds[(size_t)(local_row + lane) * n_draws + drawn[lane]] : 3.0f;
    }
    vreal limit = VLOAD(0, next);
    vreal before = VLOAD(local_row, sums); // sum over the tiles so far; their sums round less
    for (uint n = first_tile; n < end_tile; ++n) {
        if (IS_EMPTY(n, 0))
            continue;
        const uint q = STAGE_TILE(n);
        vreal of_tile = (vreal)(0.0f);
        FOR_COLUMNS(OWN_MASK(n, 0), j)
        {
            of_tile += exp2_nonpositive(WITH_OFFSET(exponent(u, staged, j)));
            const vreal sum = before + of_tile;
            if (ANY(sum > limit)) {
                float sum_lane[WIDTH];
                VSTORE(sum, 0, sum_lane);
                for (int lane = 0; lane < WIDTH; ++lane) {
                    // Never more than n_draws, whatever the sum: offsets may be wrong.
                    while (drawn[lane] < n_draws && sum_lane[lane] > next[lane]) {
                        const size_t first = (size_t)(local_row + lane) * n_draws;
                        draws[first + drawn[lane]] = q * TILE + j;
                        ++drawn[lane];
                        next[lane] = drawn[lane] < n_draws ? thresholds[first + drawn[lane]] : 3.0f;
                    }
                }
                limit = VLOAD(0, next);
            }
        }
        before += of_tile;
    }
    VSTORE(before, local_row, sums);
    for (int lane = 0; lane < WIDTH; ++lane)
        counts[local_row + lane] = drawn[lane];
}
