// The logarithm of the sum over all columns of every row, and the mean of the columns with the shares
// of the sum, in one pass:
//
//     log2 sum_j 2^(e_ij) = m_i + log2 s_i,   T(x_i) - p = sum_j 2^(e_ij - m_i) (Y_j - p) / s_i,
//
// with e_ij as row_loop.cl has it and the center p of the row's tile. The sums of a row are taken relative
// to its largest exponent so far, and rescaled when that grows, as attention is computed (Rabe and
// Staats 2021).
//
// Launch: as in row_loop.cl; get_global_id(1) is a share of the column tiles. With SLICE the sums of a row stand
// in global memory, and columns are staged a second time, slice by slice, to be added to them.

#include "row_loop.cl"

// A row's sums: of the powers w_j, and of w_j z_j with z_j = k (Y_j - p).
#define SUMS (1 + DIM)
#define SUM_AT(number) (((size_t)(number) * shares + share) * n_rows + local_row)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void barycentric_projection(
    CLOUD_ARGUMENTS, const uint n_rows,
    __global float* restrict maxima, // (shares, n_rows)
    __global float* restrict sums)   // (SUMS, shares, n_rows)
{
    ROW_SETUP;
    SHARE_SETUP;
    // Above columns without mass: the difference of two sentinels is no exponent.
    vreal m = (vreal)(0.5f * SENTINEL);
#ifdef SLICE
    vreal total = (vreal)(0.0f);
    for (uint d = 0; d < DIM; ++d)
        VSTORE((vreal)(0.0f), SUM_AT(1 + d), sums);
    for (uint n = n_begin; n < n_end; ++n) {
        const uint q = STAGE_TILE(n);
        vreal m_new = m;
        for (uint j = 0; j < TILE; ++j)
            m_new = max(m_new, e_nearest(u[j]));
        const vreal scale = exp2_nonpositive(m - m_new);
        m = m_new;
        vreal w[TILE];
        vreal of_tile = (vreal)(0.0f);
        for (uint j = 0; j < TILE; ++j) {
            w[j] = exp2_nonpositive(e_above(u[j], m));
            of_tile += w[j];
        }
        total = total * scale + of_tile;
        for (uint first = 0; first < DIM; first += SLICE) {
            const uint count = min((uint)SLICE, DIM - first);
            STAGE_SLICE(q, first, count);
            for (uint d = 0; d < count; ++d) {
                vreal sum = (vreal)(0.0f);
                for (uint j = 0; j < TILE; ++j)
                    sum += w[j] * (float)staged[d * STAGED_ROW + j];
                VSTORE(VLOAD(SUM_AT(1 + first + d), sums) * scale + sum, SUM_AT(1 + first + d), sums);
            }
        }
    }
    VSTORE(total, SUM_AT(0), sums);
#else
    vreal total[SUMS];
    for (int n = 0; n < SUMS; ++n)
        total[n] = (vreal)(0.0f);
    for (uint n = n_begin; n < n_end; ++n) {
        STAGE_TILE(n);
        vreal of_tile[SUMS];
        for (int d = 0; d < SUMS; ++d)
            of_tile[d] = (vreal)(0.0f);
        for (uint j = 0; j < TILE; j += UNROLL) {
            ereal e[UNROLL];
            vreal m_new = m;
#pragma unroll
            for (int c = 0; c < UNROLL; ++c) {
                e[c] = exponent(u, staged, j + c);
                m_new = max(m_new, e_nearest(e[c]));
            }
            if (ANY(m_new > m)) {
                const vreal scale = exp2_nonpositive(m - m_new);
#pragma unroll
                for (int d = 0; d < SUMS; ++d) {
                    total[d] *= scale;
                    of_tile[d] *= scale;
                }
                m = m_new;
            }
#pragma unroll
            for (int c = 0; c < UNROLL; ++c) {
                const vreal w = exp2_nonpositive(e_above(e[c], m));
                of_tile[0] += w;
#pragma unroll
                for (int d = 0; d < DIM; ++d)
                    of_tile[1 + d] += w * (float)staged[d * TILE + j + c];
            }
        }
        for (int d = 0; d < SUMS; ++d)
            total[d] += of_tile[d];
    }
    for (int d = 0; d < SUMS; ++d)
        VSTORE(total[d], SUM_AT(d), sums);
#endif
    VSTORE(m, (size_t)share * n_rows + local_row, maxima);
}
