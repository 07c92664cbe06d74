// The softmin that log_sum_exp.cl has left in parts, and what the next softmin needs of a potential, for
// half_steps.cl.
//
// Launch: one work-group, see vector_steps.cl.
//
// Units: costs and potentials in coordinates squared, k = log2(e) / epsilon in its inverse; levels, logits
// and maxima in powers of two (log2).
//
// -D TILE    points of one tile, a multiple of LANES

#ifndef TILE
#error "TILE (points of one tile) must be given"
#endif

#include "vector_steps.cl"

// The softmin -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon) of LANES rows from i on, from the maxima
// and sums of log_sum_exp.cl.
INLINE vdouble softmin_of(
    const __global float* maxima,      // (shares, n)
    const __global float* sums,        // (shares, n)
    const __global double* row_level,  // (n / TILE,): see prepare_softmin
    const __global double* own_costs,  // (n,): |u|^2 / 2 and the row's offset
    const uint shares, const uint n, const double k, const uint i)
{
    vdouble m = TO_VDOUBLE(SLOAD(i, maxima));
    vdouble s = TO_VDOUBLE(SLOAD(i, sums));
    for (uint share = 1; share < shares; ++share) {
        const vdouble other = TO_VDOUBLE(SLOAD(i, maxima + (size_t)share * n));
        const vdouble largest = fmax(m, other);
        s = s * exp2(m - largest)
            + TO_VDOUBLE(SLOAD(i, sums + (size_t)share * n)) * exp2(other - largest);
        m = largest;
    }
    return ((vdouble)(-1.0 / k)) * (m + ((vdouble)(row_level[i / TILE]) - k * DLOAD(i, own_costs)) + log2(s));
}

INLINE vdouble logit_of(
    const __global double* potential, const __global double* offsets,
    const __global double* log2_weights, const double k, const uint j)
{
    const vdouble logit = (DLOAD(j, potential) - DLOAD(j, offsets)) * k + DLOAD(j, log2_weights);
    return logit < (vdouble)(0.5 * (double)SENTINEL) ? (vdouble)((double)SENTINEL) : logit;
}

// What row_loop.cl needs of the potential of the columns: logits below the largest of their tile, and the
// levels of pairs of tiles below the largest of their row, both in float32 with its rounding errors. Levels are
// (row_tiles, planes, tiles) of one problem, or with `n_listed` pairs of tiles of many problems in all,
// (planes, n_listed), of which these are (row_tiles, tiles).
LONG_FUNCTION void prepare_softmin(
    const __global double* potential,    // (m,)
    const __global double* offsets,      // (m,)
    const __global double* log2_weights, // (m,)
    const __global double* tile_costs,   // (row_tiles, own_m / TILE): |p - q|^2 / 2 of the tiles' centers
    const uint m, const uint own_m, const uint row_tiles, const uint planes, const uint n_listed, const double k,
    __global double* tile_max,           // (own_m / TILE,)
    __global double* row_level,          // (row_tiles,)
    __global float* logits,              // (2, m)
    __global float* levels)
{
    const uint tiles = own_m / TILE;
    const size_t level_plane = n_listed ? n_listed : tiles, level_row = n_listed ? tiles : planes * tiles;
    STEP_BARRIER();
    for (uint q = get_local_id(0); q < tiles; q += GROUP) {
        vdouble largest = logit_of(potential, offsets, log2_weights, k, q * TILE);
        for (uint j = q * TILE + LANES; j < (q + 1) * TILE; j += LANES)
            largest = fmax(largest, logit_of(potential, offsets, log2_weights, k, j));
        const double top = largest_lane(largest);
        tile_max[q] = top;
        for (uint j = q * TILE; j < (q + 1) * TILE; j += LANES) {
            const vdouble logit = logit_of(potential, offsets, log2_weights, k, j);
            const vdouble h = logit == (vdouble)((double)SENTINEL) ? logit : logit - top;
            const vsingle high = TO_VSINGLE(h);
            SSTORE(high, j, logits);
            SSTORE(TO_VSINGLE(h - TO_VDOUBLE(high)), j, logits + m);
        }
    }
    STEP_BARRIER();
    for (uint p = get_local_id(0); p < row_tiles; p += GROUP) {
        const __global double* costs = tile_costs + (size_t)p * tiles;
        double top = tile_max[0] - k * costs[0];
        for (uint q = 1; q < tiles; ++q)
            top = fmax(top, tile_max[q] - k * costs[q]);
        row_level[p] = top;
        __global float* own_levels = levels + p * level_row;
        for (uint q = 0; q < tiles; ++q) {
            const double level = fmax(tile_max[q] - k * costs[q] - top, (double)SENTINEL);
            own_levels[q] = (float)level;
            if (planes == 2)
                own_levels[level_plane + q] = (float)(level - (double)(float)level);
        }
    }
}
