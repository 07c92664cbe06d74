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
// where h_j' is e_ij at u_i = 0. Most pairs of tiles hold no such column, so another bound comes first, before
// the tile is staged: that of a box of columns, low <= v <= high. With column slopes a, for which
// h_j - k a . v_j hardly depends on j, and s = u + (p - q) + a,
//
//     e_ij - w . u_i <= level_pq + max_j (h_j - k a . v_j)
//                       + sum_d max over u_d, v_d of  k v_d (s_d - v_d / 2) - u_d (k (p - q) + w)_d.
//
// In each dimension the largest term is at an end of the rows' box, and there at the v_d nearest to s_d.
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

// Boxes of columns: a tile has WIDTH of them, of BOX columns each.
#define BOX (TILE / WIDTH)
#define BOXES_ROUNDING 3.8146973e-6f // 2^-18: of e_ij and its bound, DIM + 2 terms of up to 8 operations

// What the bounds of the boxes of a column tile have in common for all rows of a row tile.
typedef struct {
    float shift[DIM]; // (p - q) + a
    float rest[DIM];  // k (p - q) + w
    vreal bound;      // level_pq + max_j (h_j - k a . v_j) of each box, and the bound's rounding error
} columns_frame;

INLINE void set_frame(
    const __global float* row_center, const __global float* row_slope, const float* row_sides,
    const __global float* column_center, const __global float* column_slope, const __global float* column_sides,
    const float k, const float level, const vreal most, columns_frame* frame)
{
    vreal size = fabs(level) + fabs(most);
    for (int d = 0; d < DIM; ++d) {
        const float between = row_center[d] - column_center[d];
        const float slope = column_slope[d];
        frame->shift[d] = between + slope;
        frame->rest[d] = k * between + row_slope[d];
        const float sides = row_sides[d] + fabs(between) + fabs(slope) + column_sides[d];
        size += k * sides * sides + 2.0f * row_sides[d] * fabs(row_slope[d]);
    }
    frame->bound = level + most + BOXES_ROUNDING * size;
}

// The largest term of one dimension for rows at u: at the v nearest to s = u + shift.
INLINE vreal largest_term(
    const float u, const float shift, const float rest, const float k, const vreal low, const vreal high)
{
    const float s = u + shift;
    const vreal v = clamp((vreal)s, low, high);
    return k * v * (s - 0.5f * v) - u * rest;
}

// Bits of the boxes that may hold a column above the limit of one of the rows.
INLINE uint boxes_above(
    const rows_box* rows, const columns_frame* frame, const float k, const __global float* lows,
    const __global float* highs, const size_t stride)
{
    vreal bound = frame->bound;
#pragma unroll
    for (int d = 0; d < DIM; ++d) {
        const vreal low = VLOAD(0, lows + d * stride);
        const vreal high = VLOAD(0, highs + d * stride);
        bound += max(largest_term(rows->low[d], frame->shift[d], frame->rest[d], k, low, high),
                     largest_term(rows->high[d], frame->shift[d], frame->rest[d], k, low, high));
    }
    const vint above = ~IS_TRUE(bound <= rows->least); // also where it is no number
    if (!ANY(above))
        return 0;
    int lanes[WIDTH];
    VSTORE(above, 0, lanes);
    uint bits = 0;
    for (int lane = 0; lane < WIDTH; ++lane)
        bits |= lanes[lane] ? 1u << lane : 0u;
    return bits;
}

// Bits of the boxes that hold the columns first + j, 0 <= j < STEP.
#define BOXES_OF(first) ((2u << (((first) + STEP - 1) / BOX)) - (1u << ((first) / BOX)))
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
    const __global float* restrict row_slopes, // (row tiles, DIM) of limits, for bounds, as all up to `counts`
    const __global float* restrict box_lows,   // (DIM, column tiles * WIDTH) of v in each box
    const __global float* restrict box_highs,  // (DIM, column tiles * WIDTH)
    const __global float* restrict box_most,   // (column tiles * WIDTH,) largest h_j - k a . v_j
    const __global float* restrict column_slopes, // (column tiles, DIM): a
    const __global float* restrict column_sides,  // (column tiles, DIM) largest |v|
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
    float row_sides[DIM];
    for (int d = 0; d < DIM; ++d) {
        row_sides[d] = 0.0f;
        for (int block = 0; block < BLOCKS; ++block)
            row_sides[d] = max(row_sides[d], max(-boxes[block].low[d], boxes[block].high[d]));
    }
#endif
    for (uint n = first_tile; n < end_tile; ++n) {
#if BOUNDS_FIRST
        const uint q = TILE_AT(n);
        columns_frame frame;
        set_frame(row_centers + row_tile * DIM, row_slopes + row_tile * DIM, row_sides,
                  column_centers + q * DIM, column_slopes + q * DIM, column_sides + q * DIM, k,
                  own_levels[n], VLOAD(0, box_most + (size_t)q * WIDTH), &frame);
        uint possible[BLOCKS];
        uint of_any = 0;
        for (int block = 0; block < BLOCKS; ++block) {
            possible[block] = boxes_above(&boxes[block], &frame, k, box_lows + (size_t)q * WIDTH,
                                          box_highs + (size_t)q * WIDTH, (size_t)n_column_tiles * WIDTH);
            of_any |= possible[block];
        }
        if (of_any)
#endif
            STAGE_TILE(n);
        for (int block = 0; block < BLOCKS; ++block) {
            const size_t place = (size_t)n * GROUPS_OF_TILE + GROUP_OF_TILE(block);
            uint count = 0;
            for (uint w = 0; w < MASK_WORDS; ++w) {
                ulong bits = 0;
                for (uint c = 0; c < (TILE < 64 ? TILE : 64); c += STEP) {
#if BOUNDS_FIRST
                    if (!(possible[block] & BOXES_OF(64 * w + c))
                        || !may_be_above(&boxes[block], staged, 64 * w + c))
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
