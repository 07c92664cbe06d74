// Streaming reductions over the columns of every row of the log-kernel
//
//     e_ij = log2(e) * [ (g_j - C_ij) / epsilon + log b_j ] - (a constant of row i),
//     C_ij = |X_i - Y_j|^2 / 2,
//
// without an N x M array. Points come sorted into compact tiles of TILE; with p, q the
// centers of i's and j's tiles, u = X_i - p, v = Y_j - q and k = log2(e) / epsilon,
//
//     e_ij = level_pq + h_j + k u.(v - (p - q)) + k [(p - q).v - |v|^2 / 2]:
//
// level_pq holds the large numbers and is formed in float64 on the host, so float32
// adds only small ones; exponents.cl has wider arithmetic where that is not enough. The
// row's own -k |u|^2 / 2 and the level's offset are constants of the row and are added
// on the host as well.
//
// Launch: get_global_id(0) is a group of WIDTH consecutive rows, WIDTH * GROUP divides
// TILE; get_global_id(1) is a share of the column tiles (log_sum_exp only). A launch
// covers rows [first_row, first_row + n_rows): row tiles from first_row / TILE on.
//
// -D DIM     dimension of the points
// -D TILE    points of one tile, a multiple of WIDTH * GROUP
// -D GROUP   work-items of a work-group along dimension 0
// -D UNROLL  columns taken together in the inner loop, divides TILE (speed only)
// -D PRECISE arithmetic of the exponents, and PLANES of their inputs: see exponents.cl
// -D BOUNDED 1: nothing but log_sum_exp, with powers and sums that have a bound: see sums.cl
// -D LISTED  0 (default): rows see all column tiles; 1: those listed for their own tile, the
//            levels in the list's order

#include "common.cl"

#ifndef DIM
#error "DIM (dimension of the points) must be given"
#endif
#ifndef TILE
#error "TILE (points of one tile) must be given"
#endif
#ifndef GROUP
#define GROUP 1 // a CPU core runs one work-item at a time
#endif
#ifndef UNROLL
#define UNROLL 8 // enough independent chains to hide the latency of a multiply-add
#endif

#ifndef LISTED
#define LISTED 0
#endif

#include "exponents.cl"
#include "sums.cl"

// A work-group of one needs no barrier, and CPU compilers vectorize better without.
#if GROUP > 1
#define GROUP_BARRIER() barrier(CLK_LOCAL_MEM_FENCE)
#else
#define GROUP_BARRIER()
#endif

#define CLOUD_ARGUMENTS                                                                        \
    const uint first_row, const uint row_stride, const uint column_stride,                     \
    const uint n_column_tiles, const float k, const float k_low,                               \
    const __global float* restrict row_offsets,       /* (PLANES, DIM, row_stride): u */       \
    const __global float* restrict row_centers,       /* (row_stride / TILE, DIM): p */        \
    const __global float* restrict column_offsets,    /* (PLANES, DIM, column_stride): v */    \
    const __global float* restrict column_centers,    /* (n_column_tiles, DIM): q */           \
    const __global float* restrict column_potentials, /* (PLANES, column_stride): h */         \
    const __global float* restrict levels             /* see below */                          \
    LIST_ARGUMENTS

// Column tiles of a row tile: q = TILE_AT(n) for FIRST_TILE <= n < END_TILE. Levels are
// (row tiles, PLANES, n_column_tiles), or (PLANES, n_listed).
#if LISTED
#define LIST_ARGUMENTS                                                                         \
    , const uint n_listed,                                                                     \
    const __global uint* restrict list_starts,        /* (row tiles of this launch + 1,) */    \
    const __global uint* restrict listed              /* (n_listed,) */
#define LIST_ROW (row_tile - first_row / TILE)
#define FIRST_TILE list_starts[LIST_ROW]
#define END_TILE list_starts[LIST_ROW + 1]
#define TILE_AT(n) listed[n]
#define OWN_LEVELS levels
#define LEVEL_PLANE n_listed
#else
#define LIST_ARGUMENTS
#define FIRST_TILE 0
#define END_TILE n_column_tiles
#define TILE_AT(n) (n)
#define OWN_LEVELS (levels + (row_tile - first_row / TILE) * n_column_tiles * PLANES)
#define LEVEL_PLANE n_column_tiles
#endif

// Put column tile q, recentered for the row tile, into local memory:
// staged[d][j] = k (v - (p - q))_d for d < DIM, staged[DIM][j] = the part without u.
static inline void stage_columns(
    const uint q, const uint row_tile, const uint column_stride, const uint level_plane,
    const ereal k, const __global float* row_centers,
    const __global float* column_offsets, const __global float* column_centers,
    const __global float* column_potentials, const __global float* level,
    __local staged_real* staged)
{
    ereal shift[DIM];
    for (int d = 0; d < DIM; ++d)
        shift[d] = e_sum(e_constant(row_centers[row_tile * DIM + d], 0.0f),
                         e_constant(-column_centers[q * DIM + d], 0.0f));
    const ereal level_pq = e_constant(level[0], level[(PLANES - 1) * level_plane]);
    for (uint j = get_local_id(0) * WIDTH; j < TILE; j += GROUP * WIDTH) {
        ereal quadratic = e_constant(0.0f, 0.0f);
        for (int d = 0; d < DIM; ++d) {
            const ereal v = e_load(column_offsets + (size_t)d * column_stride + q * TILE + j,
                                   (size_t)DIM * column_stride);
            const ereal half_v = e_product(e_constant(-0.5f, 0.0f), v);
            quadratic = e_sum(quadratic, e_product(v, e_sum(shift[d], half_v)));
            e_stage(e_product(k, e_sum(v, e_negative(shift[d]))), staged + d * TILE + j);
        }
        const ereal h = e_load(column_potentials + q * TILE + j, column_stride);
        e_stage(e_sum(e_sum(h, level_pq), e_product(k, quadratic)), staged + DIM * TILE + j);
    }
}

static inline void load_rows(
    const __global float* row_offsets, const uint row_stride, const uint row, ereal* u)
{
    for (int d = 0; d < DIM; ++d)
        u[d] = e_load(row_offsets + (size_t)d * row_stride + row, (size_t)DIM * row_stride);
}

// Add the staged columns to m = max_j reference_of(e_ij) and s = sum_j 2^(e_ij - m), but for the
// sum over these columns themselves, which is returned: sums of sums round less than one long sum.
static inline sreal add_tile(
    const ereal* u, const __local staged_real* staged, vreal* maximum, sreal* sum)
{
    vreal m = *maximum;
    sreal s = *sum;
    sreal s_tile = NO_SUM;
    for (uint j = 0; j < TILE; j += UNROLL) {
        ereal e[UNROLL];
        vreal m_new = m;
#pragma unroll
        for (int c = 0; c < UNROLL; ++c) {
            e[c] = exponent(u, staged, j + c);
            m_new = max(m_new, reference_of(e[c]));
        }
        s = rescaled(s, m - m_new);
        s_tile = rescaled(s_tile, m - m_new);
#pragma unroll
        for (int c = 0; c < UNROLL; ++c)
            s_tile = sum_of(s_tile, power_above(e[c], m_new));
        m = m_new;
    }
    *maximum = m;
    *sum = s;
    return s_tile;
}

// Online maximum m_i = max_j reference_of(e_ij) and s_i = sum_j 2^(e_ij - m_i), over the column tiles
// of this share; the host joins the shares.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void log_sum_exp(
    CLOUD_ARGUMENTS, const uint n_rows,
    __global float* restrict maxima, // (shares, n_rows)
    __global float* restrict sums)   // (SUM_PLANES, shares, n_rows)
{
    __local staged_real staged[STAGED_SIZE];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const __global float* own_levels = OWN_LEVELS;
    const uint share = get_global_id(1);
    const uint shares = get_global_size(1);
    const uint per_share = (END_TILE - FIRST_TILE + shares - 1) / shares;
    const uint n_begin = min((uint)(END_TILE), FIRST_TILE + share * per_share);
    const uint n_end = min((uint)(END_TILE), n_begin + per_share);

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    // Above columns without mass: the difference of two sentinels is no exponent.
    vreal m = (vreal)(0.5f * SENTINEL);
    sreal s = NO_SUM;
    for (uint n = n_begin; n < n_end; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        const sreal s_tile = add_tile(u, staged, &m, &s);
        s = sum_of(s, s_tile);
        GROUP_BARRIER();
    }
    VSTORE(m, (size_t)share * n_rows + local_row, maxima);
    store_sum(s, (size_t)share * n_rows + local_row, (size_t)shares * n_rows, sums);
}

#if !BOUNDED // the other kernels do without bounds
#if LISTED
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
// these are known: 2^(-base_i) is about the sum of row i. Without exponentials, unlike measure_tiles.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void largest_shares(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_bases,   // (n_rows,) of this launch
    __global float* restrict log2_shares)       // (work-groups of a row tile, n_listed)
{
    __local staged_real staged[STAGED_SIZE];
    __local float of_items[GROUP];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const uint part = (row - row_tile * TILE) / (GROUP * WIDTH);
    const __global float* own_levels = OWN_LEVELS;

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    const vreal base = VLOAD(local_row, row_bases);
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        vreal m = (vreal)(SENTINEL);
        for (uint j = 0; j < TILE; j += UNROLL) {
#pragma unroll
            for (int c = 0; c < UNROLL; ++c)
                m = max(m, e_nearest(exponent(u, staged, j + c)));
        }
        const float largest = largest_lane(m + base, of_items);
        if (get_local_id(0) == 0)
            log2_shares[(size_t)part * n_listed + n] = largest;
        GROUP_BARRIER();
    }
}

// The sums of log_sum_exp, and the largest share that each listed tile as a whole has in one.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void measure_tiles(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_bases,   // (n_rows,) of this launch
    __global float* restrict maxima,            // (n_rows,)
    __global float* restrict sums,              // (n_rows,)
    __global float* restrict shares)            // (work-groups of a row tile, n_listed)
{
    __local staged_real staged[STAGED_SIZE];
    __local float of_items[GROUP];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const uint part = (row - row_tile * TILE) / (GROUP * WIDTH);
    const __global float* own_levels = OWN_LEVELS;

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    const vreal base = VLOAD(local_row, row_bases);
    vreal m = (vreal)(0.5f * SENTINEL);
    vreal s = (vreal)(0.0f);
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        const vreal s_tile = add_tile(u, staged, &m, &s);
        s += s_tile;
        // Above LARGEST_SHARE the host keeps the tile; its product with a sum is still finite.
        const vreal share = s_tile * exp2_nonpositive(min(m + base, (vreal)((float)LARGEST_SHARE)));
        const float largest = largest_lane(share, of_items);
        if (get_local_id(0) == 0)
            shares[(size_t)part * n_listed + n] = largest;
        GROUP_BARRIER();
    }
    VSTORE(m, local_row, maxima);
    VSTORE(s, local_row, sums);
}
#endif

// log2 pi_ij = e_ij + base_i; a small number where pi_ij matters, unlike both its terms.
static inline vreal log2_plan(const ereal e, const vreal base, const vreal base_low)
{
    return e_above(e, -base) + base_low;
}

// A pair is kept when its log2 pi_ij exceeds the smaller of its row's and its column's
// threshold.
#define KEEP(log2_pi) ((log2_pi) > min(row_threshold, (vreal)(column_thresholds[q * TILE + j])))

// Number of kept pairs of each row.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void count_plan_rows(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_bases,         // (2, row_stride)
    const __global float* restrict row_thresholds,    // (row_stride,)
    const __global float* restrict column_thresholds, // (column_stride,)
    __global int* restrict counts)                    // (n_rows,) of this launch
{
    __local staged_real staged[STAGED_SIZE];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const __global float* own_levels = OWN_LEVELS;

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    const vreal base = VLOAD(row, row_bases);
    const vreal base_low = VLOAD((size_t)row_stride + row, row_bases);
    const vreal row_threshold = VLOAD(row, row_thresholds);
    vreal count = (vreal)(0.0f); // exact: a cloud has at most 2^24 points
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        for (uint j = 0; j < TILE; ++j)
            count += select((vreal)(0.0f), (vreal)(1.0f),
                            KEEP(log2_plan(exponent(u, staged, j), base, base_low)));
        GROUP_BARRIER();
    }
    VSTORE(CONVERT_VINT(count), local_row, counts);
}

// Column index and log2 pi_ij of the kept pairs, each row at its own place.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void fill_plan_rows(
    CLOUD_ARGUMENTS,
    const __global float* restrict row_bases,         // (2, row_stride)
    const __global float* restrict row_thresholds,    // (row_stride,)
    const __global float* restrict column_thresholds, // (column_stride,)
    const __global uint* restrict starts,             // (n_rows,) first slot of each row
    const uint step,                                  // from one slot of a row to the next
    __global int* restrict columns,                   // (slots of this launch,)
    __global float* restrict log2_masses)             // (slots of this launch,)
{
    __local staged_real staged[STAGED_SIZE];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const __global float* own_levels = OWN_LEVELS;

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    const vreal base = VLOAD(row, row_bases);
    const vreal base_low = VLOAD((size_t)row_stride + row, row_bases);
    const vreal row_threshold = VLOAD(row, row_thresholds);
    uint slot[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane)
        slot[lane] = starts[local_row + lane];
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        for (uint j = 0; j < TILE; ++j) {
            const vreal log2_pi = log2_plan(exponent(u, staged, j), base, base_low);
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
        GROUP_BARRIER();
    }
}

// Sum, first and second moments of each plan row, relative to its tile's center p:
// with w_j = pi_ij / (the row's mass) the sums of w, w z and w z z^T, z = k (Y_j - p).
#define MOMENTS (1 + DIM + DIM * (DIM + 1) / 2)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void plan_moments(
    CLOUD_ARGUMENTS,
    const uint n_rows,
    const __global float* restrict row_bases, // (2, row_stride): log2 w_j = e_ij + base_i
    __global float* restrict moments)         // (MOMENTS, n_rows) of this launch
{
    __local staged_real staged[STAGED_SIZE];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const __global float* own_levels = OWN_LEVELS;

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    const vreal base = VLOAD(row, row_bases);
    const vreal base_low = VLOAD((size_t)row_stride + row, row_bases);
    vreal total[MOMENTS];
    for (int m = 0; m < MOMENTS; ++m)
        total[m] = (vreal)(0.0f);
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        vreal of_tile[MOMENTS];
        for (int m = 0; m < MOMENTS; ++m)
            of_tile[m] = (vreal)(0.0f);
        for (uint j = 0; j < TILE; ++j) {
            const vreal w =
                exp2_nonpositive(log2_plan(exponent(u, staged, j), base, base_low));
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
        GROUP_BARRIER();
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
    const __global float* restrict row_bases,  // (2, row_stride): log2 w_j = e_ij + base_i
    const __global float* restrict thresholds, // (n_rows, n_draws), in [0, 1)
    __global int* restrict draws)              // (n_rows, n_draws), filled with -1 before
{
    __local staged_real staged[STAGED_SIZE];
    const uint local_row = get_global_id(0) * WIDTH;
    const uint row = first_row + local_row;
    const uint row_tile = row / TILE;
    const __global float* own_levels = OWN_LEVELS;

    ereal u[DIM];
    load_rows(row_offsets, row_stride, row, u);
    const vreal base = VLOAD(row, row_bases);
    const vreal base_low = VLOAD((size_t)row_stride + row, row_bases);
    float next[WIDTH];
    uint drawn[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane) {
        drawn[lane] = 0;
        next[lane] = thresholds[(size_t)(local_row + lane) * n_draws];
    }
    vreal limit = VLOAD(0, next);
    vreal before = (vreal)(0.0f); // sum over the tiles so far; their sums round less
    for (uint n = FIRST_TILE; n < END_TILE; ++n) {
        const uint q = TILE_AT(n);
        stage_columns(q, row_tile, column_stride, LEVEL_PLANE, e_constant(k, k_low),
                      row_centers, column_offsets, column_centers, column_potentials,
                      own_levels + n, staged);
        GROUP_BARRIER();
        vreal of_tile = (vreal)(0.0f);
        for (uint j = 0; j < TILE; ++j) {
            of_tile += exp2_nonpositive(log2_plan(exponent(u, staged, j), base, base_low));
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
        GROUP_BARRIER();
    }
}
#endif // !BOUNDED
