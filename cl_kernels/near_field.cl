// Which pairs of tiles, and which columns of each listed tile, have a notable share in the sum of a row.
//
// bound_tiles: upper bounds of the logarithms (base 2) of the shares of column tiles in the sums of row tiles,
//
//     B = A' - r + sum_d k (h |p - q + w| + H (|p - q - a| + h) - (p - q)^2 / 2)
//
// with the half sides h and H of both tiles' boxes, the slopes w and a, and A' = A + k |a|^2 / 2, as in
// clmorph/backends/opencl/kernels/tile_pairs.py, which proves it. The host decides what to do with the bounds.
// A block is a few consecutive row tiles with one list of column tiles.
// Launch: get_global_id(0) is a group of WIDTH consecutive entries of a list, get_global_id(1) a block.
//
// mark_columns: the columns of each listed tile with
//
//     e_ij > limit_i,   limit_i = log2(threshold) + log2 of about the sum of row i,
//
// with e_ij as row_loop.cl has it, for at least one row i of a work-group. Later sums leave the other columns
// out (MASKED), and the host bounds what these hold by their number and the threshold.
//
// Where a work-item has a vector of rows for itself, bounds over these rows come first: column_boxes.cl.
//
// Launch: as in row_loop.cl.
//
// -D LISTED  must be 1

#include "row_loop.cl"

#if !LISTED
#error "LISTED must be 1: columns are those of listed tiles"
#endif
// Rounding of B, relative to the sum of its terms' sizes: half a square has 3, its place in the sums 4 + DIM.
#define BOUND_ROUNDING ((DIM + 12) * 5.9604645e-8f) // 2^-24 for each of them, and a reserve
#define BOUND_TERMS (3 * DIM + 1) // center, half sides and slopes of a tile, and its level: -r or A'
#define BLOCK_ROWS 8              // largest number of row tiles of a block
#define ROW_OF_BLOCK(row) min(first + (row), n_rows - 1)

// One number of each of WIDTH tiles.
INLINE vreal gathered(const __global float* plane, const uint* tiles)
{
    float lanes[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane)
        lanes[lane] = plane[tiles[lane]];
    return VLOAD(0, lanes);
}

__kernel void bound_tiles(
    const uint n_rows,                            // row tiles
    const uint n_columns,                         // column tiles
    const uint block_rows,                        // row tiles of a block, but for the last one
    const uint first_block,                       // of this launch
    const float k, DIMENSION_ARGUMENT
    const __global float* restrict row_terms,     // (n_rows, BOUND_TERMS)
    const __global float* restrict column_terms,  // (BOUND_TERMS, n_columns)
    const __global uint* restrict lists,          // (blocks, 3): begin, length, and place of the first bound
    const __global uint* restrict numbers,        // of column tiles: all lists
    __global float* restrict bounds)              // of each block, (its row tiles, length of its list)
{
    const __global uint* list = lists + 3 * get_global_id(1);
    const uint length = list[1];
    const uint place = get_global_id(0) * WIDTH;
    if (place >= length)
        return;
    uint tiles[WIDTH];
    for (uint lane = 0; lane < WIDTH; ++lane)
        tiles[lane] = numbers[list[0] + min(place + lane, length - 1)];
    const uint first = (first_block + get_global_id(1)) * block_rows;
    const vreal level = gathered(column_terms + (size_t)(3 * DIM) * n_columns, tiles);
    vreal bound[BLOCK_ROWS], size[BLOCK_ROWS];
#pragma unroll
    for (uint row = 0; row < BLOCK_ROWS; ++row) {
        const float own = row_terms[(size_t)ROW_OF_BLOCK(row) * BOUND_TERMS + 3 * DIM];
        bound[row] = level + own;
        size[row] = fabs(level) + fabs(own);
    }
    for (uint d = 0; d < DIM; ++d) {
        const vreal q = gathered(column_terms + (size_t)d * n_columns, tiles);
        const vreal sides = gathered(column_terms + (size_t)(DIM + d) * n_columns, tiles);
        const vreal slopes = gathered(column_terms + (size_t)(2 * DIM + d) * n_columns, tiles);
#pragma unroll
        for (uint row = 0; row < BLOCK_ROWS; ++row) {
            const __global float* own = row_terms + (size_t)ROW_OF_BLOCK(row) * BOUND_TERMS;
            const float half_side = own[DIM + d];
            const float slope = own[2 * DIM + d];
            const vreal between = own[d] - q;
            const vreal half_square = 0.5f * between * between;
            const vreal reach = half_side * fabs(between + slope)
                + sides * (fabs(between - slopes) + half_side);
            bound[row] += k * (reach - half_square);
            size[row] += k * (half_side * (fabs(between) + fabs(slope))
                              + sides * (fabs(between) + fabs(slopes) + half_side) + half_square);
        }
    }
#pragma unroll
    for (uint row = 0; row < BLOCK_ROWS; ++row) {
        if (row >= min(block_rows, n_rows - first))
            break;
        const vreal bounded = bound[row] + BOUND_ROUNDING * size[row];
        __global float* to = bounds + list[2] + (size_t)row * length + place;
        if (place + WIDTH <= length) {
            VSTORE(bounded, 0, to);
        } else {
            float lanes[WIDTH];
            VSTORE(bounded, 0, lanes);
            for (uint lane = 0; lane < length - place; ++lane)
                to[lane] = lanes[lane];
        }
    }
}

// A comparison is 1 for a scalar, and has all bits in each lane of a vector.
#if WIDTH == 1
#define IS_TRUE(comparison) (-(comparison))
#else
#define IS_TRUE(comparison) (comparison)
#endif

// Columns that are looked at together. Where a work-item has a vector of rows for itself, a bound of WIDTH
// columns over the box of these rows comes first.
#ifdef SLICE
#define BOUNDS_FIRST 0
#else
#define BOUNDS_FIRST (GROUP == 1 && WIDTH > 1)
#endif
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
#include "column_boxes.cl"
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
    const uint many_eighths, // a mask with more than so many eighths of its bits gets all, for speed
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
                if (8 * (uint)popcount(bits) > many_eighths * (TILE < 64 ? TILE : 64))
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
