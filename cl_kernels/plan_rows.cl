// The pairs of the transport plan (Eq. 2) above a threshold: how many each row has, and their columns
// and masses,
//
//     log2 pi_ij = e_ij + offset_i,
//
// with e_ij as row_loop.cl has it, and a row offset that the host chooses.
//
// Launch: as in row_loop.cl. Row offsets come as two float32: the nearest, and what that rounds off.

#include "row_loop.cl"

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
    OFFSET_SETUP;
    const vreal row_threshold = VLOAD(row, row_thresholds);
    vint count = tiles_before ? VLOAD(local_row, counts) : (vint)(0);
    for (uint n = first_tile; n < end_tile; ++n) {
        const uint q = STAGE_TILE(n);
        for (uint j = 0; j < TILE; ++j)
            count += select((vint)(0), (vint)(1),
                            KEEP(WITH_OFFSET(exponent(u, staged, j))));
    }
    VSTORE(count, local_row, counts);
}

// Column index and log2 pi_ij of the kept pairs, each row at its own place.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void fill_plan_rows(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_offsets,       // (2, row_stride)
    const __global float* restrict row_thresholds,    // (row_stride,)
    const __global float* restrict column_thresholds, // (column_stride,)
    __global uint* restrict slots,                    // (n_rows,) next slot of each row
    const uint step,                                  // from one slot of a row to the next
    __global int* restrict columns,                   // (slots of this launch,)
    __global float* restrict log2_masses)             // (slots of this launch,)
{
    ROW_SETUP;
    OFFSET_SETUP;
    const vreal row_threshold = VLOAD(row, row_thresholds);
    uint slot[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane)
        slot[lane] = slots[local_row + lane];
    for (uint n = first_tile; n < end_tile; ++n) {
        const uint q = STAGE_TILE(n);
        for (uint j = 0; j < TILE; ++j) {
            const vreal log2_pi = WITH_OFFSET(exponent(u, staged, j));
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
    for (int lane = 0; lane < WIDTH; ++lane)
        slots[local_row + lane] = slot[lane];
}
