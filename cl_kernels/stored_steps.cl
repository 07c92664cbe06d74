// The arithmetic of an iteration over stored pairs between two softmins, float64, in many
// work-groups: the formulas of half_steps.cl, with the closed forms of masses and duals that hold
// after half-steps, the region where the stored pairs are trusted, and what sum_stored of
// sliced_ellpack.cl takes of a potential.
//
// A half-step is a sequence of stages. Of each, `row_loops` or `column_loops` does the loops over
// vectors and leaves what each work-group has found of a sum; `row_joins` or `column_joins`, a
// single group, joins these and computes the numbers that need them.
//
// Written by tools/make_half_steps.py from the formulas: change them. Each operation has its own
// line; x are numbers, v entries of vectors.
//
// Shapes: n points of the rows and m of the columns, both padded to whole tiles by points without
// mass.
// Launch: work-groups of GROUP; loops in `groups` of them.
//
// -D BALANCED  1: inverse_rho_source is 0; 2: inverse_rho_target; 3: both; 0: none
// -D GIVEN_*, ROW_*, COLUMN_*, NUMBER_*  places of vectors and numbers, see stored_step_slots.py
// -D PARTIALS  largest number of sums of a stage
// -D LARGEST_CHANGE  limit of the changes of potentials, powers of two (log2)

#ifndef BALANCED
#error "BALANCED (which sides are balanced) must be given"
#endif
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

// The softmin of LANES rows from i on, from sums over stored pairs: `base` where the logarithm of
// the sum is 0.
INLINE vdouble stored_softmin(
    const __global float* maxima,   // (n,)
    const __global float* sums,     // (n,)
    const __global double* base,    // (n,)
    const __global double* alone,   // (n,): that of rows without a stored pair
    const double middle, const double k, const uint i)
{
    const vdouble m = TO_VDOUBLE(SLOAD(i, maxima));
    const vdouble logarithm = m + (vdouble)(middle) + log2(TO_VDOUBLE(SLOAD(i, sums)));
    const vdouble softmin = DLOAD(i, base) - logarithm * (vdouble)(1.0 / k);
    return m > (vdouble)(0.4 * (double)SENTINEL) ? softmin : DLOAD(i, alone);
}

// Leave what a group has found of a sum.
INLINE void leave_partial(const double found, const uint place, __global double* partials)
{
    if (get_local_id(0) == 0)
        partials[(size_t)place * get_num_groups(0) + get_group_id(0)] = found;
}

// The sum, or the largest, of what groups have left, of which each item takes every GROUP-th one.
INLINE double joined(
    const __global double* partials, const uint place, const uint groups, const bool largest)
{
    double found = largest ? -INFINITY : 0.0;
    for (uint group = get_local_id(0); group < groups; group += GROUP) {
        const double other = partials[(size_t)place * groups + group];
        found = largest ? fmax(found, other) : found + other;
    }
    return found;
}

// What sum_stored takes of a new g: the host's, which is kept, or one of the
// columns' vectors.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void prepare_changes(
    const uint m, const uint control, const double k,
    const __global double* restrict start,       // (m,): the host's g
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict columns,           // (slots, m)
    __global float* restrict changes,            // (m,)
    __global double* restrict numbers)           // see stored_step_slots.py
{
    const double middle = numbers[NUMBER_COLUMN_NEXT];
    for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
        if (G_AT == COLUMN_START)
            DSTORE(DLOAD(i, start), i, COLUMN(COLUMN_START));
        const vdouble change = (DLOAD(i, COLUMN(G_AT)) - DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN))) * k;
        const vdouble limited = fmin(fmax(change, (vdouble)(-(double)LARGEST_CHANGE)),
                                     (vdouble)((double)LARGEST_CHANGE));
        const vdouble weights = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
        const vdouble counted = weights > (vdouble)(0.0) ? limited : (vdouble)(0.0);
        SSTORE(TO_VSINGLE(counted - middle), i, changes);
    }
    if (get_global_id(0) == 0)
        numbers[NUMBER_COLUMN_MIDDLE] = middle;
}

// After T(g): f, the shift of g, the dual, and the changes of f for the next softmin.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void row_loops(
    const uint n, const uint m, const uint control, const uint stage, const uint groups,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double source_mass, const double target_mass,
    const double radius,
    const __global float* restrict maxima,       // (n,): of this softmin
    const __global float* restrict sums,         // (n,)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    __global float* restrict changes,            // (n,): of the potential of the next softmin
    __global double* restrict partials,          // (PARTIALS, groups)
    __global double* restrict scalars,           // (SCALARS,): numbers of the stages before
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see stored_step_slots.py
{
    __local double shared[GROUP];
    double found[PARTIALS];
    uint n_found = 0;
    ulong largest = 0;
#if BALANCED == 0
    if (stage == 0) {
        const double middle = numbers[NUMBER_COLUMN_MIDDLE];
        const double nothing = 0.0;
        const uint g_at = G_AT;
        const double x13 = epsilon * inverse_rho_source;
        const double x14 = 1.0 + x13;
        const double x15 = 1.0 / x14;
        const double x19 = inverse_rho_source * x15;
        vdouble allx31 = (vdouble)(-INFINITY);
        vdouble allx65 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v10 = stored_softmin(maxima, sums, ROW_GIVEN(GIVEN_BASE), ROW_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v10, i, ROW(ROW_SCRATCH_0));
            const vdouble v2 = DLOAD(i, ROW_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v29 = v10 * (vdouble)(x19);
            const vdouble v30 = v2 - v29;
            const vdouble v64 = v10 * (vdouble)(nothing);
            allx31 = fmax(allx31, v30);
            allx65 += v64;
        }
        found[0] = largest_lane(allx31);
        found[1] = sum_of_lanes(allx65);
        vdouble allx23 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v11 = DLOAD(i, COLUMN(g_at));
            const vdouble v21 = v11 * (vdouble)(inverse_rho_target);
            const vdouble v22 = v4 - v21;
            allx23 = fmax(allx23, v22);
        }
        found[2] = largest_lane(allx23);
        n_found = 3;
        largest = 5ul;
    }
    else if (stage == 1) {
        const uint g_at = G_AT;
        const double x13 = epsilon * inverse_rho_source;
        const double x14 = 1.0 + x13;
        const double x15 = 1.0 / x14;
        const double x19 = inverse_rho_source * x15;
        const double x31 = scalars[1];
        const double x23 = scalars[0];
        vdouble allx34 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v2 = DLOAD(i, ROW_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v10 = DLOAD(i, ROW(ROW_SCRATCH_0));
            const vdouble v29 = v10 * (vdouble)(x19);
            const vdouble v30 = v2 - v29;
            const vdouble v32 = v30 - (vdouble)(x31);
            const vdouble v33 = exp(v32);
            allx34 += v33;
        }
        found[0] = sum_of_lanes(allx34);
        vdouble allx26 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v11 = DLOAD(i, COLUMN(g_at));
            const vdouble v21 = v11 * (vdouble)(inverse_rho_target);
            const vdouble v22 = v4 - v21;
            const vdouble v24 = v22 - (vdouble)(x23);
            const vdouble v25 = exp(v24);
            allx26 += v25;
        }
        found[1] = sum_of_lanes(allx26);
        n_found = 2;
        largest = 0ul;
    }
    else if (stage == 2) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const uint g_at = G_AT;
        const double x38 = scalars[10];
        const double x13 = epsilon * inverse_rho_source;
        const double x14 = 1.0 + x13;
        const double x15 = 1.0 / x14;
        vdouble allx76 = (vdouble)(-INFINITY);
        vdouble allx78 = (vdouble)(-INFINITY);
        vdouble allx83 = (vdouble)(0.0);
        vdouble allx87 = (vdouble)(-INFINITY);
        vdouble allx89 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v10 = DLOAD(i, ROW(ROW_SCRATCH_0));
            const vdouble v39 = v10 - (vdouble)(x38);
            DSTORE(v39, i, ROW(ROW_SOFTMIN));
            const vdouble v42 = (vdouble)(x15) * v39;
            DSTORE(v42, i, ROW(ROW_F));
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v66 = DLOAD(i, ROW_GIVEN(GIVEN_ORIGIN));
            const vdouble v67 = v42 - v66;
            const vdouble v69 = v67 * (vdouble)(k);
            const vdouble v70 = fmax(v69, (vdouble)(-10000.0));
            const vdouble v71 = fmin(v70, (vdouble)(10000.0));
            const vdouble v73 = (v1 > (vdouble)(0.0)) ? v71 : (vdouble)(0.0);
            const vdouble v75 = v73 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v75), i, changes);
            const vdouble v77 = (vdouble)(-1.0) * v73;
            const vdouble v7 = DLOAD(i, ROW_GIVEN(GIVEN_CENTER));
            const vdouble v81 = v42 - v7;
            const vdouble v82 = v1 * v81;
            const vdouble v86 = (v1 > (vdouble)(0.0)) ? v81 : (vdouble)(-INFINITY);
            const vdouble v85 = (vdouble)(-1.0) * v81;
            const vdouble v88 = (v1 > (vdouble)(0.0)) ? v85 : (vdouble)(-INFINITY);
            allx76 = fmax(allx76, v73);
            allx78 = fmax(allx78, v77);
            allx83 += v82;
            allx87 = fmax(allx87, v86);
            allx89 = fmax(allx89, v88);
        }
        found[0] = largest_lane(allx76);
        found[1] = largest_lane(allx78);
        found[2] = sum_of_lanes(allx83);
        found[3] = largest_lane(allx87);
        found[4] = largest_lane(allx89);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v11 = DLOAD(i, COLUMN(g_at));
            const vdouble v43 = v11 + (vdouble)(x38);
            DSTORE(v43, i, COLUMN(COLUMN_SHIFTED));
        }
        n_found = 5;
        largest = 27ul;
    }
#elif BALANCED == 1
    if (stage == 0) {
        const double middle = numbers[NUMBER_COLUMN_MIDDLE];
        const double nothing = 0.0;
        const uint g_at = G_AT;
        vdouble allx23 = (vdouble)(-INFINITY);
        vdouble allx50 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v2 = DLOAD(i, ROW_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v9 = stored_softmin(maxima, sums, ROW_GIVEN(GIVEN_BASE), ROW_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v9, i, ROW(ROW_SCRATCH_0));
            const vdouble v49 = v9 * (vdouble)(nothing);
            allx23 = fmax(allx23, v2);
            allx50 += v49;
        }
        found[0] = largest_lane(allx23);
        found[1] = sum_of_lanes(allx50);
        vdouble allx17 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v10 = DLOAD(i, COLUMN(g_at));
            const vdouble v15 = v10 * (vdouble)(inverse_rho_target);
            const vdouble v16 = v4 - v15;
            allx17 = fmax(allx17, v16);
        }
        found[2] = largest_lane(allx17);
        n_found = 3;
        largest = 5ul;
    }
    else if (stage == 1) {
        const uint g_at = G_AT;
        const double x23 = scalars[1];
        const double x17 = scalars[0];
        vdouble allx26 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v2 = DLOAD(i, ROW_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v24 = v2 - (vdouble)(x23);
            const vdouble v25 = exp(v24);
            allx26 += v25;
        }
        found[0] = sum_of_lanes(allx26);
        vdouble allx20 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v10 = DLOAD(i, COLUMN(g_at));
            const vdouble v15 = v10 * (vdouble)(inverse_rho_target);
            const vdouble v16 = v4 - v15;
            const vdouble v18 = v16 - (vdouble)(x17);
            const vdouble v19 = exp(v18);
            allx20 += v19;
        }
        found[1] = sum_of_lanes(allx20);
        n_found = 2;
        largest = 0ul;
    }
    else if (stage == 2) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const uint g_at = G_AT;
        const double x30 = scalars[10];
        vdouble allx38 = (vdouble)(0.0);
        vdouble allx61 = (vdouble)(-INFINITY);
        vdouble allx63 = (vdouble)(-INFINITY);
        vdouble allx68 = (vdouble)(0.0);
        vdouble allx72 = (vdouble)(-INFINITY);
        vdouble allx74 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v9 = DLOAD(i, ROW(ROW_SCRATCH_0));
            const vdouble v31 = v9 - (vdouble)(x30);
            DSTORE(v31, i, ROW(ROW_F));
            DSTORE(v31, i, ROW(ROW_SOFTMIN));
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v37 = v1 * v31;
            const vdouble v51 = DLOAD(i, ROW_GIVEN(GIVEN_ORIGIN));
            const vdouble v52 = v31 - v51;
            const vdouble v54 = v52 * (vdouble)(k);
            const vdouble v55 = fmax(v54, (vdouble)(-10000.0));
            const vdouble v56 = fmin(v55, (vdouble)(10000.0));
            const vdouble v58 = (v1 > (vdouble)(0.0)) ? v56 : (vdouble)(0.0);
            const vdouble v60 = v58 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v60), i, changes);
            const vdouble v62 = (vdouble)(-1.0) * v58;
            const vdouble v6 = DLOAD(i, ROW_GIVEN(GIVEN_CENTER));
            const vdouble v66 = v31 - v6;
            const vdouble v67 = v1 * v66;
            const vdouble v71 = (v1 > (vdouble)(0.0)) ? v66 : (vdouble)(-INFINITY);
            const vdouble v70 = (vdouble)(-1.0) * v66;
            const vdouble v73 = (v1 > (vdouble)(0.0)) ? v70 : (vdouble)(-INFINITY);
            allx38 += v37;
            allx61 = fmax(allx61, v58);
            allx63 = fmax(allx63, v62);
            allx68 += v67;
            allx72 = fmax(allx72, v71);
            allx74 = fmax(allx74, v73);
        }
        found[0] = sum_of_lanes(allx38);
        found[1] = largest_lane(allx61);
        found[2] = largest_lane(allx63);
        found[3] = sum_of_lanes(allx68);
        found[4] = largest_lane(allx72);
        found[5] = largest_lane(allx74);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v10 = DLOAD(i, COLUMN(g_at));
            const vdouble v32 = v10 + (vdouble)(x30);
            DSTORE(v32, i, COLUMN(COLUMN_SHIFTED));
        }
        n_found = 6;
        largest = 54ul;
    }
#elif BALANCED == 2
    if (stage == 0) {
        const double middle = numbers[NUMBER_COLUMN_MIDDLE];
        const double nothing = 0.0;
        const double x12 = epsilon * inverse_rho_source;
        const double x13 = 1.0 + x12;
        const double x14 = 1.0 / x13;
        const double x15 = inverse_rho_source * x14;
        vdouble allx24 = (vdouble)(-INFINITY);
        vdouble allx54 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v9 = stored_softmin(maxima, sums, ROW_GIVEN(GIVEN_BASE), ROW_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v9, i, ROW(ROW_SCRATCH_0));
            const vdouble v2 = DLOAD(i, ROW_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v22 = v9 * (vdouble)(x15);
            const vdouble v23 = v2 - v22;
            const vdouble v53 = v9 * (vdouble)(nothing);
            allx24 = fmax(allx24, v23);
            allx54 += v53;
        }
        found[0] = largest_lane(allx24);
        found[1] = sum_of_lanes(allx54);
        vdouble allx16 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            allx16 = fmax(allx16, v4);
        }
        found[2] = largest_lane(allx16);
        n_found = 3;
        largest = 5ul;
    }
    else if (stage == 1) {
        const double x12 = epsilon * inverse_rho_source;
        const double x13 = 1.0 + x12;
        const double x14 = 1.0 / x13;
        const double x15 = inverse_rho_source * x14;
        const double x24 = scalars[1];
        const double x16 = scalars[0];
        vdouble allx27 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v2 = DLOAD(i, ROW_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v9 = DLOAD(i, ROW(ROW_SCRATCH_0));
            const vdouble v22 = v9 * (vdouble)(x15);
            const vdouble v23 = v2 - v22;
            const vdouble v25 = v23 - (vdouble)(x24);
            const vdouble v26 = exp(v25);
            allx27 += v26;
        }
        found[0] = sum_of_lanes(allx27);
        vdouble allx19 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v17 = v4 - (vdouble)(x16);
            const vdouble v18 = exp(v17);
            allx19 += v18;
        }
        found[1] = sum_of_lanes(allx19);
        n_found = 2;
        largest = 0ul;
    }
    else if (stage == 2) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const uint g_at = G_AT;
        const double x31 = scalars[10];
        const double x12 = epsilon * inverse_rho_source;
        const double x13 = 1.0 + x12;
        const double x14 = 1.0 / x13;
        vdouble allx65 = (vdouble)(-INFINITY);
        vdouble allx67 = (vdouble)(-INFINITY);
        vdouble allx72 = (vdouble)(0.0);
        vdouble allx76 = (vdouble)(-INFINITY);
        vdouble allx78 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v9 = DLOAD(i, ROW(ROW_SCRATCH_0));
            const vdouble v32 = v9 - (vdouble)(x31);
            DSTORE(v32, i, ROW(ROW_SOFTMIN));
            const vdouble v35 = (vdouble)(x14) * v32;
            DSTORE(v35, i, ROW(ROW_F));
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v55 = DLOAD(i, ROW_GIVEN(GIVEN_ORIGIN));
            const vdouble v56 = v35 - v55;
            const vdouble v58 = v56 * (vdouble)(k);
            const vdouble v59 = fmax(v58, (vdouble)(-10000.0));
            const vdouble v60 = fmin(v59, (vdouble)(10000.0));
            const vdouble v62 = (v1 > (vdouble)(0.0)) ? v60 : (vdouble)(0.0);
            const vdouble v64 = v62 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v64), i, changes);
            const vdouble v66 = (vdouble)(-1.0) * v62;
            const vdouble v6 = DLOAD(i, ROW_GIVEN(GIVEN_CENTER));
            const vdouble v70 = v35 - v6;
            const vdouble v71 = v1 * v70;
            const vdouble v75 = (v1 > (vdouble)(0.0)) ? v70 : (vdouble)(-INFINITY);
            const vdouble v74 = (vdouble)(-1.0) * v70;
            const vdouble v77 = (v1 > (vdouble)(0.0)) ? v74 : (vdouble)(-INFINITY);
            allx65 = fmax(allx65, v62);
            allx67 = fmax(allx67, v66);
            allx72 += v71;
            allx76 = fmax(allx76, v75);
            allx78 = fmax(allx78, v77);
        }
        found[0] = largest_lane(allx65);
        found[1] = largest_lane(allx67);
        found[2] = sum_of_lanes(allx72);
        found[3] = largest_lane(allx76);
        found[4] = largest_lane(allx78);
        vdouble allx50 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v10 = DLOAD(i, COLUMN(g_at));
            const vdouble v36 = v10 + (vdouble)(x31);
            DSTORE(v36, i, COLUMN(COLUMN_SHIFTED));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v49 = v3 * v36;
            allx50 += v49;
        }
        found[5] = sum_of_lanes(allx50);
        n_found = 6;
        largest = 27ul;
    }
#elif BALANCED == 3
    if (stage == 0) {
        const double middle = numbers[NUMBER_COLUMN_MIDDLE];
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const double nothing = 0.0;
        const uint g_at = G_AT;
        vdouble allx17 = (vdouble)(0.0);
        vdouble allx24 = (vdouble)(0.0);
        vdouble allx35 = (vdouble)(-INFINITY);
        vdouble allx37 = (vdouble)(-INFINITY);
        vdouble allx42 = (vdouble)(0.0);
        vdouble allx46 = (vdouble)(-INFINITY);
        vdouble allx48 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v8 = stored_softmin(maxima, sums, ROW_GIVEN(GIVEN_BASE), ROW_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v8, i, ROW(ROW_F));
            DSTORE(v8, i, ROW(ROW_SOFTMIN));
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v16 = v1 * v8;
            const vdouble v23 = v8 * (vdouble)(nothing);
            const vdouble v25 = DLOAD(i, ROW_GIVEN(GIVEN_ORIGIN));
            const vdouble v26 = v8 - v25;
            const vdouble v28 = v26 * (vdouble)(k);
            const vdouble v29 = fmax(v28, (vdouble)(-10000.0));
            const vdouble v30 = fmin(v29, (vdouble)(10000.0));
            const vdouble v32 = (v1 > (vdouble)(0.0)) ? v30 : (vdouble)(0.0);
            const vdouble v34 = v32 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v34), i, changes);
            const vdouble v36 = (vdouble)(-1.0) * v32;
            const vdouble v5 = DLOAD(i, ROW_GIVEN(GIVEN_CENTER));
            const vdouble v40 = v8 - v5;
            const vdouble v41 = v1 * v40;
            const vdouble v45 = (v1 > (vdouble)(0.0)) ? v40 : (vdouble)(-INFINITY);
            const vdouble v44 = (vdouble)(-1.0) * v40;
            const vdouble v47 = (v1 > (vdouble)(0.0)) ? v44 : (vdouble)(-INFINITY);
            allx17 += v16;
            allx24 += v23;
            allx35 = fmax(allx35, v32);
            allx37 = fmax(allx37, v36);
            allx42 += v41;
            allx46 = fmax(allx46, v45);
            allx48 = fmax(allx48, v47);
        }
        found[0] = sum_of_lanes(allx17);
        found[1] = sum_of_lanes(allx24);
        found[2] = largest_lane(allx35);
        found[3] = largest_lane(allx37);
        found[4] = sum_of_lanes(allx42);
        found[5] = largest_lane(allx46);
        found[6] = largest_lane(allx48);
        vdouble allx20 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v9 = DLOAD(i, COLUMN(g_at));
            DSTORE(v9, i, COLUMN(COLUMN_SHIFTED));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v19 = v3 * v9;
            allx20 += v19;
        }
        found[7] = sum_of_lanes(allx20);
        n_found = 8;
        largest = 108ul;
    }
#endif
    for (uint place = 0; place < n_found; ++place)
        leave_partial(group_reduced(found[place], largest >> place & 1ul, shared), place, partials);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void row_joins(
    const uint n, const uint m, const uint control, const uint stage, const uint groups,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double source_mass, const double target_mass,
    const double radius,
    const __global float* restrict maxima,       // (n,): of this softmin
    const __global float* restrict sums,         // (n,)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    __global float* restrict changes,            // (n,): of the potential of the next softmin
    __global double* restrict partials,          // (PARTIALS, groups)
    __global double* restrict scalars,           // (SCALARS,): numbers of the stages before
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see stored_step_slots.py
{
    __local double shared[GROUP];
    double found[PARTIALS];
#if BALANCED == 0
    const uint n_found = stage == 0 ? 3 : stage == 1 ? 2 : stage == 2 ? 5 : 0;
    const ulong largest = stage == 0 ? 5 : stage == 1 ? 0 : stage == 2 ? 27 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    if (stage == 0) {
        const double x31 = found[0];
        const double x65 = found[1];
        const double x23 = found[2];
        if (get_local_id(0) == 0) {
            scalars[0] = x23;
            scalars[1] = x31;
            scalars[2] = x65;
        }
    }
    else if (stage == 1) {
        const double x23 = scalars[0];
        const double x31 = scalars[1];
        const double x13 = epsilon * inverse_rho_source;
        const double x14 = 1.0 + x13;
        const double x15 = 1.0 / x14;
        const double x19 = inverse_rho_source * x15;
        const double x20 = x19 + inverse_rho_target;
        const double x46 = (-1.0) * epsilon;
        const double x34 = found[0];
        const double x26 = found[1];
        const double x27 = log(x26);
        const double x28 = x23 + x27;
        const double x35 = log(x34);
        const double x36 = x31 + x35;
        const double x37 = x28 - x36;
        const double x38 = x37 / x20;
        const double x40 = x38 * x19;
        const double x41 = x36 + x40;
        const double x44 = fmin(x41, 300.0);
        const double x45 = exp(x44);
        const double x47 = x46 * x45;
        const double x53 = source_mass - x45;
        const double x54 = x53 / inverse_rho_source;
        const double x55 = x47 + x54;
        const double x60 = target_mass - x45;
        const double x61 = x60 / inverse_rho_target;
        const double x62 = x55 + x61;
        if (get_local_id(0) == 0) {
            scalars[10] = x38;
            scalars[12] = x41;
            scalars[14] = x45;
            scalars[21] = x62;
        }
    }
    else if (stage == 2) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const double x45 = scalars[14];
        const double x41 = scalars[12];
        const double x62 = scalars[21];
        const double x65 = scalars[2];
        const double x76 = found[0];
        const double x78 = found[1];
        const double x83 = found[2];
        const double x87 = found[3];
        const double x89 = found[4];
        const double x79 = x76 - x78;
        const double x80 = 0.5 * x79;
        const double x84 = x83 / source_mass;
        const double x90 = x87 - x84;
        const double x91 = x89 + x84;
        const double x92 = fmax(x90, x91);
        if (get_local_id(0) == 0) {
            numbers[NUMBER_MASS] = x45;
            numbers[NUMBER_LOG_MASS] = x41;
            numbers[NUMBER_ROW_DUAL] = x62;
            numbers[NUMBER_ROW_FINITE] = x65;
            numbers[NUMBER_MOVED] = x92;
            numbers[NUMBER_ROW_MIDDLE] = next_middle;
            numbers[NUMBER_ROW_NEXT] = x80;
        }
    }
#elif BALANCED == 1
    const uint n_found = stage == 0 ? 3 : stage == 1 ? 2 : stage == 2 ? 6 : 0;
    const ulong largest = stage == 0 ? 5 : stage == 1 ? 0 : stage == 2 ? 54 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    if (stage == 0) {
        const double x23 = found[0];
        const double x50 = found[1];
        const double x17 = found[2];
        if (get_local_id(0) == 0) {
            scalars[0] = x17;
            scalars[1] = x23;
            scalars[2] = x50;
        }
    }
    else if (stage == 1) {
        const double x17 = scalars[0];
        const double x23 = scalars[1];
        const double x35 = (-1.0) * epsilon;
        const double x26 = found[0];
        const double x20 = found[1];
        const double x21 = log(x20);
        const double x22 = x17 + x21;
        const double x27 = log(x26);
        const double x28 = x23 + x27;
        const double x29 = x22 - x28;
        const double x30 = x29 / inverse_rho_target;
        const double x33 = fmin(x28, 300.0);
        const double x34 = exp(x33);
        const double x36 = x35 * x34;
        const double x45 = target_mass - x34;
        const double x46 = x45 / inverse_rho_target;
        if (get_local_id(0) == 0) {
            scalars[8] = x28;
            scalars[10] = x30;
            scalars[12] = x34;
            scalars[13] = x36;
            scalars[15] = x46;
        }
    }
    else if (stage == 2) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const double x36 = scalars[13];
        const double x46 = scalars[15];
        const double x34 = scalars[12];
        const double x28 = scalars[8];
        const double x50 = scalars[2];
        const double x38 = found[0];
        const double x61 = found[1];
        const double x63 = found[2];
        const double x68 = found[3];
        const double x72 = found[4];
        const double x74 = found[5];
        const double x39 = x36 + x38;
        const double x47 = x39 + x46;
        const double x64 = x61 - x63;
        const double x65 = 0.5 * x64;
        const double x69 = x68 / source_mass;
        const double x75 = x72 - x69;
        const double x76 = x74 + x69;
        const double x77 = fmax(x75, x76);
        if (get_local_id(0) == 0) {
            numbers[NUMBER_MASS] = x34;
            numbers[NUMBER_LOG_MASS] = x28;
            numbers[NUMBER_ROW_DUAL] = x47;
            numbers[NUMBER_ROW_FINITE] = x50;
            numbers[NUMBER_MOVED] = x77;
            numbers[NUMBER_ROW_MIDDLE] = next_middle;
            numbers[NUMBER_ROW_NEXT] = x65;
        }
    }
#elif BALANCED == 2
    const uint n_found = stage == 0 ? 3 : stage == 1 ? 2 : stage == 2 ? 6 : 0;
    const ulong largest = stage == 0 ? 5 : stage == 1 ? 0 : stage == 2 ? 27 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    if (stage == 0) {
        const double x24 = found[0];
        const double x54 = found[1];
        const double x16 = found[2];
        if (get_local_id(0) == 0) {
            scalars[0] = x16;
            scalars[1] = x24;
            scalars[2] = x54;
        }
    }
    else if (stage == 1) {
        const double x16 = scalars[0];
        const double x24 = scalars[1];
        const double x12 = epsilon * inverse_rho_source;
        const double x13 = 1.0 + x12;
        const double x14 = 1.0 / x13;
        const double x15 = inverse_rho_source * x14;
        const double x39 = (-1.0) * epsilon;
        const double x27 = found[0];
        const double x19 = found[1];
        const double x20 = log(x19);
        const double x21 = x16 + x20;
        const double x28 = log(x27);
        const double x29 = x24 + x28;
        const double x30 = x21 - x29;
        const double x31 = x30 / x15;
        const double x33 = x31 * x15;
        const double x34 = x29 + x33;
        const double x37 = fmin(x34, 300.0);
        const double x38 = exp(x37);
        const double x40 = x39 * x38;
        const double x46 = source_mass - x38;
        const double x47 = x46 / inverse_rho_source;
        const double x48 = x40 + x47;
        if (get_local_id(0) == 0) {
            scalars[10] = x31;
            scalars[12] = x34;
            scalars[14] = x38;
            scalars[18] = x48;
        }
    }
    else if (stage == 2) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const double x48 = scalars[18];
        const double x38 = scalars[14];
        const double x34 = scalars[12];
        const double x54 = scalars[2];
        const double x65 = found[0];
        const double x67 = found[1];
        const double x72 = found[2];
        const double x76 = found[3];
        const double x78 = found[4];
        const double x50 = found[5];
        const double x51 = x48 + x50;
        const double x68 = x65 - x67;
        const double x69 = 0.5 * x68;
        const double x73 = x72 / source_mass;
        const double x79 = x76 - x73;
        const double x80 = x78 + x73;
        const double x81 = fmax(x79, x80);
        if (get_local_id(0) == 0) {
            numbers[NUMBER_MASS] = x38;
            numbers[NUMBER_LOG_MASS] = x34;
            numbers[NUMBER_ROW_DUAL] = x51;
            numbers[NUMBER_ROW_FINITE] = x54;
            numbers[NUMBER_MOVED] = x81;
            numbers[NUMBER_ROW_MIDDLE] = next_middle;
            numbers[NUMBER_ROW_NEXT] = x69;
        }
    }
#elif BALANCED == 3
    const uint n_found = stage == 0 ? 8 : 0;
    const ulong largest = stage == 0 ? 108 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    if (stage == 0) {
        const double next_middle = numbers[NUMBER_ROW_NEXT];
        const double x14 = (-1.0) * epsilon;
        const double x11 = log(source_mass);
        const double x12 = fmin(x11, 300.0);
        const double x13 = exp(x12);
        const double x15 = x14 * x13;
        const double x17 = found[0];
        const double x24 = found[1];
        const double x35 = found[2];
        const double x37 = found[3];
        const double x42 = found[4];
        const double x46 = found[5];
        const double x48 = found[6];
        const double x20 = found[7];
        const double x18 = x15 + x17;
        const double x21 = x18 + x20;
        const double x38 = x35 - x37;
        const double x39 = 0.5 * x38;
        const double x43 = x42 / source_mass;
        const double x49 = x46 - x43;
        const double x50 = x48 + x43;
        const double x51 = fmax(x49, x50);
        if (get_local_id(0) == 0) {
            numbers[NUMBER_MASS] = x13;
            numbers[NUMBER_LOG_MASS] = x11;
            numbers[NUMBER_ROW_DUAL] = x21;
            numbers[NUMBER_ROW_FINITE] = x24;
            numbers[NUMBER_MOVED] = x51;
            numbers[NUMBER_ROW_MIDDLE] = next_middle;
            numbers[NUMBER_ROW_NEXT] = x39;
        }
    }
#endif
}

// After T(f): the residual, the image of g, the shift of f, the dual, and the next g.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_loops(
    const uint n, const uint m, const uint control, const uint stage, const uint groups,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double source_mass, const double target_mass,
    const double radius,
    const __global float* restrict maxima,       // (m,): of this softmin
    const __global float* restrict sums,         // (m,)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    __global float* restrict changes,            // (m,): of the potential of the next softmin
    __global double* restrict partials,          // (PARTIALS, groups)
    __global double* restrict scalars,           // (SCALARS,): numbers of the stages before
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see stored_step_slots.py
{
    __local double shared[GROUP];
    double found[PARTIALS];
    uint n_found = 0;
    ulong largest = 0;
#if BALANCED == 0
    if (stage == 0) {
        const double middle = numbers[NUMBER_ROW_MIDDLE];
        const double nothing = 0.0;
        const double x16 = epsilon * inverse_rho_source;
        const double x17 = 1.0 + x16;
        const double x18 = 1.0 / x17;
        const double x19 = epsilon * inverse_rho_target;
        const double x20 = 1.0 + x19;
        const double x21 = 1.0 / x20;
        const double x37 = inverse_rho_target * x21;
        vdouble allx27 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v11 = DLOAD(i, ROW(ROW_F));
            const vdouble v13 = DLOAD(i, ROW(ROW_SOFTMIN));
            const vdouble v23 = (vdouble)(x18) * v13;
            const vdouble v24 = v11 - v23;
            const vdouble v25 = fabs(v24);
            const vdouble v26 = (v1 > (vdouble)(0.0)) ? v25 : (vdouble)(0.0);
            allx27 = fmax(allx27, v26);
        }
        found[0] = largest_lane(allx27);
        vdouble allx34 = (vdouble)(-INFINITY);
        vdouble allx41 = (vdouble)(-INFINITY);
        vdouble allx134 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v10 = stored_softmin(maxima, sums, COLUMN_GIVEN(GIVEN_BASE), COLUMN_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v10, i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v12 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
            const vdouble v30 = (vdouble)(x21) * v10;
            const vdouble v31 = v12 - v30;
            const vdouble v32 = fabs(v31);
            const vdouble v33 = (v3 > (vdouble)(0.0)) ? v32 : (vdouble)(0.0);
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v39 = v10 * (vdouble)(x37);
            const vdouble v40 = v4 - v39;
            const vdouble v133 = v10 * (vdouble)(nothing);
            allx34 = fmax(allx34, v33);
            allx41 = fmax(allx41, v40);
            allx134 += v133;
        }
        found[1] = largest_lane(allx34);
        found[2] = largest_lane(allx41);
        found[3] = sum_of_lanes(allx134);
        n_found = 4;
        largest = 7ul;
    }
    else if (stage == 1) {
        const double x19 = epsilon * inverse_rho_target;
        const double x20 = 1.0 + x19;
        const double x21 = 1.0 / x20;
        const double x37 = inverse_rho_target * x21;
        const double x41 = scalars[0];
        vdouble allx44 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v10 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v39 = v10 * (vdouble)(x37);
            const vdouble v40 = v4 - v39;
            const vdouble v42 = v40 - (vdouble)(x41);
            const vdouble v43 = exp(v42);
            allx44 += v43;
        }
        found[0] = sum_of_lanes(allx44);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 2) {
        const bool begun = BEGUN;
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint old_image_at = COLUMN_IMAGE_1 - PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
        const uint new_ahead_at = COLUMN_AHEAD + PLACE;
        const uint new_difference_at = COLUMN_DIFFERENCES + PLACE;
        const uint g_at = G_AT;
        const uint count = COUNT;
        const double x48 = scalars[11];
        const double x19 = epsilon * inverse_rho_target;
        const double x20 = 1.0 + x19;
        const double x21 = 1.0 / x20;
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v11 = DLOAD(i, ROW(ROW_F));
            const vdouble v53 = v11 + (vdouble)(x48);
            DSTORE(v53, i, ROW(ROW_SHIFTED));
        }
        vdouble allx93[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx93[j] = (vdouble)(0.0);
        vdouble allx95[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx95[j] = (vdouble)(0.0);
        vdouble allx103 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v10 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v49 = v10 - (vdouble)(x48);
            DSTORE(v49, i, COLUMN(COLUMN_SOFTMIN));
            const vdouble v52 = (vdouble)(x21) * v49;
            DSTORE(v52, i, COLUMN(image_at));
            const vdouble v79 = DLOAD(i, COLUMN(g_at));
            const vdouble v81 = v52 - v79;
            DSTORE(v81, i, COLUMN(residual_at));
            const vdouble v82 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v54 = v52 - v49;
            const vdouble v55 = v54 / (vdouble)(epsilon);
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v56 = v55 + v4;
            const vdouble v57 = fmin(v56, (vdouble)(300.0));
            const vdouble v58 = exp(v57);
            const vdouble v59 = (v3 > (vdouble)(0.0)) ? v58 : (vdouble)(0.0);
            const vdouble v83 = begun ? v82 : v59;
            DSTORE(v83, i, COLUMN(COLUMN_MASS));
            const vdouble v87 = DLOAD(i, COLUMN(old_residual_at));
            const vdouble v88 = v81 - v87;
            const vdouble v89 = begun ? v88 : (vdouble)(0.0);
            DSTORE(v89, i, COLUMN(new_difference_at));
            const vdouble v84 = DLOAD(i, COLUMN(old_image_at));
            const vdouble v85 = v52 - v84;
            const vdouble v86 = begun ? v85 : (vdouble)(0.0);
            const vdouble v90 = (vdouble)(0.5) * v89;
            const vdouble v91 = v86 + v90;
            DSTORE(v91, i, COLUMN(new_ahead_at));
            const vdouble v92 = v89 * v83;
            const vdouble v94 = v83 * v81;
            const vdouble v101 = v81 * v83;
            const vdouble v102 = v101 * v81;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx93[j] += DLOAD(i, DIFFERENCES(j)) * v92;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx95[j] += DLOAD(i, DIFFERENCES(j)) * v94;
            allx103 += v102;
        }
        for (uint j = 0; j < MEMORY; ++j)
            found[0 + j] = sum_of_lanes(allx93[j]);
        for (uint j = 0; j < MEMORY; ++j)
            found[16 + j] = sum_of_lanes(allx95[j]);
        found[32] = sum_of_lanes(allx103);
        n_found = 33;
        largest = 0ul;
    }
    else if (stage == 3) {
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint count = COUNT;
        const __global double* factorsx96 = scalars + 27;
        vdouble allx108 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            vdouble v97 = (vdouble)(0.0);
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    v97 += factorsx96[j] * DLOAD(i, AHEAD(j));
            DSTORE(v97, i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v81 = DLOAD(i, COLUMN(residual_at));
            const vdouble v99 = (vdouble)(0.5) * v81;
            const vdouble v100 = v99 - v97;
            const vdouble v83 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v106 = v100 * v83;
            const vdouble v107 = v106 * v100;
            allx108 += v107;
        }
        found[0] = sum_of_lanes(allx108);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 4) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint guess_at = COLUMN_GUESS_0 + PARITY;
        const double x112 = scalars[47];
        const bool x96 = scalars[26] != 0.0;
        vdouble allx127 = (vdouble)(-INFINITY);
        vdouble allx129 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v52 = DLOAD(i, COLUMN(image_at));
            const vdouble v81 = DLOAD(i, COLUMN(residual_at));
            const vdouble v99 = (vdouble)(0.5) * v81;
            const vdouble v97 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v100 = v99 - v97;
            const vdouble v114 = (vdouble)(x112) * v100;
            const vdouble v115 = v52 + v114;
            DSTORE(v115, i, COLUMN(guess_at));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v117 = x96 ? v115 : v52;
            const vdouble v118 = DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN));
            const vdouble v119 = v117 - v118;
            const vdouble v121 = v119 * (vdouble)(k);
            const vdouble v122 = fmax(v121, (vdouble)(-10000.0));
            const vdouble v123 = fmin(v122, (vdouble)(10000.0));
            const vdouble v124 = (v3 > (vdouble)(0.0)) ? v123 : (vdouble)(0.0);
            const vdouble v126 = v124 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v126), i, changes);
            const vdouble v128 = (vdouble)(-1.0) * v124;
            allx127 = fmax(allx127, v124);
            allx129 = fmax(allx129, v128);
        }
        found[0] = largest_lane(allx127);
        found[1] = largest_lane(allx129);
        n_found = 2;
        largest = 3ul;
    }
#elif BALANCED == 1
    if (stage == 0) {
        const double middle = numbers[NUMBER_ROW_MIDDLE];
        const double nothing = 0.0;
        const double x15 = epsilon * inverse_rho_target;
        const double x16 = 1.0 + x15;
        const double x17 = 1.0 / x16;
        const double x32 = inverse_rho_target * x17;
        vdouble allx22 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v10 = DLOAD(i, ROW(ROW_F));
            const vdouble v12 = DLOAD(i, ROW(ROW_SOFTMIN));
            const vdouble v19 = v10 - v12;
            const vdouble v20 = fabs(v19);
            const vdouble v21 = (v1 > (vdouble)(0.0)) ? v20 : (vdouble)(0.0);
            allx22 = fmax(allx22, v21);
        }
        found[0] = largest_lane(allx22);
        vdouble allx29 = (vdouble)(-INFINITY);
        vdouble allx35 = (vdouble)(-INFINITY);
        vdouble allx124 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v9 = stored_softmin(maxima, sums, COLUMN_GIVEN(GIVEN_BASE), COLUMN_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v9, i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v11 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
            const vdouble v25 = (vdouble)(x17) * v9;
            const vdouble v26 = v11 - v25;
            const vdouble v27 = fabs(v26);
            const vdouble v28 = (v3 > (vdouble)(0.0)) ? v27 : (vdouble)(0.0);
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v33 = v9 * (vdouble)(x32);
            const vdouble v34 = v4 - v33;
            const vdouble v123 = v9 * (vdouble)(nothing);
            allx29 = fmax(allx29, v28);
            allx35 = fmax(allx35, v34);
            allx124 += v123;
        }
        found[1] = largest_lane(allx29);
        found[2] = largest_lane(allx35);
        found[3] = sum_of_lanes(allx124);
        n_found = 4;
        largest = 7ul;
    }
    else if (stage == 1) {
        const double x15 = epsilon * inverse_rho_target;
        const double x16 = 1.0 + x15;
        const double x17 = 1.0 / x16;
        const double x32 = inverse_rho_target * x17;
        const double x35 = scalars[0];
        vdouble allx38 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v9 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v33 = v9 * (vdouble)(x32);
            const vdouble v34 = v4 - v33;
            const vdouble v36 = v34 - (vdouble)(x35);
            const vdouble v37 = exp(v36);
            allx38 += v37;
        }
        found[0] = sum_of_lanes(allx38);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 2) {
        const bool begun = BEGUN;
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint old_image_at = COLUMN_IMAGE_1 - PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
        const uint new_ahead_at = COLUMN_AHEAD + PLACE;
        const uint new_difference_at = COLUMN_DIFFERENCES + PLACE;
        const uint g_at = G_AT;
        const uint count = COUNT;
        const double x42 = scalars[11];
        const double x15 = epsilon * inverse_rho_target;
        const double x16 = 1.0 + x15;
        const double x17 = 1.0 / x16;
        vdouble allx59 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v10 = DLOAD(i, ROW(ROW_F));
            const vdouble v47 = v10 + (vdouble)(x42);
            DSTORE(v47, i, ROW(ROW_SHIFTED));
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v58 = v1 * v47;
            allx59 += v58;
        }
        found[0] = sum_of_lanes(allx59);
        vdouble allx83[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx83[j] = (vdouble)(0.0);
        vdouble allx85[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx85[j] = (vdouble)(0.0);
        vdouble allx93 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v9 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v43 = v9 - (vdouble)(x42);
            DSTORE(v43, i, COLUMN(COLUMN_SOFTMIN));
            const vdouble v46 = (vdouble)(x17) * v43;
            DSTORE(v46, i, COLUMN(image_at));
            const vdouble v69 = DLOAD(i, COLUMN(g_at));
            const vdouble v71 = v46 - v69;
            DSTORE(v71, i, COLUMN(residual_at));
            const vdouble v72 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v48 = v46 - v43;
            const vdouble v49 = v48 / (vdouble)(epsilon);
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v50 = v49 + v4;
            const vdouble v51 = fmin(v50, (vdouble)(300.0));
            const vdouble v52 = exp(v51);
            const vdouble v53 = (v3 > (vdouble)(0.0)) ? v52 : (vdouble)(0.0);
            const vdouble v73 = begun ? v72 : v53;
            DSTORE(v73, i, COLUMN(COLUMN_MASS));
            const vdouble v77 = DLOAD(i, COLUMN(old_residual_at));
            const vdouble v78 = v71 - v77;
            const vdouble v79 = begun ? v78 : (vdouble)(0.0);
            DSTORE(v79, i, COLUMN(new_difference_at));
            const vdouble v74 = DLOAD(i, COLUMN(old_image_at));
            const vdouble v75 = v46 - v74;
            const vdouble v76 = begun ? v75 : (vdouble)(0.0);
            const vdouble v80 = (vdouble)(0.5) * v79;
            const vdouble v81 = v76 + v80;
            DSTORE(v81, i, COLUMN(new_ahead_at));
            const vdouble v82 = v79 * v73;
            const vdouble v84 = v73 * v71;
            const vdouble v91 = v71 * v73;
            const vdouble v92 = v91 * v71;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx83[j] += DLOAD(i, DIFFERENCES(j)) * v82;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx85[j] += DLOAD(i, DIFFERENCES(j)) * v84;
            allx93 += v92;
        }
        for (uint j = 0; j < MEMORY; ++j)
            found[1 + j] = sum_of_lanes(allx83[j]);
        for (uint j = 0; j < MEMORY; ++j)
            found[17 + j] = sum_of_lanes(allx85[j]);
        found[33] = sum_of_lanes(allx93);
        n_found = 34;
        largest = 0ul;
    }
    else if (stage == 3) {
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint count = COUNT;
        const __global double* factorsx86 = scalars + 23;
        vdouble allx98 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            vdouble v87 = (vdouble)(0.0);
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    v87 += factorsx86[j] * DLOAD(i, AHEAD(j));
            DSTORE(v87, i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v71 = DLOAD(i, COLUMN(residual_at));
            const vdouble v89 = (vdouble)(0.5) * v71;
            const vdouble v90 = v89 - v87;
            const vdouble v73 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v96 = v90 * v73;
            const vdouble v97 = v96 * v90;
            allx98 += v97;
        }
        found[0] = sum_of_lanes(allx98);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 4) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint guess_at = COLUMN_GUESS_0 + PARITY;
        const double x102 = scalars[46];
        const bool x86 = scalars[22] != 0.0;
        vdouble allx117 = (vdouble)(-INFINITY);
        vdouble allx119 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v46 = DLOAD(i, COLUMN(image_at));
            const vdouble v71 = DLOAD(i, COLUMN(residual_at));
            const vdouble v89 = (vdouble)(0.5) * v71;
            const vdouble v87 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v90 = v89 - v87;
            const vdouble v104 = (vdouble)(x102) * v90;
            const vdouble v105 = v46 + v104;
            DSTORE(v105, i, COLUMN(guess_at));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v107 = x86 ? v105 : v46;
            const vdouble v108 = DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN));
            const vdouble v109 = v107 - v108;
            const vdouble v111 = v109 * (vdouble)(k);
            const vdouble v112 = fmax(v111, (vdouble)(-10000.0));
            const vdouble v113 = fmin(v112, (vdouble)(10000.0));
            const vdouble v114 = (v3 > (vdouble)(0.0)) ? v113 : (vdouble)(0.0);
            const vdouble v116 = v114 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v116), i, changes);
            const vdouble v118 = (vdouble)(-1.0) * v114;
            allx117 = fmax(allx117, v114);
            allx119 = fmax(allx119, v118);
        }
        found[0] = largest_lane(allx117);
        found[1] = largest_lane(allx119);
        n_found = 2;
        largest = 3ul;
    }
#elif BALANCED == 2
    if (stage == 0) {
        const double middle = numbers[NUMBER_ROW_MIDDLE];
        const double nothing = 0.0;
        const double x15 = epsilon * inverse_rho_source;
        const double x16 = 1.0 + x15;
        const double x17 = 1.0 / x16;
        vdouble allx23 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v10 = DLOAD(i, ROW(ROW_F));
            const vdouble v12 = DLOAD(i, ROW(ROW_SOFTMIN));
            const vdouble v19 = (vdouble)(x17) * v12;
            const vdouble v20 = v10 - v19;
            const vdouble v21 = fabs(v20);
            const vdouble v22 = (v1 > (vdouble)(0.0)) ? v21 : (vdouble)(0.0);
            allx23 = fmax(allx23, v22);
        }
        found[0] = largest_lane(allx23);
        vdouble allx29 = (vdouble)(-INFINITY);
        vdouble allx32 = (vdouble)(-INFINITY);
        vdouble allx118 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v9 = stored_softmin(maxima, sums, COLUMN_GIVEN(GIVEN_BASE), COLUMN_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v9, i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v11 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
            const vdouble v26 = v11 - v9;
            const vdouble v27 = fabs(v26);
            const vdouble v28 = (v3 > (vdouble)(0.0)) ? v27 : (vdouble)(0.0);
            const vdouble v117 = v9 * (vdouble)(nothing);
            allx29 = fmax(allx29, v28);
            allx32 = fmax(allx32, v4);
            allx118 += v117;
        }
        found[1] = largest_lane(allx29);
        found[2] = largest_lane(allx32);
        found[3] = sum_of_lanes(allx118);
        n_found = 4;
        largest = 7ul;
    }
    else if (stage == 1) {
        const double x32 = scalars[0];
        vdouble allx35 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v33 = v4 - (vdouble)(x32);
            const vdouble v34 = exp(v33);
            allx35 += v34;
        }
        found[0] = sum_of_lanes(allx35);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 2) {
        const bool begun = BEGUN;
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint old_image_at = COLUMN_IMAGE_1 - PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
        const uint new_ahead_at = COLUMN_AHEAD + PLACE;
        const uint new_difference_at = COLUMN_DIFFERENCES + PLACE;
        const uint g_at = G_AT;
        const uint count = COUNT;
        const double x39 = scalars[11];
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v10 = DLOAD(i, ROW(ROW_F));
            const vdouble v41 = v10 + (vdouble)(x39);
            DSTORE(v41, i, ROW(ROW_SHIFTED));
        }
        vdouble allx61 = (vdouble)(0.0);
        vdouble allx77[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx77[j] = (vdouble)(0.0);
        vdouble allx79[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx79[j] = (vdouble)(0.0);
        vdouble allx87 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v9 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v40 = v9 - (vdouble)(x39);
            DSTORE(v40, i, COLUMN(image_at));
            DSTORE(v40, i, COLUMN(COLUMN_SOFTMIN));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v60 = v3 * v40;
            const vdouble v63 = DLOAD(i, COLUMN(g_at));
            const vdouble v65 = v40 - v63;
            DSTORE(v65, i, COLUMN(residual_at));
            const vdouble v66 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v42 = v40 - v40;
            const vdouble v43 = v42 / (vdouble)(epsilon);
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v44 = v43 + v4;
            const vdouble v45 = fmin(v44, (vdouble)(300.0));
            const vdouble v46 = exp(v45);
            const vdouble v47 = (v3 > (vdouble)(0.0)) ? v46 : (vdouble)(0.0);
            const vdouble v67 = begun ? v66 : v47;
            DSTORE(v67, i, COLUMN(COLUMN_MASS));
            const vdouble v71 = DLOAD(i, COLUMN(old_residual_at));
            const vdouble v72 = v65 - v71;
            const vdouble v73 = begun ? v72 : (vdouble)(0.0);
            DSTORE(v73, i, COLUMN(new_difference_at));
            const vdouble v68 = DLOAD(i, COLUMN(old_image_at));
            const vdouble v69 = v40 - v68;
            const vdouble v70 = begun ? v69 : (vdouble)(0.0);
            const vdouble v74 = (vdouble)(0.5) * v73;
            const vdouble v75 = v70 + v74;
            DSTORE(v75, i, COLUMN(new_ahead_at));
            const vdouble v76 = v73 * v67;
            const vdouble v78 = v67 * v65;
            const vdouble v85 = v65 * v67;
            const vdouble v86 = v85 * v65;
            allx61 += v60;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx77[j] += DLOAD(i, DIFFERENCES(j)) * v76;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx79[j] += DLOAD(i, DIFFERENCES(j)) * v78;
            allx87 += v86;
        }
        found[0] = sum_of_lanes(allx61);
        for (uint j = 0; j < MEMORY; ++j)
            found[1 + j] = sum_of_lanes(allx77[j]);
        for (uint j = 0; j < MEMORY; ++j)
            found[17 + j] = sum_of_lanes(allx79[j]);
        found[33] = sum_of_lanes(allx87);
        n_found = 34;
        largest = 0ul;
    }
    else if (stage == 3) {
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint count = COUNT;
        const __global double* factorsx80 = scalars + 22;
        vdouble allx92 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            vdouble v81 = (vdouble)(0.0);
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    v81 += factorsx80[j] * DLOAD(i, AHEAD(j));
            DSTORE(v81, i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v65 = DLOAD(i, COLUMN(residual_at));
            const vdouble v83 = (vdouble)(0.5) * v65;
            const vdouble v84 = v83 - v81;
            const vdouble v67 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v90 = v84 * v67;
            const vdouble v91 = v90 * v84;
            allx92 += v91;
        }
        found[0] = sum_of_lanes(allx92);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 4) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint guess_at = COLUMN_GUESS_0 + PARITY;
        const double x96 = scalars[44];
        const bool x80 = scalars[21] != 0.0;
        vdouble allx111 = (vdouble)(-INFINITY);
        vdouble allx113 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v40 = DLOAD(i, COLUMN(image_at));
            const vdouble v65 = DLOAD(i, COLUMN(residual_at));
            const vdouble v83 = (vdouble)(0.5) * v65;
            const vdouble v81 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v84 = v83 - v81;
            const vdouble v98 = (vdouble)(x96) * v84;
            const vdouble v99 = v40 + v98;
            DSTORE(v99, i, COLUMN(guess_at));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v101 = x80 ? v99 : v40;
            const vdouble v102 = DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN));
            const vdouble v103 = v101 - v102;
            const vdouble v105 = v103 * (vdouble)(k);
            const vdouble v106 = fmax(v105, (vdouble)(-10000.0));
            const vdouble v107 = fmin(v106, (vdouble)(10000.0));
            const vdouble v108 = (v3 > (vdouble)(0.0)) ? v107 : (vdouble)(0.0);
            const vdouble v110 = v108 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v110), i, changes);
            const vdouble v112 = (vdouble)(-1.0) * v108;
            allx111 = fmax(allx111, v108);
            allx113 = fmax(allx113, v112);
        }
        found[0] = largest_lane(allx111);
        found[1] = largest_lane(allx113);
        n_found = 2;
        largest = 3ul;
    }
#elif BALANCED == 3
    if (stage == 0) {
        const double middle = numbers[NUMBER_ROW_MIDDLE];
        const double nothing = 0.0;
        const bool begun = BEGUN;
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint old_image_at = COLUMN_IMAGE_1 - PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
        const uint new_ahead_at = COLUMN_AHEAD + PLACE;
        const uint new_difference_at = COLUMN_DIFFERENCES + PLACE;
        const uint g_at = G_AT;
        const uint count = COUNT;
        vdouble allx18 = (vdouble)(-INFINITY);
        vdouble allx39 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(n); i < OWN_END(n); i += STEP) {
            const vdouble v9 = DLOAD(i, ROW(ROW_F));
            DSTORE(v9, i, ROW(ROW_SHIFTED));
            const vdouble v1 = DLOAD(i, ROW_GIVEN(GIVEN_WEIGHTS));
            const vdouble v11 = DLOAD(i, ROW(ROW_SOFTMIN));
            const vdouble v15 = v9 - v11;
            const vdouble v16 = fabs(v15);
            const vdouble v17 = (v1 > (vdouble)(0.0)) ? v16 : (vdouble)(0.0);
            const vdouble v38 = v1 * v9;
            allx18 = fmax(allx18, v17);
            allx39 += v38;
        }
        found[0] = largest_lane(allx18);
        found[1] = sum_of_lanes(allx39);
        vdouble allx24 = (vdouble)(-INFINITY);
        vdouble allx42 = (vdouble)(0.0);
        vdouble allx58[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx58[j] = (vdouble)(0.0);
        vdouble allx60[MEMORY];
        for (uint j = 0; j < MEMORY; ++j)
            allx60[j] = (vdouble)(0.0);
        vdouble allx68 = (vdouble)(0.0);
        vdouble allx84 = (vdouble)(0.0);
        vdouble allx105 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v8 = stored_softmin(maxima, sums, COLUMN_GIVEN(GIVEN_BASE), COLUMN_GIVEN(GIVEN_ALONE), middle, k, i);
            DSTORE(v8, i, COLUMN(image_at));
            DSTORE(v8, i, COLUMN(COLUMN_SOFTMIN));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v10 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
            const vdouble v21 = v10 - v8;
            const vdouble v22 = fabs(v21);
            const vdouble v23 = (v3 > (vdouble)(0.0)) ? v22 : (vdouble)(0.0);
            const vdouble v28 = v8 - v8;
            const vdouble v29 = v28 / (vdouble)(epsilon);
            const vdouble v4 = DLOAD(i, COLUMN_GIVEN(GIVEN_LOG_WEIGHTS));
            const vdouble v30 = v29 + v4;
            const vdouble v31 = fmin(v30, (vdouble)(300.0));
            const vdouble v32 = exp(v31);
            DSTORE(v32, i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v33 = (v3 > (vdouble)(0.0)) ? v32 : (vdouble)(0.0);
            const vdouble v41 = v3 * v8;
            const vdouble v44 = DLOAD(i, COLUMN(g_at));
            const vdouble v46 = v8 - v44;
            DSTORE(v46, i, COLUMN(residual_at));
            const vdouble v47 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v48 = begun ? v47 : v33;
            DSTORE(v48, i, COLUMN(COLUMN_MASS));
            const vdouble v52 = DLOAD(i, COLUMN(old_residual_at));
            const vdouble v53 = v46 - v52;
            const vdouble v54 = begun ? v53 : (vdouble)(0.0);
            DSTORE(v54, i, COLUMN(new_difference_at));
            const vdouble v49 = DLOAD(i, COLUMN(old_image_at));
            const vdouble v50 = v8 - v49;
            const vdouble v51 = begun ? v50 : (vdouble)(0.0);
            const vdouble v55 = (vdouble)(0.5) * v54;
            const vdouble v56 = v51 + v55;
            DSTORE(v56, i, COLUMN(new_ahead_at));
            const vdouble v57 = v54 * v48;
            const vdouble v59 = v48 * v46;
            const vdouble v66 = v46 * v48;
            const vdouble v67 = v66 * v46;
            const vdouble v104 = v8 * (vdouble)(nothing);
            allx24 = fmax(allx24, v23);
            allx42 += v41;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx58[j] += DLOAD(i, DIFFERENCES(j)) * v57;
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    allx60[j] += DLOAD(i, DIFFERENCES(j)) * v59;
            allx68 += v67;
            allx84 += v33;
            allx105 += v104;
        }
        found[2] = largest_lane(allx24);
        found[3] = sum_of_lanes(allx42);
        for (uint j = 0; j < MEMORY; ++j)
            found[4 + j] = sum_of_lanes(allx58[j]);
        for (uint j = 0; j < MEMORY; ++j)
            found[20 + j] = sum_of_lanes(allx60[j]);
        found[36] = sum_of_lanes(allx68);
        found[37] = sum_of_lanes(allx84);
        found[38] = sum_of_lanes(allx105);
        n_found = 39;
        largest = 5ul;
    }
    else if (stage == 1) {
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint count = COUNT;
        const __global double* factorsx61 = scalars + 4;
        vdouble allx73 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            vdouble v62 = (vdouble)(0.0);
#pragma unroll
            for (uint j = 0; j < MEMORY; ++j)
                if (j < count)
                    v62 += factorsx61[j] * DLOAD(i, AHEAD(j));
            DSTORE(v62, i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v46 = DLOAD(i, COLUMN(residual_at));
            const vdouble v64 = (vdouble)(0.5) * v46;
            const vdouble v65 = v64 - v62;
            const vdouble v48 = DLOAD(i, COLUMN(COLUMN_MASS));
            const vdouble v71 = v65 * v48;
            const vdouble v72 = v71 * v65;
            allx73 += v72;
        }
        found[0] = sum_of_lanes(allx73);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 2) {
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const double x77 = scalars[35];
        vdouble allx83 = (vdouble)(0.0);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v32 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
            const vdouble v33 = (v3 > (vdouble)(0.0)) ? v32 : (vdouble)(0.0);
            const vdouble v8 = DLOAD(i, COLUMN(image_at));
            const vdouble v46 = DLOAD(i, COLUMN(residual_at));
            const vdouble v64 = (vdouble)(0.5) * v46;
            const vdouble v62 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v65 = v64 - v62;
            const vdouble v79 = (vdouble)(x77) * v65;
            const vdouble v80 = v8 + v79;
            const vdouble v81 = v80 - v8;
            const vdouble v82 = v33 * v81;
            allx83 += v82;
        }
        found[0] = sum_of_lanes(allx83);
        n_found = 1;
        largest = 0ul;
    }
    else if (stage == 3) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const uint image_at = COLUMN_IMAGE_0 + PARITY;
        const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
        const uint guess_at = COLUMN_GUESS_0 + PARITY;
        const double x77 = scalars[35];
        const double x85 = scalars[39];
        const bool x61 = scalars[3] != 0.0;
        vdouble allx98 = (vdouble)(-INFINITY);
        vdouble allx100 = (vdouble)(-INFINITY);
        for (uint i = OWN_FIRST(m); i < OWN_END(m); i += STEP) {
            const vdouble v8 = DLOAD(i, COLUMN(image_at));
            const vdouble v46 = DLOAD(i, COLUMN(residual_at));
            const vdouble v64 = (vdouble)(0.5) * v46;
            const vdouble v62 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
            const vdouble v65 = v64 - v62;
            const vdouble v79 = (vdouble)(x77) * v65;
            const vdouble v80 = v8 + v79;
            const vdouble v86 = v80 - (vdouble)(x85);
            DSTORE(v86, i, COLUMN(guess_at));
            const vdouble v3 = DLOAD(i, COLUMN_GIVEN(GIVEN_WEIGHTS));
            const vdouble v88 = x61 ? v86 : v8;
            const vdouble v89 = DLOAD(i, COLUMN_GIVEN(GIVEN_ORIGIN));
            const vdouble v90 = v88 - v89;
            const vdouble v92 = v90 * (vdouble)(k);
            const vdouble v93 = fmax(v92, (vdouble)(-10000.0));
            const vdouble v94 = fmin(v93, (vdouble)(10000.0));
            const vdouble v95 = (v3 > (vdouble)(0.0)) ? v94 : (vdouble)(0.0);
            const vdouble v97 = v95 - (vdouble)(next_middle);
            SSTORE(TO_VSINGLE(v97), i, changes);
            const vdouble v99 = (vdouble)(-1.0) * v95;
            allx98 = fmax(allx98, v95);
            allx100 = fmax(allx100, v99);
        }
        found[0] = largest_lane(allx98);
        found[1] = largest_lane(allx100);
        n_found = 2;
        largest = 3ul;
    }
#endif
    for (uint place = 0; place < n_found; ++place)
        leave_partial(group_reduced(found[place], largest >> place & 1ul, shared), place, partials);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_joins(
    const uint n, const uint m, const uint control, const uint stage, const uint groups,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double source_mass, const double target_mass,
    const double radius,
    const __global float* restrict maxima,       // (m,): of this softmin
    const __global float* restrict sums,         // (m,)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    __global float* restrict changes,            // (m,): of the potential of the next softmin
    __global double* restrict partials,          // (PARTIALS, groups)
    __global double* restrict scalars,           // (SCALARS,): numbers of the stages before
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see stored_step_slots.py
{
    __local double shared[GROUP];
    double found[PARTIALS];
    __local double system[MEMORY * SYSTEM_ROW];
#if BALANCED == 0
    const uint n_found = stage == 0 ? 4 : stage == 1 ? 1 : stage == 2 ? 33 : stage == 3 ? 1 : stage == 4 ? 2 : 0;
    const ulong largest = stage == 0 ? 7 : stage == 1 ? 0 : stage == 2 ? 0 : stage == 3 ? 0 : stage == 4 ? 3 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    double factors[MEMORY];
    const bool determined = solve_normal(products, found + 0, found + 16, PLACE,
                                         stage == 2 ? COUNT : 0, system, factors);
    if (stage == 0) {
        const double x27 = found[0];
        const double x34 = found[1];
        const double x41 = found[2];
        const double x134 = found[3];
        const double x28 = x27 / epsilon;
        const double x35 = x34 / epsilon;
        const double x36 = fmax(x28, x35);
        if (get_local_id(0) == 0) {
            scalars[0] = x41;
            scalars[5] = x36;
            scalars[6] = x134;
        }
    }
    else if (stage == 1) {
        const double log_mass = numbers[NUMBER_LOG_MASS];
        const double x41 = scalars[0];
        const double x19 = epsilon * inverse_rho_target;
        const double x20 = 1.0 + x19;
        const double x21 = 1.0 / x20;
        const double x37 = inverse_rho_target * x21;
        const double x38 = x37 + inverse_rho_source;
        const double x62 = (-1.0) * epsilon;
        const double x44 = found[0];
        const double x45 = log(x44);
        const double x46 = x41 + x45;
        const double x47 = log_mass - x46;
        const double x48 = x47 / x38;
        const double x50 = x48 * x37;
        const double x51 = x46 + x50;
        const double x60 = fmin(x51, 300.0);
        const double x61 = exp(x60);
        const double x63 = x62 * x61;
        const double x69 = source_mass - x61;
        const double x70 = x69 / inverse_rho_source;
        const double x71 = x63 + x70;
        const double x76 = target_mass - x61;
        const double x77 = x76 / inverse_rho_target;
        const double x78 = x71 + x77;
        if (get_local_id(0) == 0) {
            scalars[11] = x48;
            scalars[22] = x78;
        }
    }
    else if (stage == 2) {
        const double x103 = found[32];
        const bool x96 = determined;
        const double x104 = sqrt(x103);
        const double x105 = radius * x104;
        if (get_local_id(0) == 0) {
            scalars[25] = x105;
            scalars[26] = x96;
            for (uint j = 0; j < MEMORY; ++j)
                scalars[27 + j] = factors[j];
        }
    }
    else if (stage == 3) {
        const double x105 = scalars[25];
        const bool x96 = scalars[26] != 0.0;
        const double x108 = found[0];
        const double x109 = sqrt(x108);
        const double x110 = fmax(x109, 2.2250738585072014e-308);
        const double x111 = x105 / x110;
        const double x112 = fmin(1.0, x111);
        const bool x113 = x109 > x105;
        const bool x116 = x96 && x113;
        if (get_local_id(0) == 0) {
            scalars[47] = x112;
            scalars[49] = x116;
        }
    }
    else if (stage == 4) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const double x36 = scalars[5];
        const double x78 = scalars[22];
        const bool x96 = scalars[26] != 0.0;
        const bool x116 = scalars[49] != 0.0;
        const double x134 = scalars[6];
        const double x127 = found[0];
        const double x129 = found[1];
        const double x130 = x127 - x129;
        const double x131 = 0.5 * x130;
        if (get_local_id(0) == 0) {
            numbers[NUMBER_RESIDUAL_SIZE] = x36;
            numbers[NUMBER_COLUMN_DUAL] = x78;
            numbers[NUMBER_FOUND] = x96;
            numbers[NUMBER_CUT] = x116;
            numbers[NUMBER_COLUMN_FINITE] = x134;
            numbers[NUMBER_COLUMN_MIDDLE] = next_middle;
            numbers[NUMBER_COLUMN_NEXT] = x131;
        }
    }
#elif BALANCED == 1
    const uint n_found = stage == 0 ? 4 : stage == 1 ? 1 : stage == 2 ? 34 : stage == 3 ? 1 : stage == 4 ? 2 : 0;
    const ulong largest = stage == 0 ? 7 : stage == 1 ? 0 : stage == 2 ? 0 : stage == 3 ? 0 : stage == 4 ? 3 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    double factors[MEMORY];
    const bool determined = solve_normal(products, found + 1, found + 17, PLACE,
                                         stage == 2 ? COUNT : 0, system, factors);
    if (stage == 0) {
        const double x22 = found[0];
        const double x29 = found[1];
        const double x35 = found[2];
        const double x124 = found[3];
        const double x23 = x22 / epsilon;
        const double x30 = x29 / epsilon;
        const double x31 = fmax(x23, x30);
        if (get_local_id(0) == 0) {
            scalars[0] = x35;
            scalars[5] = x31;
            scalars[6] = x124;
        }
    }
    else if (stage == 1) {
        const double log_mass = numbers[NUMBER_LOG_MASS];
        const double x35 = scalars[0];
        const double x15 = epsilon * inverse_rho_target;
        const double x16 = 1.0 + x15;
        const double x17 = 1.0 / x16;
        const double x32 = inverse_rho_target * x17;
        const double x56 = (-1.0) * epsilon;
        const double x38 = found[0];
        const double x39 = log(x38);
        const double x40 = x35 + x39;
        const double x41 = log_mass - x40;
        const double x42 = x41 / x32;
        const double x44 = x42 * x32;
        const double x45 = x40 + x44;
        const double x54 = fmin(x45, 300.0);
        const double x55 = exp(x54);
        const double x57 = x56 * x55;
        const double x66 = target_mass - x55;
        const double x67 = x66 / inverse_rho_target;
        if (get_local_id(0) == 0) {
            scalars[11] = x42;
            scalars[16] = x57;
            scalars[18] = x67;
        }
    }
    else if (stage == 2) {
        const double x57 = scalars[16];
        const double x67 = scalars[18];
        const double x59 = found[0];
        const double x93 = found[33];
        const double x60 = x57 + x59;
        const double x68 = x60 + x67;
        const bool x86 = determined;
        const double x94 = sqrt(x93);
        const double x95 = radius * x94;
        if (get_local_id(0) == 0) {
            scalars[21] = x95;
            scalars[22] = x86;
            for (uint j = 0; j < MEMORY; ++j)
                scalars[23 + j] = factors[j];
            scalars[41] = x68;
        }
    }
    else if (stage == 3) {
        const double x95 = scalars[21];
        const bool x86 = scalars[22] != 0.0;
        const double x98 = found[0];
        const double x99 = sqrt(x98);
        const double x100 = fmax(x99, 2.2250738585072014e-308);
        const double x101 = x95 / x100;
        const double x102 = fmin(1.0, x101);
        const bool x103 = x99 > x95;
        const bool x106 = x86 && x103;
        if (get_local_id(0) == 0) {
            scalars[46] = x102;
            scalars[48] = x106;
        }
    }
    else if (stage == 4) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const double x31 = scalars[5];
        const double x68 = scalars[41];
        const bool x86 = scalars[22] != 0.0;
        const bool x106 = scalars[48] != 0.0;
        const double x124 = scalars[6];
        const double x117 = found[0];
        const double x119 = found[1];
        const double x120 = x117 - x119;
        const double x121 = 0.5 * x120;
        if (get_local_id(0) == 0) {
            numbers[NUMBER_RESIDUAL_SIZE] = x31;
            numbers[NUMBER_COLUMN_DUAL] = x68;
            numbers[NUMBER_FOUND] = x86;
            numbers[NUMBER_CUT] = x106;
            numbers[NUMBER_COLUMN_FINITE] = x124;
            numbers[NUMBER_COLUMN_MIDDLE] = next_middle;
            numbers[NUMBER_COLUMN_NEXT] = x121;
        }
    }
#elif BALANCED == 2
    const uint n_found = stage == 0 ? 4 : stage == 1 ? 1 : stage == 2 ? 34 : stage == 3 ? 1 : stage == 4 ? 2 : 0;
    const ulong largest = stage == 0 ? 7 : stage == 1 ? 0 : stage == 2 ? 0 : stage == 3 ? 0 : stage == 4 ? 3 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    double factors[MEMORY];
    const bool determined = solve_normal(products, found + 1, found + 17, PLACE,
                                         stage == 2 ? COUNT : 0, system, factors);
    if (stage == 0) {
        const double x23 = found[0];
        const double x29 = found[1];
        const double x32 = found[2];
        const double x118 = found[3];
        const double x24 = x23 / epsilon;
        const double x30 = x29 / epsilon;
        const double x31 = fmax(x24, x30);
        if (get_local_id(0) == 0) {
            scalars[0] = x32;
            scalars[5] = x31;
            scalars[6] = x118;
        }
    }
    else if (stage == 1) {
        const double log_mass = numbers[NUMBER_LOG_MASS];
        const double x32 = scalars[0];
        const double x50 = (-1.0) * epsilon;
        const double x35 = found[0];
        const double x36 = log(x35);
        const double x37 = x32 + x36;
        const double x38 = log_mass - x37;
        const double x39 = x38 / inverse_rho_source;
        const double x48 = fmin(x37, 300.0);
        const double x49 = exp(x48);
        const double x51 = x50 * x49;
        const double x57 = source_mass - x49;
        const double x58 = x57 / inverse_rho_source;
        const double x59 = x51 + x58;
        if (get_local_id(0) == 0) {
            scalars[11] = x39;
            scalars[17] = x59;
        }
    }
    else if (stage == 2) {
        const double x59 = scalars[17];
        const double x61 = found[0];
        const double x87 = found[33];
        const double x62 = x59 + x61;
        const bool x80 = determined;
        const double x88 = sqrt(x87);
        const double x89 = radius * x88;
        if (get_local_id(0) == 0) {
            scalars[20] = x89;
            scalars[21] = x80;
            for (uint j = 0; j < MEMORY; ++j)
                scalars[22 + j] = factors[j];
            scalars[39] = x62;
        }
    }
    else if (stage == 3) {
        const double x89 = scalars[20];
        const bool x80 = scalars[21] != 0.0;
        const double x92 = found[0];
        const double x93 = sqrt(x92);
        const double x94 = fmax(x93, 2.2250738585072014e-308);
        const double x95 = x89 / x94;
        const double x96 = fmin(1.0, x95);
        const bool x97 = x93 > x89;
        const bool x100 = x80 && x97;
        if (get_local_id(0) == 0) {
            scalars[44] = x96;
            scalars[46] = x100;
        }
    }
    else if (stage == 4) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const double x31 = scalars[5];
        const double x62 = scalars[39];
        const bool x80 = scalars[21] != 0.0;
        const bool x100 = scalars[46] != 0.0;
        const double x118 = scalars[6];
        const double x111 = found[0];
        const double x113 = found[1];
        const double x114 = x111 - x113;
        const double x115 = 0.5 * x114;
        if (get_local_id(0) == 0) {
            numbers[NUMBER_RESIDUAL_SIZE] = x31;
            numbers[NUMBER_COLUMN_DUAL] = x62;
            numbers[NUMBER_FOUND] = x80;
            numbers[NUMBER_CUT] = x100;
            numbers[NUMBER_COLUMN_FINITE] = x118;
            numbers[NUMBER_COLUMN_MIDDLE] = next_middle;
            numbers[NUMBER_COLUMN_NEXT] = x115;
        }
    }
#elif BALANCED == 3
    const uint n_found = stage == 0 ? 39 : stage == 1 ? 1 : stage == 2 ? 1 : stage == 3 ? 2 : 0;
    const ulong largest = stage == 0 ? 5 : stage == 1 ? 0 : stage == 2 ? 0 : stage == 3 ? 3 : 0;
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
    double factors[MEMORY];
    const bool determined = solve_normal(products, found + 4, found + 20, PLACE,
                                         stage == 0 ? COUNT : 0, system, factors);
    if (stage == 0) {
        const double x36 = (-1.0) * epsilon;
        const double x27 = log(target_mass);
        const double x34 = fmin(x27, 300.0);
        const double x35 = exp(x34);
        const double x37 = x36 * x35;
        const double x18 = found[0];
        const double x39 = found[1];
        const double x24 = found[2];
        const double x42 = found[3];
        const double x68 = found[36];
        const double x84 = found[37];
        const double x105 = found[38];
        const double x19 = x18 / epsilon;
        const double x25 = x24 / epsilon;
        const double x26 = fmax(x19, x25);
        const double x40 = x37 + x39;
        const double x43 = x40 + x42;
        const bool x61 = determined;
        const double x69 = sqrt(x68);
        const double x70 = radius * x69;
        if (get_local_id(0) == 0) {
            scalars[2] = x70;
            scalars[3] = x61;
            for (uint j = 0; j < MEMORY; ++j)
                scalars[4 + j] = factors[j];
            scalars[20] = x84;
            scalars[25] = x26;
            scalars[29] = x43;
            scalars[30] = x105;
        }
    }
    else if (stage == 1) {
        const double x70 = scalars[2];
        const bool x61 = scalars[3] != 0.0;
        const double x73 = found[0];
        const double x74 = sqrt(x73);
        const double x75 = fmax(x74, 2.2250738585072014e-308);
        const double x76 = x70 / x75;
        const double x77 = fmin(1.0, x76);
        const bool x78 = x74 > x70;
        const bool x87 = x61 && x78;
        if (get_local_id(0) == 0) {
            scalars[35] = x77;
            scalars[37] = x87;
        }
    }
    else if (stage == 2) {
        const double x84 = scalars[20];
        const double x83 = found[0];
        const double x85 = x83 / x84;
        if (get_local_id(0) == 0) {
            scalars[39] = x85;
        }
    }
    else if (stage == 3) {
        const double next_middle = numbers[NUMBER_COLUMN_NEXT];
        const double x26 = scalars[25];
        const double x43 = scalars[29];
        const bool x61 = scalars[3] != 0.0;
        const bool x87 = scalars[37] != 0.0;
        const double x105 = scalars[30];
        const double x98 = found[0];
        const double x100 = found[1];
        const double x101 = x98 - x100;
        const double x102 = 0.5 * x101;
        if (get_local_id(0) == 0) {
            numbers[NUMBER_RESIDUAL_SIZE] = x26;
            numbers[NUMBER_COLUMN_DUAL] = x43;
            numbers[NUMBER_FOUND] = x61;
            numbers[NUMBER_CUT] = x87;
            numbers[NUMBER_COLUMN_FINITE] = x105;
            numbers[NUMBER_COLUMN_MIDDLE] = next_middle;
            numbers[NUMBER_COLUMN_NEXT] = x102;
        }
    }
#endif
}
