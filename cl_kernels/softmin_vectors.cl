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
INLINE reals softmin_of(
    const __global float* maxima,      // (shares, n)
    const __global float* sums,        // (shares, n)
    const __global real* row_level,  // (n / TILE,): see prepare_softmin
    const __global real* own_costs,  // (n,): |u|^2 / 2 and the row's offset
    const uint shares, const uint n, const real k, const uint i)
{
    reals m = TO_REALS(SLOAD(i, maxima));
    reals s = TO_REALS(SLOAD(i, sums));
    for (uint share = 1; share < shares; ++share) {
        const reals other = TO_REALS(SLOAD(i, maxima + (size_t)share * n));
        const reals largest = LARGER(m, other);
        s = PLUS(TIMES(s, EXP2(MINUS(m, largest))),
                 TIMES(TO_REALS(SLOAD(i, sums + (size_t)share * n)), EXP2(MINUS(other, largest))));
        m = largest;
    }
    const reals level = MINUS(SPREAD(row_level[i / TILE]), TIMES(SPREAD(k), DLOAD(i, own_costs)));
    return TIMES(SPREAD(OVER(REAL(-1), k)), PLUS(PLUS(m, level), LOG2(s)));
}

INLINE reals logit_of(
    const __global real* potential, const __global real* offsets,
    const __global real* log2_weights, const real k, const uint j)
{
    const reals logit = PLUS(
        TIMES(MINUS(DLOAD(j, potential), DLOAD(j, offsets)), SPREAD(k)), DLOAD(j, log2_weights));
    return BELOW(logit, REALS(0.5f * SENTINEL), REALS(SENTINEL), logit);
}

// What row_loop.cl needs of the potential of the columns: logits below the largest of their tile, and the
// levels of pairs of tiles below the largest of their row, both in float32 with its rounding errors. Levels are
// (row_tiles, planes, tiles) of one problem, or with `n_listed` pairs of tiles of many problems in all,
// (planes, n_listed), of which these are (row_tiles, tiles).
LONG_FUNCTION void prepare_softmin(
    const __global real* potential,    // (m,)
    const __global real* offsets,      // (m,)
    const __global real* log2_weights, // (m,)
    const __global real* tile_costs,   // (row_tiles, own_m / TILE): |p - q|^2 / 2 of the tiles' centers
    const uint m, const uint own_m, const uint row_tiles, const uint planes, const uint n_listed, const real k,
    __global real* tile_max,           // (own_m / TILE,)
    __global real* row_level,          // (row_tiles,)
    __global float* logits,              // (2, m)
    __global float* levels)
{
    const uint tiles = own_m / TILE;
    const size_t level_plane = n_listed ? n_listed : tiles, level_row = n_listed ? tiles : planes * tiles;
    STEP_BARRIER();
    for (uint q = get_local_id(0); q < tiles; q += GROUP) {
        reals largest = logit_of(potential, offsets, log2_weights, k, q * TILE);
        for (uint j = q * TILE + LANES; j < (q + 1) * TILE; j += LANES)
            largest = LARGER(largest, logit_of(potential, offsets, log2_weights, k, j));
        const real top = largest_lane(largest);
        tile_max[q] = top;
        for (uint j = q * TILE; j < (q + 1) * TILE; j += LANES) {
            const reals logit = logit_of(potential, offsets, log2_weights, k, j);
            const reals h = BELOW(logit, REALS(0.5f * SENTINEL), logit, MINUS(logit, SPREAD(top)));
            const vsingle high = TO_VSINGLE(h);
            SSTORE(high, j, logits);
            SSTORE(TO_VSINGLE(MINUS(h, TO_REALS(high))), j, logits + m);
        }
    }
    STEP_BARRIER();
    for (uint p = get_local_id(0); p < row_tiles; p += GROUP) {
        const __global real* costs = tile_costs + (size_t)p * tiles;
        real top = MINUS(tile_max[0], TIMES(k, costs[0]));
        for (uint q = 1; q < tiles; ++q)
            top = LARGER(top, MINUS(tile_max[q], TIMES(k, costs[q])));
        row_level[p] = top;
        __global float* own_levels = levels + p * level_row;
        for (uint q = 0; q < tiles; ++q) {
            const real level = LARGER(MINUS(MINUS(tile_max[q], TIMES(k, costs[q])), top), REAL(SENTINEL));
            const float high = TO_SINGLE(level);
            own_levels[q] = high;
            if (planes == 2)
                own_levels[level_plane + q] = TO_SINGLE(MINUS(level, REAL(high)));
        }
    }
}
