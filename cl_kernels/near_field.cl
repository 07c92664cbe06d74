// Which columns of each listed tile have a notable share in the sum of a row:
//
//     e_ij > limit_i,   limit_i = log2(threshold) + log2 of about the sum of row i,
//
// with e_ij as row_loop.cl has it, for at least one row i of a work-group. Later sums leave the other columns
// out (MASKED), and the host bounds what these hold by their number and the threshold.
//
// Where a work-item has a vector of rows for itself, a bound comes first: with the rows' box [low, high],
// and w for which limit_i - w . u_i hardly depends on i, no e_ij - limit_i of a column exceeds
//
//     h_j' + sum_d max(low_d z_d, high_d z_d) - min_i (limit_i - w . u_i),   z = k (v - (p - q)) - w,
//
// where h_j' is e_ij at u_i = 0.
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

// Columns that are looked at together. Where a work-item has a vector of rows for itself, a bound of WIDTH
// columns over the box of these rows comes first.
#define BOUNDS_FIRST (GROUP == 1 && WIDTH > 1)
#if BOUNDS_FIRST
#define STEP WIDTH
#else
#define STEP (TILE < 32 ? TILE : 32)
#endif

// Bits of the columns first + j, 0 <= j < STEP, whose exponent is above a limit in one of WIDTH rows. Each
// lane collects its own, because it takes longer to ask for each column whether any lane is above the limit.
INLINE ulong columns_above(
    const ereal* u, const __local staged_real* staged, const uint first, const vreal limit)
{
    vint of_lanes = 0;
#pragma unroll
    for (uint j = 0; j < STEP; ++j) {
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

#if BOUNDS_FIRST
// The box of WIDTH rows, u_i, and the least of their limits, from which slopes . u_i is taken: limits are
// close to linear in u.
typedef struct {
    float low[DIM], high[DIM], slopes[DIM];
    float least;
} rows_box;

INLINE float extreme(const vreal v, const float sign)
{
    float lanes[WIDTH];
    VSTORE(sign * v, 0, lanes);
    float most = lanes[0];
    for (int lane = 1; lane < WIDTH; ++lane)
        most = max(most, lanes[lane]);
    return sign * most;
}

#define BOX_ROUNDING 9.5367432e-7f // 2^-20: of sums of 2 DIM + 2 terms, relative to the sum of their sizes

INLINE void set_box(const ereal* u, const vreal limit, const __global float* slopes, rows_box* box)
{
    vreal rest = limit;
    vreal size = fabs(limit);
    for (int d = 0; d < DIM; ++d) {
        const vreal own = e_nearest(u[d]);
        box->slopes[d] = slopes[d];
        box->low[d] = extreme(own, -1.0f);
        box->high[d] = extreme(own, 1.0f);
        rest -= slopes[d] * own;
        size += fabs(slopes[d] * own);
    }
    box->least = extreme(rest - BOX_ROUNDING * size, -1.0f);
}

// Whether one of the columns first + j, 0 <= j < WIDTH, may be above the limit of one of the rows.
INLINE int may_be_above(const rows_box* box, const __local staged_real* staged, const uint first)
{
    vreal bound = VLOAD(0, staged + DIM * STAGED_ROW + first);
    vreal size = fabs(bound);
#pragma unroll
    for (int d = 0; d < DIM; ++d) {
        const vreal slope = VLOAD(0, staged + d * STAGED_ROW + first) - box->slopes[d];
        const vreal most = max(slope * box->low[d], slope * box->high[d]);
        bound += most;
        size += fabs(most);
    }
    return ANY(bound + BOX_ROUNDING * size > box->least);
}
#endif

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
    const __global float* restrict row_slopes, // (row tiles, DIM) of limits, for bounds
    __global ushort* restrict counts,          // (n_listed, GROUPS_OF_TILE) bits of each mask
    __global ulong* restrict column_masks)     // (n_listed, GROUPS_OF_TILE, MASK_WORDS)
{
    __local ulong of_items[GROUP];
    BLOCK_SETUP;
    vreal limits[BLOCKS];
    for (int block = 0; block < BLOCKS; ++block)
        limits[block] = VLOAD(BLOCK_ROW(block), row_limits);
#if BOUNDS_FIRST
    rows_box boxes[BLOCKS];
    for (int block = 0; block < BLOCKS; ++block)
        set_box(u[block], limits[block], row_slopes + row_tile * DIM, &boxes[block]);
#endif
    for (uint n = first_tile; n < end_tile; ++n) {
        STAGE_TILE(n);
        for (int block = 0; block < BLOCKS; ++block) {
            const size_t place = (size_t)n * GROUPS_OF_TILE + GROUP_OF_TILE(block);
            uint count = 0;
            for (uint w = 0; w < MASK_WORDS; ++w) {
                ulong bits = 0;
                for (uint c = 0; c < (TILE < 64 ? TILE : 64); c += STEP) {
#if BOUNDS_FIRST
                    if (!may_be_above(&boxes[block], staged, 64 * w + c))
                        continue;
#endif
                    bits |= columns_above(u[block], staged, 64 * w + c, limits[block]) << c;
                }
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
