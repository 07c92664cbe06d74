// A Sinkhorn iteration between two softmins over all pairs, of one problem or of many, in the numbers of reals.cl.
// Its formulas, those of Algorithm 1 of Sejourne, Vialard and Peyre (2022), stand in vector_steps.cl. The four
// launches of an iteration are log_sum_exp (rows), row_step, log_sum_exp (columns), column_step; prepare_rows comes
// before them where the host has set g. Each kernel first joins the softmin that log_sum_exp.cl has computed, and
// last prepares the next one.
//
// Shapes: n points of the rows and m of the columns, those of all problems one after the other, each problem
// padded to whole tiles by points without mass. `problems` has a line for each problem, see PROBLEM.
// Launch: a work-group of GROUP for each problem, see vector_steps.cl.
//
// Units: costs and potentials in coordinates squared, k = log2(e) / epsilon in its inverse; levels, logits
// and maxima in powers of two (log2).
//
// -D TILE    points of one tile, a multiple of LANES
// -D ROW_*, COLUMN_*, NUMBER_*, PROBLEM_*  places of vectors and numbers, see half_step_slots.py

#include "vector_steps.cl"

#ifndef TILE
#error "TILE must be given, see above"
#endif

// The softmin -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon) of LANES rows from i on, from the maxima
// and sums of log_sum_exp.cl.
INLINE reals softmin_of(
    const __global float* maxima,      // (shares, n)
    const __global float* sums,        // (shares, n)
    const __global real* row_level,  // (n / TILE,): see prepare_softmin
    const __global real* own_costs,  // (n,): |u|^2 / 2 and the row's offset
    const uint shares, const uint n, const real k, const uint i)
{
    reals m = TO_REALS(DLOAD(i, maxima));
    reals s = TO_REALS(DLOAD(i, sums));
    for (uint share = 1; share < shares; ++share) {
        const reals other = TO_REALS(DLOAD(i, maxima + (size_t)share * n));
        const reals largest = LARGER(m, other);
        s = PLUS(TIMES(s, EXP2(MINUS(m, largest))),
                 TIMES(TO_REALS(DLOAD(i, sums + (size_t)share * n)), EXP2(MINUS(other, largest))));
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
            DSTORE(high, j, logits);
            DSTORE(TO_VSINGLE(MINUS(h, TO_REALS(high))), j, logits + m);
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

// What the host says of the problem of a group: its number, its first entry and its number of entries of both
// sides, the first of its pairs of tiles, its control, see vector_steps.cl, and the trust radius. The last two
// change in each iteration. They are arguments of the kernels if there is one problem, and 0 here; of many problems
// they stand here, and the arguments are 0.
#define PROBLEM(field) problems[get_group_id(0) * PROBLEM_COUNT + PROBLEM_##field]
#define RADIUS PLUS(only_radius, OF_BITS(PROBLEM(RADIUS_LOW), PROBLEM(RADIUS_HIGH)))
#define PROBLEM_SETUP                                                                          \
    const uint own_n = PROBLEM(N), own_m = PROBLEM(M), control = only_control | PROBLEM(CONTROL); \
    const uint first_tiles[2] = {PROBLEM(FIRST_ROW) / TILE, PROBLEM(FIRST_COLUMN) / TILE};     \
    const size_t first_pair = PROBLEM(FIRST_PAIR);                                             \
    columns += PROBLEM(FIRST_COLUMN)

// Prepare the softmin of the rows, T(g), for a new g: the host's, or one of the columns' vectors.
//   logits_j = k (g_j - offset_j) + log2 b_j, less its tile's largest; levels_pq = that largest - k C_pq - row_level_p,
//   C_pq the cost between the centers of tiles p and q
// Shapes: g (m,), logits (2, m), levels (n / TILE, m / TILE). Launch: a work-group for each problem.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void prepare_rows(
    const __global uint* restrict problems, const uint only_control,
    const uint n, const uint m, const uint planes, const uint n_listed, const real k,
    const __global real* restrict start,       // (m,): the host's g
    __global real* restrict columns,           // (slots, m)
    const __global real* restrict tile_costs,  // of pairs of tiles, rows first
    __global real* restrict tile_max,          // (largest number of tiles,)
    __global real* restrict row_level,         // (n / TILE,)
    __global float* restrict logits,             // (2, m)
    __global float* restrict levels)             // see prepare_softmin
{
    PROBLEM_SETUP;
    if (G_AT == COLUMN_START)
        for (uint i = FIRST; i < own_m; i += STEP)
            DSTORE(DLOAD(i, start + PROBLEM(FIRST_COLUMN)), i, COLUMN(COLUMN_START));
    prepare_softmin(COLUMN(G_AT), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS), tile_costs + first_pair,
                    m, own_m, own_n / TILE, planes, n_listed, k, tile_max + first_tiles[1],
                    row_level + first_tiles[0], logits + PROBLEM(FIRST_COLUMN), levels + first_pair);
}

// The logarithm of sum_i weights_i exp(-rate potential_i), by its largest term; 0 if nothing needs it.
INLINE real log_sum(
    const __global real* log_weights, const __global real* potential, const uint size,
    const real rate, const bool needed, __local real* shared)
{
    const uint end = needed ? size : 0; // without it the sum is 1
    reals most = REALS(-INFINITY), sum = REALS(needed ? 0.0f : 1.0f / (GROUP * LANES));
    for (uint i = FIRST; i < end; i += STEP)
        most = LARGER(most, log_scaled(DLOAD(i, log_weights), DLOAD(i, potential), rate));
    const real top = group_largest(needed ? largest_lane(most) : REAL(0), shared);
    for (uint i = FIRST; i < end; i += STEP)
        sum = PLUS(sum, EXP(MINUS(log_scaled(DLOAD(i, log_weights), DLOAD(i, potential), rate), SPREAD(top))));
    return PLUS(top, LOG(group_sum(sum_of_lanes(sum), shared)));
}

// The part of the dual that belongs to a potential: <weights, rho (1 - exp(-potential / rho))>.
INLINE real dual_part(
    const __global real* weights, const __global real* potential, const uint size,
    const real inverse_rho, __local real* shared)
{
    const bool balanced = !IS_BELOW(REAL(0), inverse_rho);
    reals sum = REALS(0);
    if (balanced)
        for (uint i = FIRST; i < size; i += STEP)
            sum = PLUS(sum, TIMES(DLOAD(i, weights), DLOAD(i, potential)));
    else // without the cancellation at large rho
        for (uint i = FIRST; i < size; i += STEP) {
            const reals scaled = TIMES(NEGATIVE(DLOAD(i, potential)), SPREAD(inverse_rho));
            sum = MINUS(sum, TIMES(DLOAD(i, weights), EXPM1(SMALLER(scaled, REALS(MAX_EXPONENT)))));
        }
    const real found = group_sum(sum_of_lanes(sum), shared);
    return balanced ? found : OVER(found, inverse_rho);
}

// The dual of potentials in these places.
#define DUAL(f, g)                                                                             \
    dual_of(epsilon, plan_mass,                                                                \
            dual_part(ROW(ROW_WEIGHTS), ROW(f), own_n, inverse_rho_source, shared),            \
            dual_part(COLUMN(COLUMN_WEIGHTS), COLUMN(g), own_m, inverse_rho_target, shared))

// Arguments of both steps. This softmin has q = n or m rows; the next one has those of the other side.
#define STEP_ARGUMENTS                                                                         \
    const __global uint* restrict problems, const uint only_control,                           \
    const uint n, const uint m, const uint shares, const uint planes, const uint n_listed,     \
    const real k, const real epsilon, const real inverse_rho_source,                           \
    const real inverse_rho_target,                                                             \
    const __global float* restrict maxima,    /* (shares, q) */                                \
    const __global float* restrict sums,      /* (shares, q) */                                \
    const __global real* restrict row_level,  /* (q / TILE,): of this softmin */               \
    __global real* restrict rows,             /* (slots, n) */                                 \
    __global real* restrict columns,          /* (slots, m) */                                 \
    const __global real* restrict tile_costs, /* of pairs of tiles, rows of the next first */  \
    __global real* restrict tile_max,         /* (largest number of tiles,) */                 \
    __global real* restrict next_level,       /* (its tiles,): of the next softmin */          \
    __global float* restrict logits,          /* (2, q): of the next softmin */                \
    __global float* restrict levels,          /* see prepare_softmin */                        \
    __global real* restrict numbers           /* (groups, NUMBER_COUNT) */

// After T(g): f, the shift of g, and the dual. Then the softmin of the columns, T(f), is prepared.
//   s = translation(g, T(g));  T(g) <- T(g) - s;  f = Delta_a T(g);  g <- g + s
//   m(pi) = sum_i a_i exp((f_i - T(g)_i) / epsilon);  the dual of (f, g), by which the host keeps the extrapolation
//   before it or takes that back
// Shapes: T(g), f (n,), g (m,), numbers (NUMBER_COUNT,). Launch: a work-group for each problem.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void row_step(STEP_ARGUMENTS)
{
    PROBLEM_SETUP;
    rows += PROBLEM(FIRST_ROW);
    maxima += PROBLEM(FIRST_ROW);
    sums += PROBLEM(FIRST_ROW);
    row_level += first_tiles[0];
    numbers += get_group_id(0) * NUMBER_COUNT;
    __local real shared[GROUP];
    RATES(source, target);
    reals unusual = REALS(0); // not a number if a softmin is not finite
    for (uint i = FIRST; i < own_n; i += STEP) {
        const reals softmin = softmin_of(maxima, sums, row_level, ROW(ROW_OWN_COSTS), shares, n, k, i);
        DSTORE(softmin, i, ROW(ROW_SOFTMIN));
        unusual = PLUS(unusual, TIMES(softmin, REALS(0)));
    }
    const real finite = group_sum(sum_of_lanes(unusual), shared);
    const real shift = translation(
        log_sum(COLUMN(COLUMN_LOG_WEIGHTS), COLUMN(G_AT), own_m, inverse_rho_target, needed, shared),
        log_sum(ROW(ROW_LOG_WEIGHTS), ROW(ROW_SOFTMIN), own_n, rate, needed, shared), rates);
    reals mass = REALS(0);
    for (uint i = FIRST; i < own_n; i += STEP) {
        const reals softmin = MINUS(DLOAD(i, ROW(ROW_SOFTMIN)), SPREAD(shift));
        const reals f = TIMES(SPREAD(damping), softmin);
        DSTORE(softmin, i, ROW(ROW_SOFTMIN));
        DSTORE(f, i, ROW(ROW_F));
        mass = PLUS(mass, marginal(
            DLOAD(i, ROW(ROW_WEIGHTS)), DLOAD(i, ROW(ROW_LOG_WEIGHTS)), f, softmin, epsilon));
    }
    for (uint i = FIRST; i < own_m; i += STEP)
        DSTORE(PLUS(DLOAD(i, COLUMN(G_AT)), SPREAD(shift)), i, COLUMN(COLUMN_SHIFTED));
    const real plan_mass = group_sum(sum_of_lanes(mass), shared);
    const real dual = DUAL(ROW_F, COLUMN_SHIFTED);
    if (get_local_id(0) == 0) {
        numbers[NUMBER_MASS] = plan_mass;
        numbers[NUMBER_ROW_DUAL] = dual;
        numbers[NUMBER_ROW_FINITE] = finite;
    }
    prepare_softmin(ROW(ROW_F), ROW(ROW_OFFSETS), ROW(ROW_LOG2_WEIGHTS), tile_costs + first_pair,
                    n, own_n, own_m / TILE, planes, n_listed, k, tile_max + first_tiles[0],
                    next_level + first_tiles[1], logits + PROBLEM(FIRST_ROW), levels + first_pair);
}

// After T(f): the residual, the image of g, the shift of f, the dual, and the extrapolated g. Then the
// softmin of the rows, T(g), is prepared.
//   residual = max(|f - Delta_a T(g)|, |g - Delta_b T(f)|) / epsilon, where there is mass
//   s = translation(f, T(f));  T(f) <- T(f) - s;  g' = Delta_b T(f);  f <- f + s;  the dual of (f, g')
//   next g = g' extrapolated, without drift if both sides are balanced; g' if nothing can be extrapolated
// Shapes: T(f), g' (m,), f (n,), products (MEMORY, MEMORY), numbers (NUMBER_COUNT,). Launch: a work-group for
// each problem.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_step(
    STEP_ARGUMENTS, const real only_radius,
    __global real* restrict products)          // (problems, MEMORY, MEMORY)
{
    PROBLEM_SETUP;
    rows += PROBLEM(FIRST_ROW);
    maxima += PROBLEM(FIRST_COLUMN);
    sums += PROBLEM(FIRST_COLUMN);
    row_level += first_tiles[1];
    numbers += get_group_id(0) * NUMBER_COUNT;
    products += PROBLEM(NUMBER) * MEMORY * MEMORY;
    __local real shared[GROUP];
    SHARED real system[MEMORY * SYSTEM_ROW];
    const real row_damping = damping_of(epsilon, inverse_rho_source);
    RATES(target, source);
    reals farthest = REALS(0), unusual = REALS(0);
    for (uint i = FIRST; i < own_n; i += STEP)
        farthest = LARGER(farthest, distance_of(DLOAD(i, ROW(ROW_WEIGHTS)), DLOAD(i, ROW(ROW_F)),
                                                TIMES(SPREAD(row_damping), DLOAD(i, ROW(ROW_SOFTMIN)))));
    for (uint i = FIRST; i < own_m; i += STEP) {
        const reals softmin = softmin_of(maxima, sums, row_level, COLUMN(COLUMN_OWN_COSTS), shares, m, k, i);
        DSTORE(softmin, i, COLUMN(COLUMN_SOFTMIN));
        farthest = LARGER(farthest, distance_of(DLOAD(i, COLUMN(COLUMN_WEIGHTS)), DLOAD(i, COLUMN(COLUMN_SHIFTED)),
                                                TIMES(SPREAD(damping), softmin)));
        unusual = PLUS(unusual, TIMES(softmin, REALS(0)));
    }
    const real residual = OVER(group_largest(largest_lane(farthest), shared), epsilon);
    const real finite = group_sum(sum_of_lanes(unusual), shared);
    const real shift = translation(
        log_sum(ROW(ROW_LOG_WEIGHTS), ROW(ROW_F), own_n, inverse_rho_source, needed, shared),
        log_sum(COLUMN(COLUMN_LOG_WEIGHTS), COLUMN(COLUMN_SOFTMIN), own_m, rate, needed, shared), rates);
    for (uint i = FIRST; i < own_n; i += STEP)
        DSTORE(PLUS(DLOAD(i, ROW(ROW_F)), SPREAD(shift)), i, ROW(ROW_SHIFTED));

    reals mass = REALS(0), square = REALS(0);
    for (uint i = FIRST; i < own_m; i += STEP) {
        const reals softmin = MINUS(DLOAD(i, COLUMN(COLUMN_SOFTMIN)), SPREAD(shift));
        const reals image = TIMES(SPREAD(damping), softmin);
        const reals own = marginal(
            DLOAD(i, COLUMN(COLUMN_WEIGHTS)), DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS)), image, softmin, epsilon);
        DSTORE(softmin, i, COLUMN(COLUMN_SOFTMIN));
        DSTORE(own, i, COLUMN(COLUMN_MARGINAL));
        mass = PLUS(mass, own);
        square = PLUS(square, remember(columns, m, control, i, image, own));
    }
    const real plan_mass = group_sum(sum_of_lanes(mass), shared);
    const real dual = DUAL(ROW_SHIFTED, COLUMN_IMAGE_0 + PARITY);

    const real longest = TIMES(RADIUS, ROOT(group_sum(sum_of_lanes(square), shared)));
    for (uint first = 0; first < COUNT; first += BLOCK) {
        reals of_difference[BLOCK], of_residual[BLOCK];
        sum_products(columns, m, control, first, FIRST, own_m, of_difference, of_residual);
#pragma unroll
        for (uint k = 0; k < BLOCK; ++k) {
            const real newest = group_sum(sum_of_lanes(of_difference[k]), shared);
            const real right = group_sum(sum_of_lanes(of_residual[k]), shared);
            if (get_local_id(0) == 0) {
                SYSTEM(IN_BLOCK(first, k), NEWEST) = newest;
                SYSTEM(IN_BLOCK(first, k), RIGHT) = right;
            }
        }
    }
    const bool found = solve_normal(products, PLACE, COUNT, system);
    for (uint j = get_local_id(0); j < COUNT; j += GROUP)
        store_products(products, SYSTEM(j, NEWEST), j, PLACE);
    reals length = REALS(0), along = REALS(0);
    for (uint i = FIRST; i < own_m; i += STEP) {
        const reals step = step_from_image(columns, m, control, i, system);
        DSTORE(step, i, COLUMN(COLUMN_STEP));
        length = PLUS(length, TIMES(TIMES(step, DLOAD(i, COLUMN(COLUMN_MASS))), step));
        along = PLUS(along, TIMES(step, DLOAD(i, COLUMN(COLUMN_MARGINAL))));
    }
    const real norm = ROOT(group_sum(sum_of_lanes(length), shared));
    const real factor = limit(norm, longest);
    // Balanced potentials are unique up to a constant, along which nothing bounds an extrapolation.
    const real mean = OVER(group_sum(sum_of_lanes(along), shared), plan_mass);
    const real drift = needed ? REAL(0) : TIMES(factor, mean);
    for (uint i = FIRST; i < own_m; i += STEP)
        DSTORE(MINUS(PLUS(DLOAD(i, COLUMN(COLUMN_IMAGE_0 + PARITY)),
                          TIMES(SPREAD(factor), DLOAD(i, COLUMN(COLUMN_STEP)))), SPREAD(drift)),
               i, COLUMN(COLUMN_GUESS_0 + PARITY));
    if (get_local_id(0) == 0) {
        numbers[NUMBER_RESIDUAL_SIZE] = residual;
        numbers[NUMBER_COLUMN_DUAL] = dual;
        numbers[NUMBER_COLUMN_FINITE] = finite;
        numbers[NUMBER_FOUND] = REAL(found);
        numbers[NUMBER_CUT] = REAL(found && IS_BELOW(longest, norm));
    }
    // Without an extrapolation the image itself is next.
    const uint next_at = (found ? COLUMN_GUESS_0 : COLUMN_IMAGE_0) + PARITY;
    prepare_softmin(COLUMN(next_at), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS),
                    tile_costs + first_pair, m, own_m, own_n / TILE, planes, n_listed, k,
                    tile_max + first_tiles[1], next_level + first_tiles[0],
                    logits + PROBLEM(FIRST_COLUMN), levels + first_pair);
}
