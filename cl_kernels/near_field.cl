// What each listed column tile has in the sums of a row tile, as a share of the rows' sums:
//
//     share_iq = sum_j 2^(e_ij + offset_i) over the columns j of tile q,
//
// with e_ij as row_loop.cl has it, and 2^(-offset_i) about the whole sum of row i. The host leaves out
// tiles with small shares, and knows what they hold.
//
// Launch: as in row_loop.cl.
//
// -D LISTED         must be 1
// -D LARGEST_SHARE  log2 of the largest share that is told from larger ones

#include "row_loop.cl"
#include "sums.cl"

#if !LISTED
#error "LISTED must be 1: shares are those of listed tiles"
#endif
#ifndef LARGEST_SHARE
#error "LARGEST_SHARE (log2 of the largest share that measure_tiles tells apart) must be given"
#endif

// Largest of the WIDTH * GROUP lanes of a work-group, for the first work-item.
static inline float largest_lane(const vreal values, __local float* of_items)
{
    float lanes[WIDTH];
    VSTORE(values, 0, lanes);
    float largest = lanes[0];
    for (int lane = 1; lane < WIDTH; ++lane)
        largest = max(largest, lanes[lane]);
#if GROUP > 1
    of_items[get_local_id(0)] = largest;
    GROUP_BARRIER();
    if (get_local_id(0) == 0)
        for (int item = 1; item < GROUP; ++item)
            largest = max(largest, of_items[item]);
#endif
    return largest;
}

// Log2 of the largest share that a column of each listed tile has in the sum of a row, as far as
// these are known: 2^(-offset_i) is about the sum of row i. Without exponentials, unlike measure_tiles.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void largest_shares(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_offsets, // (n_rows,) of this launch
    __global float* restrict log2_shares)       // (work-groups of a row tile, n_listed)
{
    __local float of_items[GROUP];
    ROW_SETUP;
    const uint part = (row - row_tile * TILE) / (GROUP * WIDTH);
    const vreal offset = VLOAD(local_row, row_offsets);
    for (uint n = first_tile; n < end_tile; ++n) {
        STAGE_TILE(n);
        vreal m = (vreal)(SENTINEL);
        for (uint j = 0; j < TILE; j += UNROLL) {
#pragma unroll
            for (int c = 0; c < UNROLL; ++c)
                m = max(m, e_nearest(exponent(u, staged, j + c)));
        }
        const float largest = largest_lane(m + offset, of_items);
        if (get_local_id(0) == 0)
            log2_shares[(size_t)part * n_listed + n] = largest;
    }
}

// The sums of log_sum_exp, and the largest share that each listed tile as a whole has in one.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void measure_tiles(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_offsets, // (n_rows,) of this launch
    __global float* restrict maxima,            // (n_rows,)
    __global float* restrict sums,              // (n_rows,)
    __global float* restrict shares)            // (work-groups of a row tile, n_listed)
{
    __local float of_items[GROUP];
    ROW_SETUP;
    const uint part = (row - row_tile * TILE) / (GROUP * WIDTH);
    const vreal offset = VLOAD(local_row, row_offsets);
    vreal m = tiles_before ? VLOAD(local_row, maxima) : (vreal)(0.5f * SENTINEL);
    vreal s = tiles_before ? VLOAD(local_row, sums) : (vreal)(0.0f);
    for (uint n = first_tile; n < end_tile; ++n) {
        STAGE_TILE(n);
        const vreal s_tile = add_tile(u, staged, &m, &s);
        s += s_tile;
        // Above LARGEST_SHARE the host keeps the tile; its product with a sum is still finite.
        const vreal share = s_tile * exp2_nonpositive(min(m + offset, (vreal)((float)LARGEST_SHARE)));
        const float largest = largest_lane(share, of_items);
        if (get_local_id(0) == 0)
            shares[(size_t)part * n_listed + n] = largest;
    }
    VSTORE(m, local_row, maxima);
    VSTORE(s, local_row, sums);
}
