// The loop over the column tiles of every row, which log_sum_exp.cl, barycentric_projection.cl,
// near_field.cl, plan_rows.cl and plan_shares.cl share. It streams over the columns of the log-kernel
//
//     e_ij = log2(e) * [ (g_j - C_ij) / epsilon + log b_j ] - (a constant of row i),
//     C_ij = |X_i - Y_j|^2 / 2  (paper, Eq. 1, with the factor 1/2),
//
// without an N x M array. Points come sorted into compact tiles of TILE; with p, q the
// centers of i's and j's tiles, u = X_i - p, v = Y_j - q and k = log2(e) / epsilon,
//
//     e_ij = level_pq + h_j + k u.(v - (p - q)) + k [(p - q).v - |v|^2 / 2]:
//
// level_pq holds the large numbers and is formed in float64, on the host or by tile_levels.cl, so float32
// adds only small ones; exponents.cl has wider arithmetic where that is not enough. The
// row's own -k |u|^2 / 2 and the level's offset are constants of the row and are added
// on the host as well.
//
// A kernel takes CLOUD_ARGUMENTS and some of its own, and reads
//
//     ROW_SETUP;
//     ...
//     for (uint n = first_tile; n < end_tile; ++n) {
//         const uint q = STAGE_TILE(n);
//         ... exponent(u, staged, j) for 0 <= j < TILE: e_ij of WIDTH rows, column q * TILE + j
//     }
//
// Launch: get_global_id(0) is a group of WIDTH consecutive rows, WIDTH * GROUP divides TILE. In kernels that
// read BLOCK_SETUP in place of ROW_SETUP it is BLOCKS such groups. A launch covers rows
// [first_row, first_row + n_rows): row tiles from first_row / TILE on. Of the column tiles of each row it
// takes those after `tiles_before`, `most_tiles` at most: what a kernel has found in launches over the tiles
// before, it reads from its own results.
//
// Units: coordinates in any unit, costs and potentials in that unit squared, k in its inverse;
// exponents, levels and column logits h in powers of two (log2), as are row offsets.
//
// -D DIM     dimension of the points; or
// -D SLICE   coordinates that are staged at once, of points whose dimension is an argument of the kernel. The
//            exponents of a tile of columns are then formed first, as a product of matrices, slice by slice, so
//            that neither local memory nor registers limit the dimension.
// -D TILE    points of one tile, a multiple of WIDTH * GROUP
// -D GROUP   work-items of a work-group along dimension 0
// -D STACKS  work-items along dimension 1 of a work-group, in kernels that read SHARE_SETUP: each has a share
//            of the column tiles, and they meet at the same barriers (speed only). 1 in others.
// -D UNROLL  columns taken together in the inner loop, divides TILE (speed only)
// -D BLOCKS  groups of WIDTH rows that a work-item takes one after the other with the same staged columns,
//            in kernels that read BLOCK_SETUP; WIDTH * GROUP * BLOCKS divides TILE (speed only). 1 in others.
// -D PRECISE arithmetic of the exponents, and PLANES of their inputs: see exponents.cl
// -D LISTED  0: rows see all column tiles; 1: those listed for their own tile, the
//            levels in the list's order
// -D MASKED  1: of the listed tiles, a work-group sees only the columns whose bits are set in the kernel's
//            argument `column_masks`, (pairs, GROUPS_OF_TILE, MASK_WORDS), from pair `first_masked` of the list
//            on: see take_column.
// A file that defines TOPS 1, for exponents in float32, learns of each staged tile how large these get: see
// largest_exponents.

#include "common.cl"

#ifdef SLICE
#define DIM dimension
#define DIMENSION_ARGUMENT const uint dimension,
#define STAGED_COORDINATES (SLICE + 1) // the last row holds what sums in the row before have rounded off
#define ROW_NUMBERS (TILE + MASKED) // exponents of a row; with MASKED also that of the column without mass
#else
#ifndef DIM
#error "DIM (dimension of the points) or SLICE must be given"
#endif
#define DIMENSION_ARGUMENT
#define STAGED_COORDINATES DIM
#define ROW_NUMBERS DIM // coordinates of a row
#endif
#if !defined(TILE) || !defined(GROUP) || !defined(STACKS) || !defined(UNROLL) \
    || !defined(BLOCKS) || !defined(PRECISE) || !defined(LISTED) || !defined(MASKED)
#error "TILE, GROUP, STACKS, UNROLL, BLOCKS, PRECISE, LISTED and MASKED must be given, see above"
#endif
#if MASKED && !LISTED
#error "MASKED needs LISTED: masks are those of listed tiles"
#endif

#ifndef TOPS
#define TOPS 0
#endif

#define GROUPS_OF_TILE (TILE / (GROUP * WIDTH)) // groups of rows of a tile, which have a mask each
#define MASK_WORDS ((TILE + 63) / 64)           // words of 64 bits, one for each column of a tile
#if TILE > 64 && TILE % 64
#error "TILE must be a multiple of 64 if it is larger: a mask has whole words"
#endif
#define ALL_COLUMNS (~0ul >> (TILE < 64 ? 64 - TILE : 0))

#include "exponents.cl"

// A work-group of one needs no barrier, and CPU compilers vectorize better without.
#if GROUP * STACKS > 1
#define GROUP_BARRIER() barrier(CLK_LOCAL_MEM_FENCE)
#else
#define GROUP_BARRIER()
#endif

#define CLOUD_ARGUMENTS                                                                        \
    const uint first_row, const uint row_stride, const uint column_stride,                     \
    const uint n_column_tiles, const uint tiles_before, const uint most_tiles,                 \
    const float k, const float k_low, DIMENSION_ARGUMENT                                       \
    const __global float* restrict row_shifts,        /* (PLANES, DIM, row_stride): u */       \
    const __global float* restrict row_centers,       /* (row_stride / TILE, DIM): p */        \
    const __global float* restrict column_shifts,     /* (PLANES, DIM, column_stride): v */    \
    const __global float* restrict column_centers,    /* (n_column_tiles, DIM): q */           \
    const __global float* restrict column_logits,     /* (PLANES, column_stride): h */           \
    const __global float* restrict levels             /* see below */                          \
    LIST_ARGUMENTS

// Column tiles of a row tile: q = TILE_AT(n) for OWN_FIRST <= n < OWN_END. Levels are
// (row tiles, PLANES, n_column_tiles), or (PLANES, n_listed).
#if LISTED
#define LIST_ARGUMENTS                                                                         \
    , const uint n_listed,                                                                     \
    const __global uint* restrict list_starts,        /* (row tiles + 1,) */                   \
    const __global uint* restrict listed              /* (n_listed,) */
#define OWN_FIRST list_starts[row_tile]
#define OWN_END list_starts[row_tile + 1]
#define TILE_AT(n) listed[n]
#define OWN_LEVELS levels
#define LEVEL_PLANE n_listed
#else
#define LIST_ARGUMENTS
#define OWN_FIRST 0
#define OWN_END n_column_tiles
#define TILE_AT(n) (n)
#define OWN_LEVELS (levels + (size_t)(row_tile - first_row / TILE) * n_column_tiles * PLANES)
#define LEVEL_PLANE n_column_tiles
#endif

// The column tiles of a share, n_begin <= n < n_end, where get_global_id(1) is its number. All work-items of a
// group take per_share steps, so that they meet at the barriers of the last ones too.
#define SHARE_SETUP                                                                            \
    const uint share = get_global_id(1);                                                       \
    const uint shares = get_global_size(1);                                                    \
    const uint per_share = (end_tile - first_tile + shares - 1) / shares;                      \
    const uint n_begin = min(end_tile, first_tile + share * per_share);                        \
    const uint n_end = min(end_tile, n_begin + per_share)

// The first of the WIDTH rows of a work-item's block, counted from the first row of the launch; and the number
// of the block's group of rows among those of the tile.
#define BLOCK_ROW(block) (((get_group_id(0) * BLOCKS + (block)) * GROUP + get_local_id(0)) * WIDTH)
#define GROUP_OF_TILE(block) ((get_group_id(0) * BLOCKS + (block)) % GROUPS_OF_TILE)

#if TOPS
// Each work-item leaves the largest top of its columns j: level_pq + h_j + k (p - q).v_j.
#define TOPS_ARGUMENT , __local float* tops

INLINE float largest_lane(const vreal v)
{
    float lanes[WIDTH];
    VSTORE(v, 0, lanes);
    float largest = lanes[0];
#pragma unroll
    for (int l = 1; l < WIDTH; ++l)
        largest = fmax(largest, lanes[l]);
    return largest;
}
#else
#define TOPS_ARGUMENT
#endif

#ifndef SLICE
// Put column tile q, recentered for the row tile, into local memory:
// staged[d][j] = k (v - (p - q))_d for d < DIM, staged[DIM][j] = the part without u.
// The first barrier waits for the readers of the tile before, the last one for the writers.
// Returns q.
INLINE uint stage_columns(
    const uint q, const uint row_tile, const uint column_stride, const uint level_plane,
    const ereal k, const __global float* row_centers,
    const __global float* column_shifts, const __global float* column_centers,
    const __global float* column_logits, const __global float* level,
    __local staged_real* staged TOPS_ARGUMENT)
{
    GROUP_BARRIER();
#if TOPS
    vreal top = (vreal)(-INFINITY);
#endif
    ereal shift[DIM];
    for (int d = 0; d < DIM; ++d)
        shift[d] = e_sum(e_constant(row_centers[row_tile * DIM + d], 0.0f),
                         e_constant(-column_centers[q * DIM + d], 0.0f));
    const ereal level_pq = e_constant(level[0], level[(PLANES - 1) * level_plane]);
    for (uint j = get_local_id(0) * WIDTH; j < TILE; j += GROUP * WIDTH) {
        ereal quadratic = e_constant(0.0f, 0.0f);
#if TOPS
        vreal along = (vreal)(0.0f);
#endif
        for (int d = 0; d < DIM; ++d) {
            const ereal v = e_load(column_shifts + (size_t)d * column_stride + q * TILE + j,
                                   (size_t)DIM * column_stride);
            const ereal half_v = e_product(e_constant(-0.5f, 0.0f), v);
            quadratic = e_sum(quadratic, e_product(v, e_sum(shift[d], half_v)));
#if TOPS
            along += v * shift[d];
#endif
            e_stage(e_product(k, e_sum(v, e_negative(shift[d]))), staged + d * STAGED_ROW + j);
        }
        const ereal h = e_load(column_logits + q * TILE + j, column_stride);
        const ereal level = e_sum(h, level_pq);
        e_stage(e_sum(level, e_product(k, quadratic)), staged + DIM * STAGED_ROW + j);
#if TOPS
        top = max(top, level + k * along);
#endif
    }
#if TOPS
    tops[get_local_id(0)] = largest_lane(top);
#endif
    GROUP_BARRIER();
    return q;
}

INLINE void load_rows(
    const __global float* row_shifts, const uint row_stride, const uint row, ereal* u)
{
    for (int d = 0; d < DIM; ++d)
        u[d] = e_load(row_shifts + (size_t)d * row_stride + row, (size_t)DIM * row_stride);
}
#else
#if !PRECISE
// What a + b rounds off (Knuth).
INLINE vreal lost_in_sum(const vreal a, const vreal b)
{
    const vreal sum = a + b;
    const vreal added = sum - a;
    return (a - (sum - added)) + (b - added);
}
#endif

// Put `count` coordinates of column tile q, from `first` on, into local memory, as stage_columns does, and add
// their share of (p - q).v - |v|^2 / 2 to staged[SLICE][j].
INLINE void stage_slice(
    const uint first, const uint count, const uint q, const uint row_tile, const uint dimension,
    const uint column_stride, const ereal k, const __global float* row_centers,
    const __global float* column_shifts, const __global float* column_centers,
    __local staged_real* staged)
{
    GROUP_BARRIER();
    for (uint j = get_local_id(0) * WIDTH; j < TILE; j += GROUP * WIDTH) {
        ereal quadratic = e_constant(0.0f, 0.0f);
        for (uint d = 0; d < count; ++d) {
            const ereal shift = e_sum(e_constant(row_centers[row_tile * dimension + first + d], 0.0f),
                                      e_constant(-column_centers[q * dimension + first + d], 0.0f));
            const ereal v = e_load(column_shifts + (size_t)(first + d) * column_stride + q * TILE + j,
                                   (size_t)dimension * column_stride);
            const ereal half_v = e_product(e_constant(-0.5f, 0.0f), v);
            quadratic = e_sum(quadratic, e_product(v, e_sum(shift, half_v)));
            e_stage(e_product(k, e_sum(v, e_negative(shift))), staged + d * STAGED_ROW + j);
        }
        __local staged_real* sum = staged + SLICE * STAGED_ROW + j;
#if PRECISE
        e_stage(first ? e_sum(quadratic, e_unstage(sum)) : quadratic, sum);
#else
        __local staged_real* lost = sum + STAGED_ROW;
        const ereal before = first ? e_unstage(sum) : (ereal)(0.0f);
        e_stage((first ? e_unstage(lost) : (ereal)(0.0f)) + lost_in_sum(before, quadratic), lost);
        e_stage(before + quadratic, sum);
#endif
    }
    GROUP_BARRIER();
}

// Columns whose exponents are formed together.
#define DOT_COLUMNS (UNROLL < 8 ? UNROLL : 8)
// Slices whose sums are added up in float32 before they join the total.
#define RUN 8

// The exponents e_ij of all columns j of tile q, for `blocks` groups of WIDTH rows: u[block][j]. Products are
// added up in each slice, and slices in runs, so that long sums round less. Returns q.
INLINE uint stage_exponents(
    const uint q, const uint row_tile, const uint row, const int blocks, const uint dimension,
    const uint row_stride, const uint column_stride, const uint level_plane, const ereal k,
    const __global float* row_shifts, const __global float* row_centers,
    const __global float* column_shifts, const __global float* column_centers,
    const __global float* column_logits, const __global float* level,
    __local staged_real* staged, ereal* u)
{
    for (int i = 0; i < blocks * ROW_NUMBERS; ++i)
        u[i] = e_constant(0.0f, 0.0f);
#if !PRECISE
    ereal runs[BLOCKS * ROW_NUMBERS];
    for (int i = 0; dimension > RUN * SLICE && i < blocks * ROW_NUMBERS; ++i)
        runs[i] = u[i];
#endif
    for (uint first = 0; first < dimension; first += SLICE) {
        const uint count = min((uint)SLICE, dimension - first);
        stage_slice(first, count, q, row_tile, dimension, column_stride, k, row_centers, column_shifts,
                    column_centers, staged);
        for (int block = 0; block < blocks; ++block) {
            ereal own[SLICE];
            for (uint d = 0; d < count; ++d)
                own[d] = e_load(row_shifts + (size_t)(first + d) * row_stride + row + block * (GROUP * WIDTH),
                                (size_t)dimension * row_stride);
            for (uint j = 0; j < TILE; j += DOT_COLUMNS) {
                ereal even[DOT_COLUMNS], odd[DOT_COLUMNS];
#pragma unroll
                for (int c = 0; c < DOT_COLUMNS; ++c)
                    even[c] = odd[c] = e_constant(0.0f, 0.0f);
                uint d = 0;
                for (; d + 1 < count; d += 2) {
#pragma unroll
                    for (int c = 0; c < DOT_COLUMNS; ++c) {
                        const __local staged_real* column = staged + d * STAGED_ROW + j + c;
                        even[c] = e_sum(even[c], e_product(own[d], e_staged(column)));
                        odd[c] = e_sum(odd[c], e_product(own[d + 1], e_staged(column + STAGED_ROW)));
                    }
                }
                if (d < count) {
#pragma unroll
                    for (int c = 0; c < DOT_COLUMNS; ++c)
                        even[c] = e_sum(even[c], e_product(own[d], e_staged(staged + d * STAGED_ROW + j + c)));
                }
#pragma unroll
                for (int c = 0; c < DOT_COLUMNS; ++c)
                    u[block * ROW_NUMBERS + j + c] =
                        e_sum(u[block * ROW_NUMBERS + j + c], e_sum(even[c], odd[c]));
            }
        }
#if !PRECISE
        for (int i = 0; dimension > RUN * SLICE && (first / SLICE) % RUN == RUN - 1
                        && i < blocks * ROW_NUMBERS; ++i) {
            runs[i] += u[i];
            u[i] = (ereal)(0.0f);
        }
#endif
    }
#if !PRECISE
    for (int i = 0; dimension > RUN * SLICE && i < blocks * ROW_NUMBERS; ++i)
        u[i] += runs[i];
#endif
    const ereal level_pq = e_constant(level[0], level[(PLANES - 1) * level_plane]);
    for (uint j = get_local_id(0) * WIDTH; j < TILE; j += GROUP * WIDTH) {
        __local staged_real* rest = staged + SLICE * STAGED_ROW + j;
        const ereal h = e_load(column_logits + q * TILE + j, column_stride);
        const ereal known = e_sum(h, level_pq);
        const ereal scaled = e_product(k, e_unstage(rest));
#if !PRECISE
        // With what is rounded off: it would be much of the error, as this term and the product cancel.
        const ereal lost = fma(k, e_unstage(rest), -scaled) + k * e_unstage(rest + STAGED_ROW);
        e_stage(lost + lost_in_sum(h, level_pq) + lost_in_sum(known, scaled), rest + STAGED_ROW);
#endif
        e_stage(e_sum(known, scaled), rest);
    }
    GROUP_BARRIER();
    for (int block = 0; block < blocks; ++block) {
        for (uint j = 0; j < TILE; ++j) {
            const __local staged_real* rest = staged + SLICE * STAGED_ROW + j;
            u[block * ROW_NUMBERS + j] = e_sum(u[block * ROW_NUMBERS + j], e_staged(rest));
#if !PRECISE
            u[block * ROW_NUMBERS + j] += e_staged(rest + STAGED_ROW);
#endif
        }
        for (uint j = TILE; j < ROW_NUMBERS; ++j) // the column without mass
            u[block * ROW_NUMBERS + j] = e_constant(SENTINEL, 0.0f);
    }
    return q;
}
#endif

// The staged tile of each stack. What the stacks read at once are different banks of local memory. Cards read
// 16 bytes at a time.
#define ALIGNED __attribute__((aligned(16)))
#if STACKS == 1
#define STAGED_TILE __local staged_real staged[STAGED_SIZE] ALIGNED
#else
#define STAGED_STRIDE (STAGED_SIZE + 16 / (int)sizeof(staged_real))
#define STAGED_TILE                                                                            \
    __local staged_real of_stacks[STACKS * STAGED_STRIDE] ALIGNED;                             \
    __local staged_real* staged = of_stacks + get_local_id(1) * STAGED_STRIDE
#endif

// What a work-item knows before the loop: its rows and their tile, the launch's column tiles, and u of
// its rows.
#define TILE_SETUP(row)                                                                        \
    STAGED_TILE;                                                                               \
    const uint row_tile = (row) / TILE;                                                        \
    const uint first_tile = min(OWN_FIRST + tiles_before, (uint)(OWN_END));                    \
    const uint end_tile = min(first_tile + most_tiles, (uint)(OWN_END));                       \
    const __global float* own_levels = OWN_LEVELS
#define ROW_SETUP                                                                              \
    const uint local_row = get_global_id(0) * WIDTH;                                           \
    const uint row = first_row + local_row;                                                    \
    TILE_SETUP(row);                                                                           \
    ereal u[ROW_NUMBERS];                                                                      \
    OWN_ROWS(u, u, row, 1)

// The same, with u of BLOCKS blocks of rows. With SLICE one loop forms the exponents of all blocks, and so they
// are one array.
#ifdef SLICE
#define ROWS_OF_BLOCKS                                                                         \
    ereal of_blocks[BLOCKS * ROW_NUMBERS];                                                     \
    ereal(*const u)[ROW_NUMBERS] = (ereal(*)[ROW_NUMBERS])of_blocks
#else
#define ROWS_OF_BLOCKS ereal u[BLOCKS][ROW_NUMBERS]
#endif
#define BLOCK_SETUP                                                                            \
    TILE_SETUP(first_row + BLOCK_ROW(0));                                                      \
    ROWS_OF_BLOCKS;                                                                            \
    OWN_ROWS(of_blocks, u[block], first_row + BLOCK_ROW(0), BLOCKS)

#if TOPS
#define STAGED_TOPS __local float tops[STACKS * GROUP]
#define TOPS_OF_STACK , tops + get_local_id(1) * GROUP

// Bounds of the exponents of rows over the staged tile q, because
//
//     e_ij = level_pq + h_j + k (p - q).v_j - k u_i.(p - q) + k |u_i|^2 / 2 - k |u_i - v_j|^2 / 2,
//
// from `own` = k |u_i|^2 / 2. They are above what rounding in float32 makes of exponents.
INLINE vreal largest_exponents(
    const ereal* u, const vreal own, const uint q, const uint row_tile, const float k,
    const __global float* row_centers, const __global float* column_centers,
    const __local float* tops)
{
    const float rounding = 1e-6f * (DIM + 8);
    float top = tops[0];
#pragma unroll
    for (uint item = 1; item < GROUP; ++item)
        top = fmax(top, tops[item]);
    vreal projected = (vreal)(0.0f);
    float squares = 0.0f;
    for (int d = 0; d < DIM; ++d) {
        const float shift = row_centers[row_tile * DIM + d] - column_centers[q * DIM + d];
        projected += u[d] * shift;
        squares += shift * shift;
    }
    return own * (1.0f + rounding) - projected * k + (top + rounding * (fabs(top) + k * squares));
}
#else
#define TOPS_OF_STACK
#endif

// Stage the n-th column tile of the row tile, and return its number. With SLICE this puts the tile's exponents
// into u, which holds the rows' coordinates otherwise.
#ifdef SLICE
#define OWN_ROWS(all, of_block, row, blocks)                                                   \
    ereal* const own_exponents = all;                                                          \
    const uint own_row = row;                                                                  \
    const int own_blocks = blocks
#define STAGE_TILE(n)                                                                          \
    stage_exponents(TILE_AT(n), row_tile, own_row, own_blocks, dimension, row_stride,          \
                    column_stride, LEVEL_PLANE, e_constant(k, k_low), row_shifts, row_centers, \
                    column_shifts, column_centers, column_logits, own_levels + (n), staged,    \
                    own_exponents)
#define STAGE_SLICE(q, first, count)                                                           \
    stage_slice(first, count, q, row_tile, dimension, column_stride, e_constant(k, k_low),     \
                row_centers, column_shifts, column_centers, staged)
#else
#define OWN_ROWS(all, of_block, row, blocks)                                                   \
    for (int block = 0; block < blocks; ++block)                                               \
        load_rows(row_shifts, row_stride, row + block * (GROUP * WIDTH), of_block)
#define STAGE_TILE(n)                                                                          \
    stage_columns(TILE_AT(n), row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),      \
                  row_centers, column_shifts, column_centers, column_logits,                   \
                  own_levels + (n), staged TOPS_OF_STACK)
#endif

#if MASKED
// The mask of the n-th column tile for a block.
#define OWN_MASK(n, block)                                                                     \
    (column_masks                                                                              \
     + ((size_t)((n) - first_masked) * GROUPS_OF_TILE + GROUP_OF_TILE(block)) * MASK_WORDS)

// Whether no column of a listed tile is needed, or all are: the same for all work-items of a group.
INLINE bool is_empty(const __global ulong* mask)
{
    ulong bits = 0;
    for (int w = 0; w < MASK_WORDS; ++w)
        bits |= mask[w];
    return !bits;
}

INLINE bool is_full(const __global ulong* mask)
{
    ulong bits = ALL_COLUMNS;
    for (int w = 0; w < MASK_WORDS; ++w)
        bits &= mask[w];
    return bits == ALL_COLUMNS;
}

#define IS_EMPTY(n, block) is_empty(OWN_MASK(n, block))
#define MASK_ARGUMENTS                                                                         \
    , const __global ulong* restrict column_masks, /* (pairs, GROUPS_OF_TILE, MASK_WORDS) */   \
    const uint first_masked                        /* the listed pair of the first mask */
#define LOWEST_BIT(bits) (63u - (uint)clz((bits) & -(bits)))
// A loop over the needed columns j of a tile, one by one.
#define FOR_COLUMNS(mask, j)                                                                   \
    for (uint word = 0; word < MASK_WORDS; ++word)                                             \
        for (ulong bits = (mask)[word], j;                                                     \
             bits && (j = 64u * word + LOWEST_BIT(bits), true); bits &= bits - 1ul)

// The column of the lowest bit of a word of a mask. The bit is cleared. Without a bit it is the column that
// has no mass.
INLINE uint take_column(ulong* bits, const uint first)
{
    const uint j = *bits ? first + LOWEST_BIT(*bits) : TILE;
    *bits &= *bits - 1ul;
    return j;
}

// Stage the column without mass. No tile overwrites it.
INLINE void stage_empty_column(__local staged_real* staged)
{
#ifndef SLICE
    if (get_local_id(0) == 0) {
        for (int i = 0; i < STAGED_PLANES * (DIM + 1); ++i)
            staged[i * STAGED_ROW + TILE] = i == DIM ? SENTINEL : 0;
    }
#endif
}
#else
#define OWN_MASK(n, block) 0
#define IS_EMPTY(n, block) false
#define MASK_ARGUMENTS
#define FOR_COLUMNS(mask, j) for (uint j = 0; j < TILE; ++j)
#endif

// e_ij + offset_i, such as log2 of a mass pi_ij of the plan: a small number where it matters, unlike both
// its terms. Offsets, (2, row_stride), come as two float32: the nearest, and what that rounds off.
#define OFFSET_SETUP                                                                           \
    const vreal offset = VLOAD(row, row_offsets);                                              \
    const vreal offset_low = VLOAD((size_t)row_stride + row, row_offsets)
#define WITH_OFFSET(e) (e_above(e, -offset) + offset_low)
