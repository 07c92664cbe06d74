// A Sinkhorn iteration over the stored pairs of a plan: the half-steps of half_steps.cl on the sparse
// kernel that sum_stored of sliced_ellpack.cl sums, in many work-groups, in the numbers of reals.cl. The formulas,
// those of Algorithm 1 of Sejourne, Vialard and Peyre (2022), stand in vector_steps.cl.
//
// Each kernel is one stage. Every work-group leaves what it has found of each sum in `partials`, and in the next
// stage every work-group joins these few numbers for itself. The nine launches of an iteration, after
// prepare_changes where the host has set g:
//
//   sum_stored by row     the sums behind T(g)         sum_stored by column  the sums behind T(f)
//   row_softmins          T(g), translation of g       column_softmins       T(f), residual, translation of f
//   row_step              g <- g + s, f                column_step           f <- f + s, g', its differences
//                                                      extrapolate           the step from g'
//                                                      next_potential        the next g
//                                                      end_iteration         its middle
//
// sum_stored takes changes of a potential since the pairs were stored, k (g - origin) with k = log2(e) / epsilon,
// in powers of two (log2), less the midrange ("middle") of the changes of the iterate before. After a half-step
// <a, exp(-f / rho)> is the mass of the plan, so that the duals need no sum.
//
// Shapes: n points of the rows and m of the columns, both padded to whole slices by points without mass.
// `given_rows`, `given_columns`, `rows` and `columns` have one vector after the other, (slots, n) or (slots, m).
// Launch: the same number of work-groups of GROUP for each stage, one for end_iteration.
//
// -D GIVEN_*, ROW_*, COLUMN_*, NUMBER_*  places of vectors and numbers, see sparse_half_step_slots.py
// -D PARTIALS  largest number of sums of a stage
// -D LARGEST_CHANGE  limit of the changes of potentials, powers of two (log2)

#if !defined(LARGEST_CHANGE) || !defined(PARTIALS)
#error "LARGEST_CHANGE and PARTIALS must be given, see above"
#endif
#include "vector_steps.cl"

#define ROW_GIVEN(slot) (given_rows + (size_t)(slot) * n)
#define COLUMN_GIVEN(slot) (given_columns + (size_t)(slot) * m)

// Arguments of every stage; partials, of two halves, are what groups leave to the next stage, numbers what the
// host reads.
#define STAGE_ARGUMENTS                                                                        \
    const uint n, const uint m, const uint control, const real k, const real epsilon,          \
    const real inverse_rho_source, const real inverse_rho_target,                              \
    const real source_mass, const real target_mass,                                            \
    const __global real* restrict given_rows,    /* (slots, n) */                              \
    const __global real* restrict given_columns, /* (slots, m) */                              \
    __global real* restrict rows,                /* (slots, n) */                              \
    __global real* restrict columns,             /* (slots, m) */                              \
    __global real* restrict partials,            /* (2, PARTIALS, groups) */                   \
    __global real* restrict numbers

#define STAGE_SETUP                                                                            \
    __local real shared[GROUP];                                                                \
    const uint groups = get_num_groups(0)

// The entries of a work-item: each group has consecutive ones.
#define ALL_GROUPS (get_num_groups(0) * STEP)
#define OWN_ENTRIES(size) (((size) + ALL_GROUPS - 1) / ALL_GROUPS * STEP)
#define OWN_FIRST(size) (get_group_id(0) * OWN_ENTRIES(size) + FIRST)
#define OWN_END(size) min((uint)((get_group_id(0) + 1) * OWN_ENTRIES(size)), (size))

// `partials` has two halves: one stage reads what the stage before has left in the other one.
#define LEFT(half, place) (partials + ((size_t)(half) * PARTIALS + (place)) * groups)

// The softmin of LANES rows from i on, from sums over stored pairs: `base` where the logarithm of the sum is
// 0, and what it was for rows without a stored pair.
INLINE reals stored_softmin(
    const __global float* maxima, const __global float* sums, const __global real* base,
    const __global real* alone, const real middle, const real k, const uint i)
{
    const reals m = TO_REALS(DLOAD(i, maxima));
    const reals logarithm = PLUS(PLUS(m, SPREAD(middle)), LOG2(TO_REALS(DLOAD(i, sums))));
    const reals softmin = MINUS(DLOAD(i, base), TIMES(logarithm, SPREAD(OVER(REAL(1), k))));
    return BELOW(REALS(0.4f * SENTINEL), m, softmin, DLOAD(i, alone));
}

// What sum_stored takes of a potential, before the middle is subtracted.
INLINE reals change_of(
    const reals potential, const reals origin, const reals weights, const real k)
{
    const reals change = TIMES(MINUS(potential, origin), SPREAD(k));
    const reals limited = SMALLER(LARGER(change, REALS(-LARGEST_CHANGE)), REALS(LARGEST_CHANGE));
    return BELOW(REALS(0), weights, limited, REALS(0));
}

// Leave the sum over the group, or the largest.
INLINE void leave(const real own, const bool largest, __global real* left, __local real* shared)
{
    const real found = group_reduced(own, largest, shared);
    if (get_local_id(0) == 0)
        left[get_group_id(0)] = found;
}

// The sum, or the largest, of what all groups have left, the same in every item.
INLINE real joined(
    const __global real* left, const uint groups, const bool largest, __local real* shared)
{
    real found = REAL(largest ? -INFINITY : 0.0f);
    for (uint group = get_local_id(0); group < groups; group += GROUP)
        found = largest ? LARGER(found, left[group]) : PLUS(found, left[group]);
    return group_reduced(found, largest, shared);
}

// Leave the largest term of sum_i weights_i exp(-rate potential_i) in the group, and the sum relative to it;
// that of no terms if nothing needs it. The loops are plain counted ones before the barriers of the reductions.
INLINE void leave_log_sum(
    const __global real* log_weights, const __global real* potential, const uint size,
    const real rate, const bool needed, __global real* tops, __global real* sums,
    __local real* shared)
{
    const uint end = needed ? OWN_END(size) : 0;
    reals most = REALS(-INFINITY), sum = REALS(0);
    for (uint i = OWN_FIRST(size); i < end; i += STEP)
        most = LARGER(most, log_scaled(DLOAD(i, log_weights), DLOAD(i, potential), rate));
    const real found = group_largest(largest_lane(most), shared);
    const real top = IS_BELOW(REAL(-INFINITY), found) ? found : REAL(0);
    for (uint i = OWN_FIRST(size); i < end; i += STEP)
        sum = PLUS(sum, EXP(MINUS(log_scaled(DLOAD(i, log_weights), DLOAD(i, potential), rate), SPREAD(top))));
    leave(sum_of_lanes(sum), false, sums, shared);
    if (get_local_id(0) == 0)
        tops[get_group_id(0)] = found;
}

// The logarithm of that sum over all groups; not used if nothing needed it.
INLINE real joined_log_sum(
    const __global real* tops, const __global real* sums, const uint groups, __local real* shared)
{
    const real top = joined(tops, groups, true, shared);
    real found = REAL(0);
    for (uint group = get_local_id(0); group < groups; group += GROUP)
        if (IS_BELOW(REAL(-INFINITY), tops[group])) // of a group without terms a pair's difference is not a number
            found = PLUS(found, TIMES(sums[group], EXP(MINUS(tops[group], top))));
    return PLUS(top, LOG(group_sum(found, shared)));
}

// The logarithm of the plan's mass after a half-step, whose sum `after` has moved with its shift.
INLINE real log_mass_of(
    const real after, const real shift, const real rate, const bool needed, const real side_mass)
{
    return needed ? PLUS(after, TIMES(shift, rate)) : LOG(side_mass);
}

INLINE real mass_of(const real log_mass)
{
    return EXP(SMALLER(log_mass, REAL(MAX_EXPONENT)));
}

// The part of the dual that belongs to a side: `along` is <weights, potential>.
INLINE real dual_part(
    const real side_mass, const real plan_mass, const real along, const real inverse_rho)
{
    return IS_BELOW(REAL(0), inverse_rho) ? OVER(MINUS(side_mass, plan_mass), inverse_rho) : along;
}

// The dual of a plan of this mass, from <a, f> and <b, g>.
#define DUAL(mass, along, other_along)                                                         \
    dual_of(epsilon, mass, dual_part(source_mass, mass, along, inverse_rho_source),            \
            dual_part(target_mass, mass, other_along, inverse_rho_target))

// What sum_stored takes of a new g: the host's, which is kept, or one of the columns' vectors.
//   changes_j = k (g_j - origin_j) - middle
// Shapes: g, changes (m,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void prepare_changes(
    STAGE_ARGUMENTS,
    const __global real* restrict start,  // (m,): the host's g
    __global float* restrict changes)     // (m,)
{
    const real middle = numbers[NUMBER_COLUMN_NEXT];
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        if (G_AT == COLUMN_START)
            DSTORE(DLOAD(i, start), i, COLUMN(COLUMN_START));
        const reals change = change_of(DLOAD(i, COLUMN(G_AT)), DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN)),
                                         DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)), k);
        DSTORE(TO_VSINGLE(MINUS(change, SPREAD(middle))), i, changes);
    }
    if (get_global_id(0) == 0)
        numbers[NUMBER_COLUMN_MIDDLE] = middle;
}

// T(g), and the sums of the translation of g.
//   T(g)_i = base_i - (middle + log2 of row i's sum) / k;  <a, exp(-T(g) / (rho_a + epsilon))>,  <b, exp(-g / rho_b)>
// Leaves 0, 1: the first sum, of the rows; 2, 3: the second, of the columns, each as its largest term and the rest;
// 4: no number if a softmin is not finite. Shapes: T(g) (n,), g (m,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void row_softmins(
    STAGE_ARGUMENTS,
    const __global float* restrict maxima,  // (n,)
    const __global float* restrict sums)    // (n,)
{
    STAGE_SETUP;
    const real middle = numbers[NUMBER_COLUMN_MIDDLE];
    RATES(source, target);
    reals unusual = REALS(0);
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
        const reals softmin = stored_softmin(
            maxima, sums, ROW_GIVEN(GIVEN_BASE), ROW_GIVEN(GIVEN_ALONE), middle, k, i);
        DSTORE(softmin, i, ROW(ROW_SOFTMIN));
        unusual = PLUS(unusual, TIMES(softmin, REALS(0)));
    }
    leave_log_sum(ROW_GIVEN(GIVEN_LOG_WEIGHTS), ROW(ROW_SOFTMIN), n, rate, needed,
                  LEFT(0, 0), LEFT(0, 1), shared);
    leave_log_sum(COLUMN_GIVEN(GIVEN_LOG_WEIGHTS), COLUMN(G_AT), m, inverse_rho_target, needed,
                  LEFT(0, 2), LEFT(0, 3), shared);
    leave(sum_of_lanes(unusual), false, LEFT(0, 4), shared);
}

// f, the shift of g, and the changes of f.
//   s = translation(g, T(g));  T(g) <- T(g) - s;  f = Delta_a T(g);  g <- g + s
//   changes_i = k (f_i - origin_i) - middle
// Leaves 0, 1: the largest changes of either sign; 2: the sum of the moves from the center by mass; 3, 4: the
// largest moves; 5, 6: <a, f> and <b, g>. Shapes: T(g), f, changes (n,), g (m,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void row_step(
    STAGE_ARGUMENTS,
    __global float* restrict changes)  // (n,)
{
    STAGE_SETUP;
    const real middle = numbers[NUMBER_ROW_NEXT];
    RATES(source, target);
    const real after = joined_log_sum(LEFT(0, 0), LEFT(0, 1), groups, shared);
    const real before = joined_log_sum(LEFT(0, 2), LEFT(0, 3), groups, shared);
    const real finite = joined(LEFT(0, 4), groups, false, shared);
    const real shift = translation(before, after, rates);
    reals up = REALS(-INFINITY), down = up, moved_up = up, moved_down = up;
    reals moved = REALS(0), along = REALS(0), other_along = REALS(0);
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
        const reals softmin = MINUS(DLOAD(i, ROW(ROW_SOFTMIN)), SPREAD(shift));
        const reals f = TIMES(SPREAD(damping), softmin);
        DSTORE(softmin, i, ROW(ROW_SOFTMIN));
        DSTORE(f, i, ROW(ROW_F));
        const reals weights = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
        const reals change = change_of(f, DLOAD(i, ROW_GIVEN(GIVEN_ORIGIN)), weights, k);
        DSTORE(TO_VSINGLE(MINUS(change, SPREAD(middle))), i, changes);
        up = LARGER(up, change);
        down = LARGER(down, NEGATIVE(change));
        const reals move = MINUS(f, DLOAD(i, ROW_GIVEN(GIVEN_CENTER)));
        moved = PLUS(moved, TIMES(weights, move));
        moved_up = LARGER(moved_up, BELOW(REALS(0), weights, move, REALS(-INFINITY)));
        moved_down = LARGER(moved_down, BELOW(REALS(0), weights, NEGATIVE(move), REALS(-INFINITY)));
        along = PLUS(along, TIMES(weights, f));
    }
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const reals g = PLUS(DLOAD(i, COLUMN(G_AT)), SPREAD(shift));
        DSTORE(g, i, COLUMN(COLUMN_SHIFTED));
        other_along = PLUS(other_along, TIMES(DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)), g));
    }
    leave(largest_lane(up), true, LEFT(1, 0), shared);
    leave(largest_lane(down), true, LEFT(1, 1), shared);
    leave(sum_of_lanes(moved), false, LEFT(1, 2), shared);
    leave(largest_lane(moved_up), true, LEFT(1, 3), shared);
    leave(largest_lane(moved_down), true, LEFT(1, 4), shared);
    leave(sum_of_lanes(along), false, LEFT(1, 5), shared);
    leave(sum_of_lanes(other_along), false, LEFT(1, 6), shared);
    if (get_global_id(0) == 0) {
        numbers[NUMBER_LOG_MASS] = log_mass_of(after, shift, rate, needed, source_mass);
        numbers[NUMBER_ROW_FINITE] = finite;
        numbers[NUMBER_ROW_MIDDLE] = middle;
    }
}

// T(f), the residual, and the sum of the translation of f; the dual of (f, g) from what row_step has left.
//   T(f)_j = base_j - (middle + log2 of column j's sum) / k;  <b, exp(-T(f) / (rho_b + epsilon))>
//   residual = max(|f - Delta_a T(g)|, |g - Delta_b T(f)|) / epsilon, where there is mass
// Leaves 0, 1: the sum, as its largest term and the rest; 2: the residual times epsilon; 3: no number if a softmin is
// not finite. Shapes: T(f) (m,), f, T(g) (n,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_softmins(
    STAGE_ARGUMENTS,
    const __global float* restrict maxima,  // (m,)
    const __global float* restrict sums)    // (m,)
{
    STAGE_SETUP;
    const real middle = numbers[NUMBER_ROW_MIDDLE];
    const real up = joined(LEFT(1, 0), groups, true, shared);
    const real down = joined(LEFT(1, 1), groups, true, shared);
    const real mean = OVER(joined(LEFT(1, 2), groups, false, shared), source_mass);
    const real moved_up = joined(LEFT(1, 3), groups, true, shared);
    const real moved_down = joined(LEFT(1, 4), groups, true, shared);
    const real along = joined(LEFT(1, 5), groups, false, shared);
    const real other_along = joined(LEFT(1, 6), groups, false, shared);
    const real row_damping = damping_of(epsilon, inverse_rho_source);
    RATES(target, source);
    reals farthest = REALS(0), unusual = REALS(0);
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP)
        farthest = LARGER(farthest, distance_of(DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS)), DLOAD(i, ROW(ROW_F)),
                                                TIMES(SPREAD(row_damping), DLOAD(i, ROW(ROW_SOFTMIN)))));
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const reals softmin = stored_softmin(
            maxima, sums, COLUMN_GIVEN(GIVEN_BASE), COLUMN_GIVEN(GIVEN_ALONE), middle, k, i);
        DSTORE(softmin, i, COLUMN(COLUMN_SOFTMIN));
        farthest = LARGER(farthest, distance_of(DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)),
                                                DLOAD(i, COLUMN(COLUMN_SHIFTED)), TIMES(SPREAD(damping), softmin)));
        unusual = PLUS(unusual, TIMES(softmin, REALS(0)));
    }
    leave_log_sum(COLUMN_GIVEN(GIVEN_LOG_WEIGHTS), COLUMN(COLUMN_SOFTMIN), m, rate, needed,
                  LEFT(0, 0), LEFT(0, 1), shared);
    leave(largest_lane(farthest), true, LEFT(0, 2), shared);
    leave(sum_of_lanes(unusual), false, LEFT(0, 3), shared);
    if (get_global_id(0) == 0) {
        const real mass = mass_of(numbers[NUMBER_LOG_MASS]);
        numbers[NUMBER_MASS] = mass;
        numbers[NUMBER_ROW_DUAL] = DUAL(mass, along, other_along);
        numbers[NUMBER_MOVED] = LARGER(MINUS(moved_up, mean), PLUS(moved_down, mean));
        numbers[NUMBER_ROW_NEXT] = TIMES(REAL(0.5f), MINUS(up, down));
    }
}

// The image g' of g, the shift of f, and the differences of iterates.
//   s = translation(f, T(f));  T(f) <- T(f) - s;  g' = Delta_b T(f);  f <- f + s;  r = g' - g
//   pi_j = b_j exp((g'_j - T(f)_j) / epsilon)
// Leaves 0: the sum of the marginal pi; 1: that of W r^2; 2, 3: <a, f> and <b, g'>; from 4 on inner products of the
// differences with the new one, and after these with r. Shapes: T(f), g', pi (m,), f (n,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_step(STAGE_ARGUMENTS)
{
    STAGE_SETUP;
    RATES(target, source);
    const real after = joined_log_sum(LEFT(0, 0), LEFT(0, 1), groups, shared);
    const real residual = OVER(joined(LEFT(0, 2), groups, true, shared), epsilon);
    const real finite = joined(LEFT(0, 3), groups, false, shared);
    // <a, exp(-f / rho)> is the mass of the plan after the half-step of f.
    const real shift = translation(numbers[NUMBER_LOG_MASS], after, rates);
    reals mass = REALS(0), square = mass, along = mass, other_along = mass;
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
        const reals f = PLUS(DLOAD(i, ROW(ROW_F)), SPREAD(shift));
        DSTORE(f, i, ROW(ROW_SHIFTED));
        along = PLUS(along, TIMES(DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS)), f));
    }
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const reals softmin = MINUS(DLOAD(i, COLUMN(COLUMN_SOFTMIN)), SPREAD(shift));
        const reals image = TIMES(SPREAD(damping), softmin);
        const reals weights = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
        const reals own = marginal(weights, DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS)), image, softmin, epsilon);
        DSTORE(softmin, i, COLUMN(COLUMN_SOFTMIN));
        DSTORE(own, i, COLUMN(COLUMN_MARGINAL));
        mass = PLUS(mass, own);
        other_along = PLUS(other_along, TIMES(weights, image));
        square = PLUS(square, remember(columns, m, control, i, image, own));
    }
    leave(sum_of_lanes(mass), false, LEFT(1, 0), shared);
    leave(sum_of_lanes(square), false, LEFT(1, 1), shared);
    leave(sum_of_lanes(along), false, LEFT(1, 2), shared);
    leave(sum_of_lanes(other_along), false, LEFT(1, 3), shared);
    for (uint first = 0; first < COUNT; first += BLOCK) {
        reals of_difference[BLOCK], of_residual[BLOCK];
        sum_products(columns, m, control, first, OWN_FIRST(m), OWN_END(m), of_difference, of_residual);
#pragma unroll
        for (uint k = 0; k < BLOCK; ++k) {
            leave(sum_of_lanes(of_difference[k]), false, LEFT(1, 4 + IN_BLOCK(first, k)), shared);
            leave(sum_of_lanes(of_residual[k]), false, LEFT(1, 4 + MEMORY + IN_BLOCK(first, k)), shared);
        }
    }
    if (get_global_id(0) == 0) {
        numbers[NUMBER_PLAN_MASS] = mass_of(log_mass_of(after, shift, rate, needed, target_mass));
        numbers[NUMBER_RESIDUAL_SIZE] = residual;
        numbers[NUMBER_COLUMN_FINITE] = finite;
    }
}

// The step from the image that the stored iterates give, and the dual of (f, g').
//   step = MIXED r - sum_j c_j AHEAD_j, where c solves the normal equations of the differences
// Leaves 0: the step's square by W; 1: its sum by the marginal. Shapes: step (m,), products (MEMORY, MEMORY). Launch:
// all work-groups, each of which solves the same small system.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void extrapolate(
    STAGE_ARGUMENTS,
    const __global real* restrict products,  // (MEMORY, MEMORY)
    __global real* restrict newest)          // (MEMORY,): inner products of the new difference
{
    STAGE_SETUP;
    SHARED real system[MEMORY * SYSTEM_ROW];
    const real marginals = joined(LEFT(1, 0), groups, false, shared);
    const real square = joined(LEFT(1, 1), groups, false, shared);
    const real along = joined(LEFT(1, 2), groups, false, shared);
    const real other_along = joined(LEFT(1, 3), groups, false, shared);
    for (uint j = 0; j < COUNT; ++j) {
        const real newest = joined(LEFT(1, 4 + j), groups, false, shared);
        const real right = joined(LEFT(1, 4 + MEMORY + j), groups, false, shared);
        if (get_local_id(0) == 0) {
            SYSTEM(j, NEWEST) = newest;
            SYSTEM(j, RIGHT) = right;
        }
    }
    const bool found = solve_normal(products, PLACE, COUNT, system);
    reals length = REALS(0), drift = REALS(0);
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const reals step = step_from_image(columns, m, control, i, system);
        DSTORE(step, i, COLUMN(COLUMN_STEP));
        length = PLUS(length, TIMES(TIMES(step, DLOAD(i, COLUMN(COLUMN_MASS))), step));
        drift = PLUS(drift, TIMES(step, DLOAD(i, COLUMN(COLUMN_MARGINAL))));
    }
    leave(sum_of_lanes(length), false, LEFT(0, 0), shared);
    leave(sum_of_lanes(drift), false, LEFT(0, 1), shared);
    if (get_global_id(0) == 0) {
        const real mass = numbers[NUMBER_PLAN_MASS];
        numbers[NUMBER_COLUMN_DUAL] = DUAL(mass, along, other_along);
        numbers[NUMBER_FOUND] = REAL(found);
        numbers[NUMBER_RESIDUAL_NORM] = ROOT(square);
        numbers[NUMBER_MARGINALS] = marginals;
        for (uint j = 0; j < COUNT; ++j)
            newest[j] = SYSTEM(j, NEWEST);
    }
}

// The next g and its changes: the guess, or the image without one.
//   g = g' + limit step, less its mean by the marginal if both sides are balanced
//   changes_j = k (g_j - origin_j) - middle
// Leaves 0, 1: the largest changes of either sign. Shapes: g, changes (m,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void next_potential(
    STAGE_ARGUMENTS,
    const real radius,
    __global float* restrict changes)  // (m,)
{
    STAGE_SETUP;
    const real middle = numbers[NUMBER_COLUMN_NEXT];
    const real longest = TIMES(radius, numbers[NUMBER_RESIDUAL_NORM]);
    const real length = ROOT(joined(LEFT(0, 0), groups, false, shared));
    const real factor = limit(length, longest);
    const real mean = OVER(joined(LEFT(0, 1), groups, false, shared), numbers[NUMBER_MARGINALS]);
    // Balanced potentials are unique up to a constant, along which nothing bounds an extrapolation.
    const bool damped = IS_BELOW(REAL(0), PLUS(inverse_rho_source, inverse_rho_target));
    const real drift = damped ? REAL(0) : TIMES(factor, mean);
    const bool found = IS_BELOW(REAL(0), numbers[NUMBER_FOUND]);
    reals up = REALS(-INFINITY), down = up;
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const reals image = DLOAD(i, COLUMN(COLUMN_IMAGE_0 + PARITY));
        const reals guess = MINUS(PLUS(image, TIMES(SPREAD(factor), DLOAD(i, COLUMN(COLUMN_STEP)))), SPREAD(drift));
        DSTORE(guess, i, COLUMN(COLUMN_GUESS_0 + PARITY));
        const reals change = change_of(found ? guess : image, DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN)),
                                         DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)), k);
        DSTORE(TO_VSINGLE(MINUS(change, SPREAD(middle))), i, changes);
        up = LARGER(up, change);
        down = LARGER(down, NEGATIVE(change));
    }
    leave(largest_lane(up), true, LEFT(1, 0), shared);
    leave(largest_lane(down), true, LEFT(1, 1), shared);
    if (get_global_id(0) == 0) {
        numbers[NUMBER_CUT] = REAL(found && IS_BELOW(longest, length));
        numbers[NUMBER_COLUMN_MIDDLE] = middle;
    }
}

// The middle of the changes of g, (largest + least) / 2, and the inner products of the new difference.
// Shapes: partials (2, PARTIALS, groups), products (MEMORY, MEMORY). Launch: one work-group.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void end_iteration(
    STAGE_ARGUMENTS,
    const uint groups,
    const __global real* restrict newest,  // (MEMORY,)
    __global real* restrict products)      // (MEMORY, MEMORY)
{
    __local real shared[GROUP];
    const real up = joined(LEFT(1, 0), groups, true, shared);
    const real down = joined(LEFT(1, 1), groups, true, shared);
    for (uint j = get_local_id(0); j < COUNT; j += GROUP)
        store_products(products, newest[j], j, PLACE);
    if (get_local_id(0) == 0)
        numbers[NUMBER_COLUMN_NEXT] = TIMES(REAL(0.5f), MINUS(up, down));
}
