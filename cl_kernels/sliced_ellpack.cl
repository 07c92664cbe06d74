// Sums over pairs of a plan that are kept in memory, each with its log2 pi_ij, at potentials that have
// changed since: of every row, log2 sum_j 2^(log2 pi_ij + change_j), changes in powers of two.
//
// Pairs are kept in sliced ELLPACK, SELL-C-sigma (Kreutzer, Hager, Wellein, Fehske and Bishop 2014,
// SIAM J. Sci. Comput. 36(5), C401-C423; SLICE is C): in slices of SLICE rows, the first pair of all rows
// before the second, so that neighboring lanes read neighboring numbers. A slice has as many places for
// each row as its fullest row needs, rounded up to UNROLL; places that are left over hold SENTINEL. The
// host sorts rows by their length inside windows of sigma rows, so that few places are left over.
//
// Launch: get_global_id(0) is a group of WIDTH consecutive rows; WIDTH divides SLICE.
//
// -D SLICE   rows of a slice
// -D UNROLL  pairs of a row taken together

#include "common.cl"

#if !defined(SLICE) || !defined(UNROLL)
#error "SLICE and UNROLL must be given, see above"
#endif

__kernel void sum_stored(
    const __global uint* restrict starts,         // (slices + 1,)
    const __global int* restrict columns,         // (places,)
    const __global float* restrict log2_masses,   // (places,)
    const __global uint* restrict places,         // (rows,): where each row's result belongs
    const __global float* restrict changes,       // one for every column
    __global float* restrict maxima,              // one for every row
    __global float* restrict sums)                // one for every row, of 2^(... - maximum)
{
    const uint row = get_global_id(0) * WIDTH;
    const uint slice = row / SLICE;
    const uint end = starts[slice + 1];
    vreal m = (vreal)(0.5f * SENTINEL);
    vreal s = (vreal)(0.0f);
    for (uint slot = starts[slice] + (row - slice * SLICE); slot < end; slot += UNROLL * SLICE) {
        vreal e[UNROLL];
        vreal m_new = m;
#pragma unroll
        for (int c = 0; c < UNROLL; ++c) {
            float change[WIDTH];
            for (int lane = 0; lane < WIDTH; ++lane)
                change[lane] = changes[columns[slot + c * SLICE + lane]];
            e[c] = VLOAD(slot + c * SLICE, log2_masses) + VLOAD(0, change);
            m_new = max(m_new, e[c]);
        }
        s *= exp2_nonpositive(m - m_new);
#pragma unroll
        for (int c = 0; c < UNROLL; ++c)
            s += exp2_nonpositive(e[c] - m_new);
        m = m_new;
    }
    float maxima_found[WIDTH], sums_found[WIDTH];
    VSTORE(m, 0, maxima_found);
    VSTORE(s, 0, sums_found);
    for (int lane = 0; lane < WIDTH; ++lane) {
        maxima[places[row + lane]] = maxima_found[lane];
        sums[places[row + lane]] = sums_found[lane];
    }
}

// Leave every place over; a kernel of its own, as some runtimes' commands that fill buffers leave
// it open whether memory is written.
__kernel void clear_stored(__global int* restrict columns, __global float* restrict log2_masses)
{
    const uint place = get_global_id(0);
    columns[place] = 0;
    log2_masses[place] = SENTINEL;
}
