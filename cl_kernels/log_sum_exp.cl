// The logarithm of the sum over all columns of every row, and the row's largest exponent:
//
//     log2 sum_j 2^(e_ij) = m_i + log2 s_i,   s_i = sum_j 2^(e_ij - m_i),
//
// with e_ij as row_loop.cl has it. The soft minimum T(g) of the paper's section 3.1 is -epsilon / log2(e)
// times this. The maximum is taken online, along with the sum (Milakov and Gimelshein 2018).
//
// Launch: as in row_loop.cl; get_global_id(1) is a share of the column tiles.
//
// -D BOUNDED 1, 2: powers and sums have a proven error bound: see sums.cl

#include "row_loop.cl"
#include "sums.cl"

// Online maximum m_i = max_j reference_for(e_ij) and s_i = sum_j 2^(e_ij - m_i), over the column tiles
// of this share; the host joins the shares.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void log_sum_exp(
    CLOUD_ARGUMENTS
    MASK_ARGUMENTS,
#if BOUNDED == 2
    const __global uchar* restrict in_float32, // (n_listed,) whether exponents are float32
#endif
    const uint n_rows,
    __global float* restrict maxima, // (shares, n_rows)
    __global float* restrict sums)   // (SUM_PLANES, shares, n_rows)
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
    __local float rounded[STAGED_PLANE];
    vreal u_rounded[BLOCKS][DIM];
    for (int block = 0; block < BLOCKS; ++block)
        for (int d = 0; d < DIM; ++d)
            u_rounded[block][d] = e_nearest(u[block][d]);
#endif
#if MASKED
    stage_empty_column(staged);
#if BOUNDED == 2
    if (get_local_id(0) == 0)
        for (int d = 0; d <= DIM; ++d)
            rounded[d * STAGED_ROW + TILE] = d == DIM ? SENTINEL : 0.0f;
#endif
#endif
    for (uint n = n_begin; n < n_end; ++n) {
        STAGE_TILE(n);
#if BOUNDED == 2
        if (in_float32[n])
            stage_in_float32(staged, rounded);
#endif
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
                u[block], staged, OWN_MASK(n, block), &m[block], &s[block]);
            s[block] = sum_of(s[block], s_tile);
        }
    }
    for (int block = 0; block < BLOCKS; ++block) {
        const size_t at = (size_t)share * n_rows + BLOCK_ROW(block);
        VSTORE(m[block], at, maxima);
        store_sum(s[block], at, (size_t)shares * n_rows, sums);
    }
}
