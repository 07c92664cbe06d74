// The logarithm of the sum over all columns of every row, and the row's largest exponent:
//
//     log2 sum_j 2^(e_ij) = m_i + log2 s_i,   s_i = sum_j 2^(e_ij - m_i),
//
// with e_ij as row_loop.cl has it. The soft minimum T(g) of the paper's section 3.1 is -epsilon / log2(e)
// times this. The maximum is taken online, along with the sum (Milakov and Gimelshein 2018).
//
// Launch: as in row_loop.cl; get_global_id(1) is a share of the column tiles. On cards a work-item has a vector
// of rows, so that each column is read from local memory once for several of them, and STACKS of GROUP
// work-items with the same rows fill a work-group; their sums are joined.
//
// -D BOUNDED 1, 2: powers and sums have a proven error bound: see sums.cl

// On cards the maximum over a tile costs a fifth of the time, and most tiles cannot raise it.
#if !defined(TOPS) && !PRECISE && !MASKED && STACKS > 1
#define TOPS 1
#endif

#include "row_loop.cl"
#include "sums.cl"

#if TOPS
#define IS_BELOW(block) \
    !ANY(!(largest_exponents(u[block], own[block], q, row_tile, k, row_centers, column_centers     \
                             TOPS_OF_STACK) <= m[block]))
#else
#define IS_BELOW(block) ((void)q, false)
#endif

// Online maximum m_i = max_j reference_for(e_ij) and s_i = sum_j 2^(e_ij - m_i), over the column tiles
// of this work-group's shares; the host joins those of other work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, STACKS, 1)))
void log_sum_exp(
    CLOUD_ARGUMENTS
    MASK_ARGUMENTS,
#if BOUNDED == 2
    const __global uchar* restrict in_float32, // (n_listed,) whether exponents are float32
#endif
    const uint n_rows,
    __global float* restrict maxima, // (work-groups along dimension 1, n_rows)
    __global float* restrict sums)   // (SUM_PLANES, work-groups along dimension 1, n_rows)
{
    BLOCK_SETUP;
    SHARE_SETUP;
    vreal m[BLOCKS];
    sreal s[BLOCKS];
    for (int block = 0; block < BLOCKS; ++block) {
        // Above columns without mass: the difference of two sentinels is no exponent.
        m[block] = (vreal)(0.5f * SENTINEL);
        s[block] = NO_SUM;
    }
#if BOUNDED == 2
#if STACKS == 1
    __local float rounded[STAGED_PLANE] ALIGNED;
#else
    __local float rounded_of[STACKS * (STAGED_PLANE + 4)] ALIGNED;
    __local float* rounded = rounded_of + get_local_id(1) * (STAGED_PLANE + 4);
#endif
    vreal u_rounded[BLOCKS][DIM];
    for (int block = 0; block < BLOCKS; ++block)
        for (int d = 0; d < DIM; ++d)
            u_rounded[block][d] = e_nearest(u[block][d]);
#endif
#if TOPS
    STAGED_TOPS;
    vreal own[BLOCKS];
    for (int block = 0; block < BLOCKS; ++block) {
        vreal squares = (vreal)(0.0f);
        for (int d = 0; d < DIM; ++d)
            squares += u[block][d] * u[block][d];
        own[block] = 0.5f * k * squares;
    }
#endif
#if MASKED
    stage_empty_column(staged);
#if BOUNDED == 2
    if (get_local_id(0) == 0)
        for (int d = 0; d <= DIM; ++d)
            rounded[d * STAGED_ROW + TILE] = d == DIM ? SENTINEL : 0.0f;
#endif
#endif
    for (uint step = 0; step < per_share; ++step) {
        const uint n = min(n_begin + step, end_tile - 1u);
        const uint q = STAGE_TILE(n);
#if BOUNDED == 2
        if (in_float32[n])
            stage_in_float32(staged, rounded);
        GROUP_BARRIER();
#endif
        if (n_begin + step >= n_end)
            continue;
        for (int block = 0; block < BLOCKS; ++block) {
            if (IS_EMPTY(n, block))
                continue;
#if BOUNDED == 2
            if (in_float32[n]) {
                const sreal s_few = add_tile_in_float32(
                    u_rounded[block], rounded, OWN_MASK(n, block), &m[block], &s[block]);
                s[block] = sum_of(s[block], s_few);
                continue;
            }
#endif
            const sreal s_tile = add_tile(
                u[block], staged, OWN_MASK(n, block), IS_BELOW(block), &m[block], &s[block]);
            s[block] = sum_of(s[block], s_tile);
        }
    }
#if STACKS > 1
    __local vreal maxima_of[STACKS * GROUP];
    __local sreal sums_of[STACKS * GROUP];
    const uint item = get_local_id(0);
    maxima_of[get_local_id(1) * GROUP + item] = m[0];
    sums_of[get_local_id(1) * GROUP + item] = s[0];
    GROUP_BARRIER();
    if (get_local_id(1) > 0)
        return;
    for (uint stack = 1; stack < STACKS; ++stack) {
        const vreal m_stack = maxima_of[stack * GROUP + item];
        const vreal m_new = max(m[0], m_stack);
        s[0] = sum_of(rescaled(s[0], m[0] - m_new),
                      rescaled(sums_of[stack * GROUP + item], m_stack - m_new));
        m[0] = m_new;
    }
#endif
    for (int block = 0; block < BLOCKS; ++block) {
        const size_t at = (size_t)get_group_id(1) * n_rows + BLOCK_ROW(block);
        VSTORE(m[block], at, maxima);
        store_sum(s[block], at, (size_t)get_num_groups(1) * n_rows, sums);
    }
}
