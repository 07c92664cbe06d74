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
    CLOUD_ARGUMENTS,
#if MASKED
    const __global ulong* restrict column_masks, // (n_listed, GROUPS_OF_TILE, MASK_WORDS)
#endif
#if BOUNDED == 2
    const __global uchar* restrict in_float32, // (n_listed,) whether exponents are float32
#endif
    const uint n_rows,
    __global float* restrict maxima, // (shares, n_rows)
    __global float* restrict sums)   // (SUM_PLANES, shares, n_rows)
{
    ROW_SETUP;
    SHARE_SETUP;
    // Above columns without mass: the difference of two sentinels is no exponent.
    vreal m = (vreal)(0.5f * SENTINEL);
    sreal s = NO_SUM;
#if BOUNDED == 2
    __local float rounded[STAGED_PLANE];
    vreal u_rounded[DIM];
    for (int d = 0; d < DIM; ++d)
        u_rounded[d] = e_nearest(u[d]);
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
#if MASKED
        if (is_empty(OWN_MASK(n)))
            continue; // so do all work-items of the group
#endif
        STAGE_TILE(n);
#if BOUNDED == 2
        if (in_float32[n]) {
            stage_in_float32(staged, OWN_MASK(n), rounded);
            const sreal s_few = add_tile_in_float32(u_rounded, rounded, OWN_MASK(n), &m, &s);
            s = sum_of(s, s_few);
            continue;
        }
#endif
        const sreal s_tile = add_tile(u, staged, OWN_MASK(n), &m, &s);
        s = sum_of(s, s_tile);
    }
    VSTORE(m, (size_t)share * n_rows + local_row, maxima);
    store_sum(s, (size_t)share * n_rows + local_row, (size_t)shares * n_rows, sums);
}
