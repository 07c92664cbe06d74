// Which columns of each listed tile have a notable share in the sum of a row:
//
//     e_ij > limit_i,   limit_i = log2(threshold) + log2 of about the sum of row i,
//
// with e_ij as row_loop.cl has it, for at least one row i of a work-group. Later sums leave the other columns
// out (MASKED), and the host bounds what these hold by their number and the threshold.
//
// Launch: as in row_loop.cl.
//
// -D LISTED        must be 1
// -D MANY_EIGHTHS  a mask with more than this many eighths of its bits gets all of them (speed only)

#include "row_loop.cl"

#if !LISTED
#error "LISTED must be 1: columns are those of listed tiles"
#endif
#ifndef MANY_EIGHTHS
#define MANY_EIGHTHS 5 // then all columns take less time, without a look at bits
#endif

// A comparison is 1 for a scalar, and has all bits in each lane of a vector.
#if WIDTH == 1
#define IS_TRUE(comparison) (-(comparison))
#else
#define IS_TRUE(comparison) (comparison)
#endif

// Bits of the columns first + j, 0 <= j < 32, whose exponent is above a limit in one of WIDTH rows. Each lane
// collects its own, because it takes longer to ask for each column whether any lane is above the limit.
INLINE ulong columns_above(
    const ereal* u, const __local staged_real* staged, const uint first, const vreal limit)
{
    vint of_lanes = 0;
#pragma unroll
    for (uint j = 0; j < (TILE < 32 ? TILE : 32); ++j) {
        const vint above = IS_TRUE(e_nearest(exponent(u, staged, first + j)) > limit);
        of_lanes |= above & (vint)(1 << j);
    }
#if WIDTH == 1
    return (uint)of_lanes;
#else
    int lanes[WIDTH];
    VSTORE(of_lanes, 0, lanes);
    uint bits = 0;
    for (int lane = 0; lane < WIDTH; ++lane)
        bits |= (uint)lanes[lane];
    return bits;
#endif
}

// The union of the bits of a group's work-items, for the first of them.
INLINE ulong united(const ulong bits, __local ulong* of_items)
{
#if GROUP > 1
    GROUP_BARRIER();
    of_items[get_local_id(0)] = bits;
    GROUP_BARRIER();
    ulong all = bits;
    if (get_local_id(0) == 0)
        for (int item = 1; item < GROUP; ++item)
            all |= of_items[item];
    return all;
#else
    return bits;
#endif
}

// Bit j of a listed tile's mask: whether column j is notable.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void mark_columns(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_limits, // (n_rows,) of this launch
    __global ushort* restrict counts,          // (n_listed, GROUPS_OF_TILE) bits of each mask
    __global ulong* restrict column_masks)     // (n_listed, GROUPS_OF_TILE, MASK_WORDS)
{
    __local ulong of_items[GROUP];
    BLOCK_SETUP;
    vreal limits[BLOCKS];
    for (int block = 0; block < BLOCKS; ++block)
        limits[block] = VLOAD(BLOCK_ROW(block), row_limits);
    for (uint n = first_tile; n < end_tile; ++n) {
        STAGE_TILE(n);
        for (int block = 0; block < BLOCKS; ++block) {
            const size_t place = (size_t)n * GROUPS_OF_TILE + GROUP_OF_TILE(block);
            uint count = 0;
            for (uint w = 0; w < MASK_WORDS; ++w) {
                ulong bits = columns_above(u[block], staged, 64 * w, limits[block]);
                if (TILE >= 64)
                    bits |= columns_above(u[block], staged, 64 * w + 32, limits[block]) << 32;
                bits = united(bits, of_items);
                if (8 * (int)popcount(bits) > MANY_EIGHTHS * (TILE < 64 ? TILE : 64))
                    bits = ALL_COLUMNS;
                count += popcount(bits);
                if (get_local_id(0) == 0)
                    column_masks[place * MASK_WORDS + w] = bits;
            }
            if (get_local_id(0) == 0)
                counts[place] = count;
        }
    }
}
