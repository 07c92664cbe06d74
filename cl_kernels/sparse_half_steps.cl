// A Sinkhorn iteration over the stored pairs of a plan, float64: the half-steps of half_steps.cl on the sparse
// kernel that sum_stored of sliced_ellpack.cl sums, in many work-groups. The formulas, those of Algorithm 1 of
// Sejourne, Vialard and Peyre (2022), stand in vector_steps.cl.
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

#ifndef LARGEST_CHANGE
#error "LARGEST_CHANGE (limit of the changes of potentials) must be given"
#endif
#ifndef PARTIALS
#error "PARTIALS (largest number of sums of a stage) must be given"
#endif

#include "vector_steps.cl"

#define ROW_GIVEN(slot) (given_rows + (size_t)(slot) * n)
#define COLUMN_GIVEN(slot) (given_columns + (size_t)(slot) * m)

// The entries of a work-item: each group has consecutive ones.
#define ALL_GROUPS (get_num_groups(0) * STEP)
#define OWN_ENTRIES(size) (((size) + ALL_GROUPS - 1) / ALL_GROUPS * STEP)
#define OWN_FIRST(size) (get_group_id(0) * OWN_ENTRIES(size) + FIRST)
#define OWN_END(size) min((uint)((get_group_id(0) + 1) * OWN_ENTRIES(size)), (size))

// `partials` has two halves: one stage reads what the stage before has left in the other one.
#define LEFT(half, place) (partials + ((size_t)(half) * PARTIALS + (place)) * groups)

// The softmin of LANES rows from i on, from sums over stored pairs: `base` where the logarithm of the sum is
// 0, and what it was for rows without a stored pair.
INLINE vdouble stored_softmin(
    const __global float* maxima, const __global float* sums, const __global double* base,
    const __global double* alone, const double middle, const double k, const uint i)
{
    const vdouble m = TO_VDOUBLE(SLOAD(i, maxima));
    const vdouble logarithm = m + (vdouble)(middle) + log2(TO_VDOUBLE(SLOAD(i, sums)));
    const vdouble softmin = DLOAD(i, base) - logarithm * (vdouble)(1.0 / k);
    return m > (vdouble)(0.4 * (double)SENTINEL) ? softmin : DLOAD(i, alone);
}

// What sum_stored takes of a potential, before the middle is subtracted.
INLINE vdouble change_of(
    const vdouble potential, const vdouble origin, const vdouble weights, const double k)
{
    const vdouble most = (vdouble)((double)LARGEST_CHANGE);
    const vdouble change = fmin(fmax((potential - origin) * (vdouble)(k), -most), most);
    return weights > (vdouble)(0.0) ? change : (vdouble)(0.0);
}

// Leave the sum over the group, or the largest.
INLINE void leave(const double own, const bool largest, __global double* left, __local double* shared)
{
    const double found = group_reduced(own, largest, shared);
    if (get_local_id(0) == 0)
        left[get_group_id(0)] = found;
}

// The sum, or the largest, of what all groups have left, the same in every item.
INLINE double joined(
    const __global double* left, const uint groups, const bool largest, __local double* shared)
{
    double found = largest ? -INFINITY : 0.0;
    for (uint group = get_local_id(0); group < groups; group += GROUP)
        found = largest ? fmax(found, left[group]) : found + left[group];
    return group_reduced(found, largest, shared);
}

// Leave the largest term of sum_i weights_i exp(-rate potential_i) in the group, and the sum relative to it;
// that of no terms if nothing needs it. The loops are plain counted ones before the barriers of the reductions.
INLINE void leave_log_sum(
    const __global double* log_weights, const __global double* potential, const uint size,
    const double rate, const bool needed, __global double* tops, __global double* sums,
    __local double* shared)
{
    const uint end = needed ? OWN_END(size) : 0;
    vdouble most = (vdouble)(-INFINITY), sum = (vdouble)(0.0);
    for (uint i = OWN_FIRST(size); i < end; i += STEP)
        most = fmax(most, log_scaled(DLOAD(i, log_weights), DLOAD(i, potential), rate));
    const double found = group_largest(largest_lane(most), shared);
    const double top = found > -INFINITY ? found : 0.0;
    for (uint i = OWN_FIRST(size); i < end; i += STEP)
        sum += exp(log_scaled(DLOAD(i, log_weights), DLOAD(i, potential), rate) - (vdouble)(top));
    leave(sum_of_lanes(sum), false, sums, shared);
    if (get_local_id(0) == 0)
        tops[get_group_id(0)] = found;
}

// The logarithm of that sum over all groups; not used if nothing needed it.
INLINE double joined_log_sum(
    const __global double* tops, const __global double* sums, const uint groups, __local double* shared)
{
    const double top = joined(tops, groups, true, shared);
    double found = 0.0;
    for (uint group = get_local_id(0); group < groups; group += GROUP)
        found += sums[group] * exp(tops[group] - top);
    return top + log(group_sum(found, shared));
}

INLINE double mass_of(const double log_mass)
{
    return exp(fmin(log_mass, (double)MAX_EXPONENT));
}

// The part of the dual that belongs to a side: `along` is <weights, potential>.
INLINE double dual_part(
    const double side_mass, const double plan_mass, const double along, const double inverse_rho)
{
    return inverse_rho == 0.0 ? along : (side_mass - plan_mass) / inverse_rho;
}

// What sum_stored takes of a new g: the host's, which is kept, or one of the columns' vectors.
//   changes_j = k (g_j - origin_j) - middle
// Shapes: g, changes (m,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void prepare_changes(
    const uint m, const uint control, const double k,
    const __global double* restrict start,          // (m,): the host's g
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict columns,              // (slots, m)
    __global float* restrict changes,               // (m,)
    __global double* restrict numbers)
{
    const double middle = numbers[NUMBER_COLUMN_NEXT];
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        if (G_AT == COLUMN_START)
            DSTORE(DLOAD(i, start), i, COLUMN(COLUMN_START));
        const vdouble change = change_of(DLOAD(i, COLUMN(G_AT)), DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN)),
                                         DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)), k);
        SSTORE(TO_VSINGLE(change - (vdouble)(middle)), i, changes);
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
    const uint n, const uint m, const uint control, const double k, const double epsilon,
    const double inverse_rho_source, const double inverse_rho_target,
    const __global float* restrict maxima,          // (n,)
    const __global float* restrict sums,            // (n,)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,                 // (slots, n)
    const __global double* restrict columns,        // (slots, m)
    __global double* restrict partials,             // (2, PARTIALS, groups)
    const __global double* restrict numbers)
{
    __local double shared[GROUP];
    const uint groups = get_num_groups(0);
    const double middle = numbers[NUMBER_COLUMN_MIDDLE];
    const double rate = inverse_rho_source * damping_of(epsilon, inverse_rho_source);
    const bool needed = rate + inverse_rho_target > 0.0;
    vdouble unusual = (vdouble)(0.0);
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
        const vdouble softmin = stored_softmin(
            maxima, sums, ROW_GIVEN(GIVEN_BASE), ROW_GIVEN(GIVEN_ALONE), middle, k, i);
        DSTORE(softmin, i, ROW(ROW_SOFTMIN));
        unusual += softmin * (vdouble)(0.0);
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
    const uint n, const uint m, const uint control, const double k, const double epsilon,
    const double inverse_rho_source, const double inverse_rho_target, const double source_mass,
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,                 // (slots, n)
    __global double* restrict columns,              // (slots, m)
    __global float* restrict changes,               // (n,)
    __global double* restrict partials,             // (2, PARTIALS, groups)
    __global double* restrict numbers)
{
    __local double shared[GROUP];
    const uint groups = get_num_groups(0);
    const double middle = numbers[NUMBER_ROW_NEXT];
    const double damping = damping_of(epsilon, inverse_rho_source);
    const double rate = inverse_rho_source * damping, rates = rate + inverse_rho_target;
    const double after = joined_log_sum(LEFT(0, 0), LEFT(0, 1), groups, shared);
    const double before = joined_log_sum(LEFT(0, 2), LEFT(0, 3), groups, shared);
    const double finite = joined(LEFT(0, 4), groups, false, shared);
    const double shift = translation(before, after, rates);
    vdouble up = (vdouble)(-INFINITY), down = up, moved_up = up, moved_down = up;
    vdouble moved = (vdouble)(0.0), along = (vdouble)(0.0), other_along = (vdouble)(0.0);
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
        const vdouble softmin = DLOAD(i, ROW(ROW_SOFTMIN)) - (vdouble)(shift);
        const vdouble f = (vdouble)(damping) * softmin;
        DSTORE(softmin, i, ROW(ROW_SOFTMIN));
        DSTORE(f, i, ROW(ROW_F));
        const vdouble weights = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
        const vdouble change = change_of(f, DLOAD(i, ROW_GIVEN(GIVEN_ORIGIN)), weights, k);
        SSTORE(TO_VSINGLE(change - (vdouble)(middle)), i, changes);
        up = fmax(up, change);
        down = fmax(down, -change);
        const vdouble move = f - DLOAD(i, ROW_GIVEN(GIVEN_CENTER));
        moved += weights * move;
        moved_up = fmax(moved_up, weights > (vdouble)(0.0) ? move : (vdouble)(-INFINITY));
        moved_down = fmax(moved_down, weights > (vdouble)(0.0) ? -move : (vdouble)(-INFINITY));
        along += weights * f;
    }
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const vdouble g = DLOAD(i, COLUMN(G_AT)) + (vdouble)(shift);
        DSTORE(g, i, COLUMN(COLUMN_SHIFTED));
        other_along += DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)) * g;
    }
    leave(largest_lane(up), true, LEFT(1, 0), shared);
    leave(largest_lane(down), true, LEFT(1, 1), shared);
    leave(sum_of_lanes(moved), false, LEFT(1, 2), shared);
    leave(largest_lane(moved_up), true, LEFT(1, 3), shared);
    leave(largest_lane(moved_down), true, LEFT(1, 4), shared);
    leave(sum_of_lanes(along), false, LEFT(1, 5), shared);
    leave(sum_of_lanes(other_along), false, LEFT(1, 6), shared);
    if (get_global_id(0) == 0) {
        numbers[NUMBER_LOG_MASS] = rates > 0.0 ? after + shift * rate : log(source_mass);
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
    const uint n, const uint m, const double k, const double epsilon,
    const double inverse_rho_source, const double inverse_rho_target, const double source_mass,
    const double target_mass,
    const __global float* restrict maxima,          // (m,)
    const __global float* restrict sums,            // (m,)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    const __global double* restrict rows,           // (slots, n)
    __global double* restrict columns,              // (slots, m)
    __global double* restrict partials,             // (2, PARTIALS, groups)
    __global double* restrict numbers)
{
    __local double shared[GROUP];
    const uint groups = get_num_groups(0);
    const double middle = numbers[NUMBER_ROW_MIDDLE];
    const double up = joined(LEFT(1, 0), groups, true, shared);
    const double down = joined(LEFT(1, 1), groups, true, shared);
    const double mean = joined(LEFT(1, 2), groups, false, shared) / source_mass;
    const double moved_up = joined(LEFT(1, 3), groups, true, shared);
    const double moved_down = joined(LEFT(1, 4), groups, true, shared);
    const double along = joined(LEFT(1, 5), groups, false, shared);
    const double other_along = joined(LEFT(1, 6), groups, false, shared);
    const double row_damping = damping_of(epsilon, inverse_rho_source);
    const double damping = damping_of(epsilon, inverse_rho_target);
    const double rate = inverse_rho_target * damping;
    vdouble farthest = (vdouble)(0.0), unusual = (vdouble)(0.0);
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP)
        farthest = fmax(farthest, distance_of(DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS)), DLOAD(i, ROW(ROW_F)),
                                              (vdouble)(row_damping) * DLOAD(i, ROW(ROW_SOFTMIN))));
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const vdouble softmin = stored_softmin(
            maxima, sums, COLUMN_GIVEN(GIVEN_BASE), COLUMN_GIVEN(GIVEN_ALONE), middle, k, i);
        DSTORE(softmin, i, COLUMN(COLUMN_SOFTMIN));
        farthest = fmax(farthest, distance_of(DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)),
                                              DLOAD(i, COLUMN(COLUMN_SHIFTED)), (vdouble)(damping) * softmin));
        unusual += softmin * (vdouble)(0.0);
    }
    leave_log_sum(COLUMN_GIVEN(GIVEN_LOG_WEIGHTS), COLUMN(COLUMN_SOFTMIN), m, rate,
                  rate + inverse_rho_source > 0.0, LEFT(0, 0), LEFT(0, 1), shared);
    leave(largest_lane(farthest), true, LEFT(0, 2), shared);
    leave(sum_of_lanes(unusual), false, LEFT(0, 3), shared);
    if (get_global_id(0) == 0) {
        const double mass = mass_of(numbers[NUMBER_LOG_MASS]);
        numbers[NUMBER_MASS] = mass;
        numbers[NUMBER_ROW_DUAL] = -epsilon * mass + dual_part(source_mass, mass, along, inverse_rho_source)
            + dual_part(target_mass, mass, other_along, inverse_rho_target);
        numbers[NUMBER_MOVED] = fmax(moved_up - mean, moved_down + mean);
        numbers[NUMBER_ROW_NEXT] = 0.5 * (up - down);
    }
}

// The image g' of g, the shift of f, and the differences of iterates.
//   s = translation(f, T(f));  T(f) <- T(f) - s;  g' = Delta_b T(f);  f <- f + s;  r = g' - g
//   pi_j = b_j exp((g'_j - T(f)_j) / epsilon)
// Leaves 0: the sum of the marginal pi; 1: that of W r^2; 2, 3: <a, f> and <b, g'>; from 4 on inner products of the
// differences with the new one, and after these with r. Shapes: T(f), g', pi (m,), f (n,). Launch: all work-groups.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_step(
    const uint n, const uint m, const uint control, const double epsilon,
    const double inverse_rho_source, const double inverse_rho_target, const double target_mass,
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,                 // (slots, n)
    __global double* restrict columns,              // (slots, m)
    __global double* restrict partials,             // (2, PARTIALS, groups)
    __global double* restrict numbers)
{
    __local double shared[GROUP];
    const uint groups = get_num_groups(0);
    const double damping = damping_of(epsilon, inverse_rho_target);
    const double rate = inverse_rho_target * damping, rates = rate + inverse_rho_source;
    const double after = joined_log_sum(LEFT(0, 0), LEFT(0, 1), groups, shared);
    const double residual = joined(LEFT(0, 2), groups, true, shared) / epsilon;
    const double finite = joined(LEFT(0, 3), groups, false, shared);
    // <a, exp(-f / rho)> is the mass of the plan after the half-step of f.
    const double shift = translation(numbers[NUMBER_LOG_MASS], after, rates);
    vdouble mass = (vdouble)(0.0), square = mass, along = mass, other_along = mass;
    for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
        const vdouble f = DLOAD(i, ROW(ROW_F)) + (vdouble)(shift);
        DSTORE(f, i, ROW(ROW_SHIFTED));
        along += DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS)) * f;
    }
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const vdouble softmin = DLOAD(i, COLUMN(COLUMN_SOFTMIN)) - (vdouble)(shift);
        const vdouble image = (vdouble)(damping) * softmin;
        const vdouble weights = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
        const vdouble own = marginal(weights, DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS)), image, softmin, epsilon);
        DSTORE(softmin, i, COLUMN(COLUMN_SOFTMIN));
        DSTORE(own, i, COLUMN(COLUMN_MARGINAL));
        mass += own;
        other_along += weights * image;
        square += remember(columns, m, control, i, image, own);
    }
    leave(sum_of_lanes(mass), false, LEFT(1, 0), shared);
    leave(sum_of_lanes(square), false, LEFT(1, 1), shared);
    leave(sum_of_lanes(along), false, LEFT(1, 2), shared);
    leave(sum_of_lanes(other_along), false, LEFT(1, 3), shared);
    for (uint first = 0; first < COUNT; first += BLOCK) {
        vdouble of_difference[BLOCK], of_residual[BLOCK];
        sum_products(columns, m, control, first, OWN_FIRST(m), OWN_END(m), of_difference, of_residual);
#pragma unroll
        for (uint k = 0; k < BLOCK; ++k) {
            leave(sum_of_lanes(of_difference[k]), false, LEFT(1, 4 + IN_BLOCK(first, k)), shared);
            leave(sum_of_lanes(of_residual[k]), false, LEFT(1, 4 + MEMORY + IN_BLOCK(first, k)), shared);
        }
    }
    if (get_global_id(0) == 0) {
        numbers[NUMBER_PLAN_MASS] = mass_of(rates > 0.0 ? after + shift * rate : log(target_mass));
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
    const uint m, const uint control, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double source_mass, const double target_mass,
    __global double* restrict columns,              // (slots, m)
    __global double* restrict partials,             // (2, PARTIALS, groups)
    const __global double* restrict products,       // (MEMORY, MEMORY)
    __global double* restrict newest,               // (MEMORY,): inner products of the new difference
    __global double* restrict numbers)
{
    __local double shared[GROUP];
    SHARED double system[MEMORY * SYSTEM_ROW];
    const uint groups = get_num_groups(0);
    const double marginals = joined(LEFT(1, 0), groups, false, shared);
    const double square = joined(LEFT(1, 1), groups, false, shared);
    const double along = joined(LEFT(1, 2), groups, false, shared);
    const double other_along = joined(LEFT(1, 3), groups, false, shared);
    for (uint j = 0; j < COUNT; ++j) {
        const double newest = joined(LEFT(1, 4 + j), groups, false, shared);
        const double right = joined(LEFT(1, 4 + MEMORY + j), groups, false, shared);
        if (get_local_id(0) == 0) {
            SYSTEM(j, NEWEST) = newest;
            SYSTEM(j, RIGHT) = right;
        }
    }
    const bool found = solve_normal(products, PLACE, COUNT, system);
    vdouble length = (vdouble)(0.0), drift = (vdouble)(0.0);
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const vdouble step = step_from_image(columns, m, control, i, system);
        DSTORE(step, i, COLUMN(COLUMN_STEP));
        length += step * DLOAD(i, COLUMN(COLUMN_MASS)) * step;
        drift += step * DLOAD(i, COLUMN(COLUMN_MARGINAL));
    }
    leave(sum_of_lanes(length), false, LEFT(0, 0), shared);
    leave(sum_of_lanes(drift), false, LEFT(0, 1), shared);
    if (get_global_id(0) == 0) {
        const double mass = numbers[NUMBER_PLAN_MASS];
        numbers[NUMBER_COLUMN_DUAL] = -epsilon * mass + dual_part(source_mass, mass, along, inverse_rho_source)
            + dual_part(target_mass, mass, other_along, inverse_rho_target);
        numbers[NUMBER_FOUND] = found;
        numbers[NUMBER_RESIDUAL_NORM] = sqrt(square);
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
    const uint m, const uint control, const double k, const double inverse_rho_source,
    const double inverse_rho_target, const double radius,
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict columns,              // (slots, m)
    __global float* restrict changes,               // (m,)
    __global double* restrict partials,             // (2, PARTIALS, groups)
    __global double* restrict numbers)
{
    __local double shared[GROUP];
    const uint groups = get_num_groups(0);
    const double middle = numbers[NUMBER_COLUMN_NEXT];
    const double longest = radius * numbers[NUMBER_RESIDUAL_NORM];
    const double length = sqrt(joined(LEFT(0, 0), groups, false, shared));
    const double factor = limit(length, longest);
    const double mean = joined(LEFT(0, 1), groups, false, shared) / numbers[NUMBER_MARGINALS];
    // Balanced potentials are unique up to a constant, along which nothing bounds an extrapolation.
    const double drift = inverse_rho_source == 0.0 && inverse_rho_target == 0.0 ? factor * mean : 0.0;
    const bool found = numbers[NUMBER_FOUND] != 0.0;
    vdouble up = (vdouble)(-INFINITY), down = up;
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        const vdouble image = DLOAD(i, COLUMN(COLUMN_IMAGE_0 + PARITY));
        const vdouble guess = image + (vdouble)(factor) * DLOAD(i, COLUMN(COLUMN_STEP)) - (vdouble)(drift);
        DSTORE(guess, i, COLUMN(COLUMN_GUESS_0 + PARITY));
        const vdouble change = change_of(found ? guess : image, DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN)),
                                         DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS)), k);
        SSTORE(TO_VSINGLE(change - (vdouble)(middle)), i, changes);
        up = fmax(up, change);
        down = fmax(down, -change);
    }
    leave(largest_lane(up), true, LEFT(1, 0), shared);
    leave(largest_lane(down), true, LEFT(1, 1), shared);
    if (get_global_id(0) == 0) {
        numbers[NUMBER_CUT] = found && length > longest;
        numbers[NUMBER_COLUMN_MIDDLE] = middle;
    }
}

// The middle of the changes of g, (largest + least) / 2, and the inner products of the new difference.
// Shapes: partials (2, PARTIALS, groups), products (MEMORY, MEMORY). Launch: one work-group.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void end_iteration(
    const uint control, const uint groups,
    const __global double* restrict partials,       // (2, PARTIALS, groups)
    const __global double* restrict newest,         // (MEMORY,)
    __global double* restrict products,             // (MEMORY, MEMORY)
    __global double* restrict numbers)
{
    __local double shared[GROUP];
    const double up = joined(LEFT(1, 0), groups, true, shared);
    const double down = joined(LEFT(1, 1), groups, true, shared);
    for (uint j = get_local_id(0); j < COUNT; j += GROUP)
        store_products(products, newest[j], j, PLACE);
    if (get_local_id(0) == 0)
        numbers[NUMBER_COLUMN_NEXT] = 0.5 * (up - down);
}
