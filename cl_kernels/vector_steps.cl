// The arithmetic between two softmins, in the numbers of reals.cl, for half_steps.cl and sparse_half_steps.cl: damping,
// translation, marginals and dual (paper, 2.1 and 3.1; Problem in clmorph/transport/_solver/problem.py), and
// Anderson's acceleration (anderson.py there). Both files do it in loops over the entries of vectors.
//
// Algorithm 1 of Sejourne, Vialard and Peyre (2022), unbalanced Sinkhorn in the log domain, where KL penalties
// have aprox(p) = Delta p, line by line, with what each line is called here:
//
//   T(g)_i = -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)        softmin: log_sum_exp.cl, sum_stored
//   s = (log <b, exp(-g / rho_b)> - log <a, exp(-T(g) / (rho_a + epsilon))>)
//       / (1 / (rho_a + epsilon) + 1 / rho_b)                          translation: the best g + s of all s
//   g <- g + s,  T(g) <- T(g) - s                                      so T(g + s) = T(g) - s
//   f <- -aprox(-T(g)) = Delta_a T(g)                                  half-step
//   the same with f and g, a and b exchanged                           T(f), g' = Delta_b T(f), f <- f + s
//   stop by |f - Delta_a T(g)|, |g - Delta_b T(f)|                     residual, in units of epsilon
//
//   Delta = rho / (rho + epsilon) = 1 / (1 + epsilon / rho), 1 if the side is balanced
//   marginal     pi_i = a_i exp((f_i - T(g)_i) / epsilon)
//   dual         -epsilon m(pi) + sum over both sides of <a, rho (1 - exp(-f / rho))>, <a, f> if balanced
//   next g       g' + limit (MIXED r - sum_j c_j AHEAD_j), r = g' - g: Anderson's acceleration, where c solves
//                (D^T W D) c = D^T W r, D the differences of residuals, W the first marginal
//
// Launch: work-groups of GROUP; item l takes the entries l * LANES + k * GROUP * LANES, k = 0, 1, ...,
// of those of its group. In a launch each item reads only entries of vectors that it wrote itself, so that
// barriers are needed by sums alone.
//
// Shapes: n points of the rows, m of the columns; `rows` and `columns` have one vector after the other.
//
// -D GROUP   work-items of the group, a power of two
// -D MEMORY  differences of iterates that the acceleration stores
// -D RIDGE_PPT  regularization of its normal equations, in units of 10^-12
// -D MIXING_PERCENT  share of the remaining residual that is added, in percent
// -D MAX_EXPONENT  largest argument of exp, so that nothing overflows
// -D ROW_*, COLUMN_*, NUMBER_*  places of vectors and numbers

#include "common.cl"
#include "reals.cl"

#if !defined(GROUP) || !defined(MEMORY) \
    || !defined(RIDGE_PPT) || !defined(MIXING_PERCENT) || !defined(MAX_EXPONENT)
#error "GROUP, MEMORY, RIDGE_PPT, MIXING_PERCENT and MAX_EXPONENT must be given, see above"
#endif
#define FIRST (get_local_id(0) * LANES)
#define STEP (GROUP * LANES)

// A work-group of one needs no barrier. Long functions without one are not inlined, as Intel's compiler
// takes twice as long otherwise.
#if GROUP > 1
#define STEP_BARRIER() barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE)
#define LONG_FUNCTION static inline
#define SHARED __local
#else
#define STEP_BARRIER()
#define SHARED // PoCL 3.1 gives groups that run at once one local array where a function is not inlined
#define LONG_FUNCTION static __attribute__((noinline))
#endif

#define MIXED REALS((MIXING_PERCENT - 100) / 100.0f)

// A vector of the rows or of the columns, and those of the acceleration.
#define ROW(slot) (rows + (size_t)(slot) * n)
#define COLUMN(slot) (columns + (size_t)(slot) * m)
#define AHEAD(j) COLUMN(COLUMN_AHEAD + (j))
#define DIFFERENCES(j) COLUMN(COLUMN_DIFFERENCES + (j))

// `control` has the source of g (0: the host; 1: the last image; 2: the last guess), the parity of the iterate,
// whether an iterate is stored, the place of its difference, and the number of differences.
#define PARITY (control >> 2 & 1u)
#define BEGUN (control >> 3 & 1u)
#define PLACE (control >> 4 & 15u)
#define COUNT (control >> 8)
#define G_AT                                                                                   \
    ((control & 3u) == 0 ? COLUMN_START                                                        \
                         : ((control & 3u) == 1 ? COLUMN_IMAGE_1 : COLUMN_GUESS_1) - PARITY)

INLINE real sum_of_lanes(const reals v)
{
    real lanes[LANES];
    DSTORE(v, 0, lanes);
    real sum = REAL(0);
    for (int l = 0; l < LANES; ++l)
        sum = PLUS(sum, lanes[l]);
    return sum;
}

INLINE real largest_lane(const reals v)
{
    real lanes[LANES];
    DSTORE(v, 0, lanes);
    real largest = lanes[0];
    for (int l = 1; l < LANES; ++l)
        largest = LARGER(largest, lanes[l]);
    return largest;
}

// The sum of x over the group, or the largest, the same number in every item.
INLINE real group_reduced(const real x, const bool largest, __local real* shared)
{
#if GROUP > 1
    const uint item = get_local_id(0);
    STEP_BARRIER();
    shared[item] = x;
    for (uint half_size = GROUP / 2; half_size > 0; half_size /= 2) {
        STEP_BARRIER();
        if (item < half_size) {
            const real other = shared[item + half_size];
            shared[item] = largest ? LARGER(shared[item], other) : PLUS(shared[item], other);
        }
    }
    STEP_BARRIER();
    return shared[0];
#else
    return x;
#endif
}

#define group_sum(x, shared) group_reduced(x, false, shared)
#define group_largest(x, shared) group_reduced(x, true, shared)

INLINE real damping_of(const real epsilon, const real inverse_rho)
{
    return OVER(REAL(1), PLUS(REAL(1), TIMES(epsilon, inverse_rho)));
}

// The damping of a half-step of the side `own`, source or target; the rates 1 / (rho + epsilon) of that side and,
// with 1 / rho of the other one, of both; and whether they are above 0: else both sides are balanced.
#define RATES(own, other)                                                                      \
    const real damping = damping_of(epsilon, inverse_rho_##own);                               \
    const real rate = TIMES(inverse_rho_##own, damping), rates = PLUS(rate, inverse_rho_##other); \
    const bool needed = IS_BELOW(REAL(0), rates)

// The logarithm of weights exp(-rate potential), whose sums give the translation.
INLINE reals log_scaled(const reals log_weights, const reals potential, const real rate)
{
    return MINUS(log_weights, TIMES(potential, SPREAD(rate)));
}

// The best translation from the logarithms of both sums; 0 if `rates`, the sum of both rates, is.
INLINE real translation(const real log_before, const real log_after, const real rates)
{
    return IS_BELOW(REAL(0), rates) ? OVER(MINUS(log_before, log_after), rates) : REAL(0);
}

INLINE reals marginal(
    const reals weights, const reals log_weights, const reals potential, const reals softmin,
    const real epsilon)
{
    const reals exponent = PLUS(OVER(MINUS(potential, softmin), SPREAD(epsilon)), log_weights);
    const reals mass = EXP(SMALLER(exponent, REALS(MAX_EXPONENT)));
    return BELOW(REALS(0), weights, mass, REALS(0));
}

// The dual without its constant, from the parts of both sides.
INLINE real dual_of(const real epsilon, const real plan_mass, const real of_rows, const real of_columns)
{
    return PLUS(PLUS(TIMES(NEGATIVE(epsilon), plan_mass), of_rows), of_columns);
}

// How far a potential is from its half-step, where the side has mass.
INLINE reals distance_of(const reals weights, const reals potential, const reals half_step)
{
    return BELOW(REALS(0), weights, SIZE(MINUS(potential, half_step)), REALS(0));
}

// Store an iterate, whose image is T's, and the difference from the last one; `mass` is its marginal. Returns
// the terms of the residual's square.
INLINE reals remember(
    __global real* columns, const uint m, const uint control, const uint i, const reals image,
    const reals mass)
{
    const reals residual = MINUS(image, DLOAD(i, COLUMN(G_AT)));
    reals weights = mass, change = REALS(0), ahead = REALS(0);
    if (BEGUN) { // the inner product keeps the marginal of the first iterate
        weights = DLOAD(i, COLUMN(COLUMN_MASS));
        change = MINUS(residual, DLOAD(i, COLUMN(COLUMN_RESIDUAL_1 - PARITY)));
        ahead = PLUS(MINUS(image, DLOAD(i, COLUMN(COLUMN_IMAGE_1 - PARITY))), TIMES(MIXED, change));
    }
    DSTORE(image, i, COLUMN(COLUMN_IMAGE_0 + PARITY));
    DSTORE(residual, i, COLUMN(COLUMN_RESIDUAL_0 + PARITY));
    DSTORE(weights, i, COLUMN(COLUMN_MASS));
    DSTORE(change, i, DIFFERENCES(PLACE));
    DSTORE(ahead, i, AHEAD(PLACE));
    return TIMES(TIMES(residual, weights), residual);
}

// Inner products of BLOCK differences, from `first` on, with the new one and with the residual, over the entries
// of a work-item: few at once, so that their sums stay in registers. Those after the last are the last one's.
#define BLOCK 4
#define IN_BLOCK(first, k) min((first) + (k), COUNT - 1)

INLINE void sum_products(
    const __global real* columns, const uint m, const uint control, const uint first, const uint begin,
    const uint end, reals* of_difference, reals* of_residual)
{
    for (uint k = 0; k < BLOCK; ++k)
        of_difference[k] = of_residual[k] = REALS(0);
    for (uint i = begin; i < end; i += STEP) {
        const reals weights = DLOAD(i, COLUMN(COLUMN_MASS)), change = DLOAD(i, DIFFERENCES(PLACE));
        const reals residual = DLOAD(i, COLUMN(COLUMN_RESIDUAL_0 + PARITY));
        for (uint k = 0; k < BLOCK; ++k) {
            const reals weighted = TIMES(DLOAD(i, DIFFERENCES(IN_BLOCK(first, k))), weights);
            of_difference[k] = PLUS(of_difference[k], TIMES(weighted, change));
            of_residual[k] = PLUS(of_residual[k], TIMES(weighted, residual));
        }
    }
}

// The normal equations in `system`: difference i has a row, with its row of the matrix first, and then its inner
// products with the residual and with the new difference, its length, and its coefficient.
#define SYSTEM_ROW (2 * MEMORY) // a power of two
#define RIGHT MEMORY
#define NEWEST (MEMORY + 1)
#define SCALE (MEMORY + 2)
#define COEFFICIENT (MEMORY + 3)
#define SYSTEM(i, column) system[(i) * SYSTEM_ROW + (column)]

// The step from the image that the coefficients give, before it is limited.
INLINE reals step_from_image(
    const __global real* columns, const uint m, const uint control, const uint i,
    const SHARED real* system)
{
    reals step = TIMES(MIXED, DLOAD(i, COLUMN(COLUMN_RESIDUAL_0 + PARITY)));
    for (uint j = 0; j < COUNT; ++j)
        step = MINUS(step, TIMES(SPREAD(SYSTEM(j, COEFFICIENT)), DLOAD(i, AHEAD(j))));
    return step;
}

// The factor that keeps a step in the trust region.
INLINE real limit(const real length, const real longest)
{
    return SMALLER(REAL(1), OVER(longest, LARGER(length, LEAST_REAL)));
}

// Solve the normal equations, whose columns RIGHT and NEWEST are given, for the coefficients, and return whether
// they are determined. The difference at `place` is new; the first `count` are stored.
LONG_FUNCTION bool solve_normal(
    const __global real* products, // (MEMORY, MEMORY): inner products of the older differences
    const uint place, const uint count, SHARED real* system)
{
    STEP_BARRIER();
    bool determined = count > 0;
    for (uint i = 0; i < count; ++i)
        determined = determined && IS_BELOW(REAL(0), i == place ? SYSTEM(i, NEWEST) : products[i * MEMORY + i]);
    for (uint i = get_local_id(0); i < count; i += GROUP) {
        const real square = i == place ? SYSTEM(i, NEWEST) : products[i * MEMORY + i];
        SYSTEM(i, SCALE) = IS_BELOW(REAL(0), square) ? ROOT(square) : REAL(1);
        SYSTEM(i, RIGHT) = OVER(SYSTEM(i, RIGHT), SYSTEM(i, SCALE));
    }
    STEP_BARRIER();
    for (uint entry = get_local_id(0); entry < count * SYSTEM_ROW; entry += GROUP) {
        const uint i = entry / SYSTEM_ROW, j = entry % SYSTEM_ROW;
        if (j < count) {
            const real product = i == place ? SYSTEM(j, NEWEST)
                : j == place ? SYSTEM(i, NEWEST) : products[i * MEMORY + j];
            system[entry] = i == j ? ONE_AND(RIDGE_PPT)
                : OVER(product, TIMES(SYSTEM(i, SCALE), SYSTEM(j, SCALE)));
        }
    }
    // The matrix is positive definite, so that elimination needs no exchange of rows.
    for (uint p = 0; p < count; ++p) {
        STEP_BARRIER();
        for (uint entry = get_local_id(0); entry < count * SYSTEM_ROW; entry += GROUP) {
            const uint i = entry / SYSTEM_ROW, j = entry % SYSTEM_ROW;
            if (i != p && ((p < j && j < count) || j == RIGHT))
                system[entry] = MINUS(system[entry], TIMES(OVER(SYSTEM(i, p), SYSTEM(p, p)), SYSTEM(p, j)));
        }
    }
    STEP_BARRIER();
    for (uint i = get_local_id(0); i < count; i += GROUP)
        SYSTEM(i, COEFFICIENT) = OVER(OVER(SYSTEM(i, RIGHT), SYSTEM(i, i)), SYSTEM(i, SCALE));
    STEP_BARRIER();
    return determined;
}

// Store the inner products of a new difference; one work-group does.
INLINE void store_products(
    __global real* products, const real row, const uint j, const uint place)
{
    products[place * MEMORY + j] = products[j * MEMORY + place] = row;
}
