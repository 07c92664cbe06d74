// The arithmetic of an iteration between two softmins, float64, in one launch of one work-group:
// damping, translation, marginals, residual, dual, and Anderson's combination of iterates (paper,
// 2.1 and 3.1; the formulas are those of half_steps.py, problem.py and anderson.py in
// clmorph/transport/_solver). Before it a kernel joins the softmin that log_sum_exp.cl has
// computed; after it, it prepares the next.
//
// Written by tools/make_half_steps.py from those formulas: change them. Each operation has its own
// line; x are numbers, v entries of vectors.
//
// Shapes: n points of the rows and m of the columns, both padded to whole tiles by points without
// mass.
// Launch: get_global_size(0) == GROUP, see vector_steps.cl.
//
// -D BALANCED  1: inverse_rho_source is 0; 2: inverse_rho_target; 3: both; 0: none
// -D ROW_*, COLUMN_*, NUMBER_*  places of vectors and numbers, see half_step_slots.py

#ifndef BALANCED
#error "BALANCED (which sides are balanced) must be given"
#endif

#include "softmin_vectors.cl"

// Prepare the softmin of the rows, T(g), for a new g: the host's, or one of the columns' vectors.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void prepare_rows(
    const uint n, const uint m, const uint planes, const uint control, const double k,
    const __global double* restrict start,       // (m,): the host's g
    __global double* restrict columns,           // (slots, m)
    const __global double* restrict tile_costs,  // (n / TILE, m / TILE)
    __global double* restrict tile_max,          // (largest number of tiles,)
    __global double* restrict row_level,         // (n / TILE,)
    __global float* restrict logits,             // (2, m)
    __global float* restrict levels)             // (n / TILE, planes, m / TILE)
{
    if (G_AT == COLUMN_START)
        for (uint i = FIRST; i < m; i += STEP)
            DSTORE(DLOAD(i, start), i, COLUMN(COLUMN_START));
    prepare_softmin(COLUMN(G_AT), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS), tile_costs,
                    m, n / TILE, planes, k, tile_max, row_level, logits, levels);
}

// After T(g): f, the shift of g, and the dual. Then the softmin of the columns, T(f), is prepared.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void row_step(
    const uint n, const uint m, const uint shares, const uint planes, const uint control,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double radius,
    const __global float* restrict maxima,       // (shares, n)
    const __global float* restrict sums,         // (shares, n)
    const __global double* restrict row_level,   // (n / TILE,): of this softmin
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    const __global double* restrict tile_costs,  // (m / TILE, n / TILE)
    __global double* restrict tile_max,          // (largest number of tiles,)
    __global double* restrict next_level,        // (m / TILE,): of the next softmin
    __global float* restrict logits,             // (2, n): of the next softmin
    __global float* restrict levels,             // (m / TILE, planes, n / TILE)
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see half_step_slots.py
{
    __local double shared[GROUP];
    const double nothing = 0.0;
    const uint g_at = G_AT;
#if BALANCED == 0
    const double x10 = epsilon * inverse_rho_source;
    const double x11 = 1.0 + x10;
    const double x12 = 1.0 / x11;
    const double x16 = inverse_rho_source * x12;
    const double x17 = x16 + inverse_rho_target;
    const double x49 = (-1.0) * epsilon;
    vdouble allx28 = (vdouble)(-INFINITY);
    vdouble allx69 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v7 = softmin_of(maxima, sums, row_level, ROW(ROW_OWN_COSTS), shares, n, k, i);
        DSTORE(v7, i, ROW(ROW_SCRATCH_0));
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v26 = v7 * (vdouble)(x16);
        const vdouble v27 = v2 - v26;
        const vdouble v68 = v7 * (vdouble)(nothing);
        allx28 = fmax(allx28, v27);
        allx69 += v68;
    }
    const double x28 = group_largest(largest_lane(allx28), shared);
    const double x69 = group_sum(sum_of_lanes(allx69), shared);
    vdouble allx20 = (vdouble)(-INFINITY);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v8 = DLOAD(i, COLUMN(g_at));
        const vdouble v18 = v8 * (vdouble)(inverse_rho_target);
        const vdouble v19 = v4 - v18;
        allx20 = fmax(allx20, v19);
    }
    const double x20 = group_largest(largest_lane(allx20), shared);
    vdouble allx31 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v7 = DLOAD(i, ROW(ROW_SCRATCH_0));
        const vdouble v26 = v7 * (vdouble)(x16);
        const vdouble v27 = v2 - v26;
        const vdouble v29 = v27 - (vdouble)(x28);
        const vdouble v30 = exp(v29);
        allx31 += v30;
    }
    const double x31 = group_sum(sum_of_lanes(allx31), shared);
    vdouble allx23 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v8 = DLOAD(i, COLUMN(g_at));
        const vdouble v18 = v8 * (vdouble)(inverse_rho_target);
        const vdouble v19 = v4 - v18;
        const vdouble v21 = v19 - (vdouble)(x20);
        const vdouble v22 = exp(v21);
        allx23 += v22;
    }
    const double x23 = group_sum(sum_of_lanes(allx23), shared);
    const double x24 = log(x23);
    const double x25 = x20 + x24;
    const double x32 = log(x31);
    const double x33 = x28 + x32;
    const double x34 = x25 - x33;
    const double x35 = x34 / x17;
    vdouble allx48 = (vdouble)(0.0);
    vdouble allx56 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v7 = DLOAD(i, ROW(ROW_SCRATCH_0));
        const vdouble v36 = v7 - (vdouble)(x35);
        DSTORE(v36, i, ROW(ROW_SOFTMIN));
        const vdouble v39 = (vdouble)(x12) * v36;
        DSTORE(v39, i, ROW(ROW_F));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v41 = v39 - v36;
        const vdouble v42 = v41 / (vdouble)(epsilon);
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v43 = v42 + v2;
        const vdouble v44 = fmin(v43, (vdouble)(300.0));
        const vdouble v46 = exp(v44);
        const vdouble v47 = (v1 > (vdouble)(0.0)) ? v46 : (vdouble)(0.0);
        const vdouble v51 = (vdouble)(-1.0) * v39;
        const vdouble v52 = v51 * (vdouble)(inverse_rho_source);
        const vdouble v53 = fmin(v52, (vdouble)(300.0));
        const vdouble v54 = expm1(v53);
        const vdouble v55 = v1 * v54;
        allx48 += v47;
        allx56 += v55;
    }
    const double x48 = group_sum(sum_of_lanes(allx48), shared);
    const double x56 = group_sum(sum_of_lanes(allx56), shared);
    vdouble allx64 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v8 = DLOAD(i, COLUMN(g_at));
        const vdouble v40 = v8 + (vdouble)(x35);
        DSTORE(v40, i, COLUMN(COLUMN_SHIFTED));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v59 = (vdouble)(-1.0) * v40;
        const vdouble v60 = v59 * (vdouble)(inverse_rho_target);
        const vdouble v61 = fmin(v60, (vdouble)(300.0));
        const vdouble v62 = expm1(v61);
        const vdouble v63 = v3 * v62;
        allx64 += v63;
    }
    const double x64 = group_sum(sum_of_lanes(allx64), shared);
    const double x50 = x49 * x48;
    const double x57 = x56 / inverse_rho_source;
    const double x58 = x50 - x57;
    const double x65 = x64 / inverse_rho_target;
    const double x66 = x58 - x65;
    if (get_local_id(0) == 0) {
        numbers[NUMBER_MASS] = x48;
        numbers[NUMBER_ROW_DUAL] = x66;
        numbers[NUMBER_ROW_FINITE] = x69;
    }
#elif BALANCED == 2
    const double x9 = epsilon * inverse_rho_source;
    const double x10 = 1.0 + x9;
    const double x11 = 1.0 / x10;
    const double x12 = inverse_rho_source * x11;
    const double x42 = (-1.0) * epsilon;
    vdouble allx21 = (vdouble)(-INFINITY);
    vdouble allx57 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v6 = softmin_of(maxima, sums, row_level, ROW(ROW_OWN_COSTS), shares, n, k, i);
        DSTORE(v6, i, ROW(ROW_SCRATCH_0));
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v19 = v6 * (vdouble)(x12);
        const vdouble v20 = v2 - v19;
        const vdouble v56 = v6 * (vdouble)(nothing);
        allx21 = fmax(allx21, v20);
        allx57 += v56;
    }
    const double x21 = group_largest(largest_lane(allx21), shared);
    const double x57 = group_sum(sum_of_lanes(allx57), shared);
    vdouble allx13 = (vdouble)(-INFINITY);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        allx13 = fmax(allx13, v4);
    }
    const double x13 = group_largest(largest_lane(allx13), shared);
    vdouble allx24 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v6 = DLOAD(i, ROW(ROW_SCRATCH_0));
        const vdouble v19 = v6 * (vdouble)(x12);
        const vdouble v20 = v2 - v19;
        const vdouble v22 = v20 - (vdouble)(x21);
        const vdouble v23 = exp(v22);
        allx24 += v23;
    }
    const double x24 = group_sum(sum_of_lanes(allx24), shared);
    vdouble allx16 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v14 = v4 - (vdouble)(x13);
        const vdouble v15 = exp(v14);
        allx16 += v15;
    }
    const double x16 = group_sum(sum_of_lanes(allx16), shared);
    const double x17 = log(x16);
    const double x18 = x13 + x17;
    const double x25 = log(x24);
    const double x26 = x21 + x25;
    const double x27 = x18 - x26;
    const double x28 = x27 / x12;
    vdouble allx41 = (vdouble)(0.0);
    vdouble allx49 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v6 = DLOAD(i, ROW(ROW_SCRATCH_0));
        const vdouble v29 = v6 - (vdouble)(x28);
        DSTORE(v29, i, ROW(ROW_SOFTMIN));
        const vdouble v32 = (vdouble)(x11) * v29;
        DSTORE(v32, i, ROW(ROW_F));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v34 = v32 - v29;
        const vdouble v35 = v34 / (vdouble)(epsilon);
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v36 = v35 + v2;
        const vdouble v37 = fmin(v36, (vdouble)(300.0));
        const vdouble v39 = exp(v37);
        const vdouble v40 = (v1 > (vdouble)(0.0)) ? v39 : (vdouble)(0.0);
        const vdouble v44 = (vdouble)(-1.0) * v32;
        const vdouble v45 = v44 * (vdouble)(inverse_rho_source);
        const vdouble v46 = fmin(v45, (vdouble)(300.0));
        const vdouble v47 = expm1(v46);
        const vdouble v48 = v1 * v47;
        allx41 += v40;
        allx49 += v48;
    }
    const double x41 = group_sum(sum_of_lanes(allx41), shared);
    const double x49 = group_sum(sum_of_lanes(allx49), shared);
    vdouble allx53 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v7 = DLOAD(i, COLUMN(g_at));
        const vdouble v33 = v7 + (vdouble)(x28);
        DSTORE(v33, i, COLUMN(COLUMN_SHIFTED));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v52 = v3 * v33;
        allx53 += v52;
    }
    const double x53 = group_sum(sum_of_lanes(allx53), shared);
    const double x43 = x42 * x41;
    const double x50 = x49 / inverse_rho_source;
    const double x51 = x43 - x50;
    const double x54 = x51 + x53;
    if (get_local_id(0) == 0) {
        numbers[NUMBER_MASS] = x41;
        numbers[NUMBER_ROW_DUAL] = x54;
        numbers[NUMBER_ROW_FINITE] = x57;
    }
#elif BALANCED == 1
    const double x38 = (-1.0) * epsilon;
    vdouble allx20 = (vdouble)(-INFINITY);
    vdouble allx53 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v6 = softmin_of(maxima, sums, row_level, ROW(ROW_OWN_COSTS), shares, n, k, i);
        DSTORE(v6, i, ROW(ROW_SCRATCH_0));
        const vdouble v52 = v6 * (vdouble)(nothing);
        allx20 = fmax(allx20, v2);
        allx53 += v52;
    }
    const double x20 = group_largest(largest_lane(allx20), shared);
    const double x53 = group_sum(sum_of_lanes(allx53), shared);
    vdouble allx14 = (vdouble)(-INFINITY);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v7 = DLOAD(i, COLUMN(g_at));
        const vdouble v12 = v7 * (vdouble)(inverse_rho_target);
        const vdouble v13 = v4 - v12;
        allx14 = fmax(allx14, v13);
    }
    const double x14 = group_largest(largest_lane(allx14), shared);
    vdouble allx23 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v21 = v2 - (vdouble)(x20);
        const vdouble v22 = exp(v21);
        allx23 += v22;
    }
    const double x23 = group_sum(sum_of_lanes(allx23), shared);
    vdouble allx17 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v7 = DLOAD(i, COLUMN(g_at));
        const vdouble v12 = v7 * (vdouble)(inverse_rho_target);
        const vdouble v13 = v4 - v12;
        const vdouble v15 = v13 - (vdouble)(x14);
        const vdouble v16 = exp(v15);
        allx17 += v16;
    }
    const double x17 = group_sum(sum_of_lanes(allx17), shared);
    const double x18 = log(x17);
    const double x19 = x14 + x18;
    const double x24 = log(x23);
    const double x25 = x20 + x24;
    const double x26 = x19 - x25;
    const double x27 = x26 / inverse_rho_target;
    vdouble allx37 = (vdouble)(0.0);
    vdouble allx41 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v6 = DLOAD(i, ROW(ROW_SCRATCH_0));
        const vdouble v28 = v6 - (vdouble)(x27);
        DSTORE(v28, i, ROW(ROW_F));
        DSTORE(v28, i, ROW(ROW_SOFTMIN));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v30 = v28 - v28;
        const vdouble v31 = v30 / (vdouble)(epsilon);
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v32 = v31 + v2;
        const vdouble v33 = fmin(v32, (vdouble)(300.0));
        const vdouble v35 = exp(v33);
        const vdouble v36 = (v1 > (vdouble)(0.0)) ? v35 : (vdouble)(0.0);
        const vdouble v40 = v1 * v28;
        allx37 += v36;
        allx41 += v40;
    }
    const double x37 = group_sum(sum_of_lanes(allx37), shared);
    const double x41 = group_sum(sum_of_lanes(allx41), shared);
    vdouble allx48 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v7 = DLOAD(i, COLUMN(g_at));
        const vdouble v29 = v7 + (vdouble)(x27);
        DSTORE(v29, i, COLUMN(COLUMN_SHIFTED));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v43 = (vdouble)(-1.0) * v29;
        const vdouble v44 = v43 * (vdouble)(inverse_rho_target);
        const vdouble v45 = fmin(v44, (vdouble)(300.0));
        const vdouble v46 = expm1(v45);
        const vdouble v47 = v3 * v46;
        allx48 += v47;
    }
    const double x48 = group_sum(sum_of_lanes(allx48), shared);
    const double x39 = x38 * x37;
    const double x42 = x39 + x41;
    const double x49 = x48 / inverse_rho_target;
    const double x50 = x42 - x49;
    if (get_local_id(0) == 0) {
        numbers[NUMBER_MASS] = x37;
        numbers[NUMBER_ROW_DUAL] = x50;
        numbers[NUMBER_ROW_FINITE] = x53;
    }
#elif BALANCED == 3
    const double x16 = (-1.0) * epsilon;
    vdouble allx15 = (vdouble)(0.0);
    vdouble allx19 = (vdouble)(0.0);
    vdouble allx26 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v5 = softmin_of(maxima, sums, row_level, ROW(ROW_OWN_COSTS), shares, n, k, i);
        DSTORE(v5, i, ROW(ROW_F));
        DSTORE(v5, i, ROW(ROW_SOFTMIN));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v8 = v5 - v5;
        const vdouble v9 = v8 / (vdouble)(epsilon);
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v10 = v9 + v2;
        const vdouble v11 = fmin(v10, (vdouble)(300.0));
        const vdouble v13 = exp(v11);
        const vdouble v14 = (v1 > (vdouble)(0.0)) ? v13 : (vdouble)(0.0);
        const vdouble v18 = v1 * v5;
        const vdouble v25 = v5 * (vdouble)(nothing);
        allx15 += v14;
        allx19 += v18;
        allx26 += v25;
    }
    const double x15 = group_sum(sum_of_lanes(allx15), shared);
    const double x19 = group_sum(sum_of_lanes(allx19), shared);
    const double x26 = group_sum(sum_of_lanes(allx26), shared);
    vdouble allx22 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v6 = DLOAD(i, COLUMN(g_at));
        DSTORE(v6, i, COLUMN(COLUMN_SHIFTED));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v21 = v3 * v6;
        allx22 += v21;
    }
    const double x22 = group_sum(sum_of_lanes(allx22), shared);
    const double x17 = x16 * x15;
    const double x20 = x17 + x19;
    const double x23 = x20 + x22;
    if (get_local_id(0) == 0) {
        numbers[NUMBER_MASS] = x15;
        numbers[NUMBER_ROW_DUAL] = x23;
        numbers[NUMBER_ROW_FINITE] = x26;
    }
#endif
    prepare_softmin(ROW(ROW_F), ROW(ROW_OFFSETS), ROW(ROW_LOG2_WEIGHTS), tile_costs, n, m / TILE,
                    planes, k, tile_max, next_level, logits, levels);
}

// After T(f): the residual, the image of g, the shift of f, the dual, and the extrapolated g. Then
// the softmin of the rows, T(g), is prepared.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void column_step(
    const uint n, const uint m, const uint shares, const uint planes, const uint control,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double radius,
    const __global float* restrict maxima,       // (shares, m)
    const __global float* restrict sums,         // (shares, m)
    const __global double* restrict row_level,   // (m / TILE,): of this softmin
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    const __global double* restrict tile_costs,  // (n / TILE, m / TILE)
    __global double* restrict tile_max,          // (largest number of tiles,)
    __global double* restrict next_level,        // (n / TILE,): of the next softmin
    __global float* restrict logits,             // (2, m): of the next softmin
    __global float* restrict levels,             // (n / TILE, planes, m / TILE)
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see half_step_slots.py
{
    __local double shared[GROUP];
    __local double system[MEMORY * SYSTEM_ROW];
    const double nothing = 0.0;
    const bool begun = BEGUN;
    const uint place = PLACE, count = COUNT, g_at = G_AT;
    const uint image_at = COLUMN_IMAGE_0 + PARITY, old_image_at = COLUMN_IMAGE_1 - PARITY;
    const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
    const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
    const uint guess_at = COLUMN_GUESS_0 + PARITY;
    const uint new_ahead_at = COLUMN_AHEAD + place;
    const uint new_difference_at = COLUMN_DIFFERENCES + place;
#if BALANCED == 0
    const double x13 = epsilon * inverse_rho_source;
    const double x14 = 1.0 + x13;
    const double x15 = 1.0 / x14;
    const double x16 = epsilon * inverse_rho_target;
    const double x17 = 1.0 + x16;
    const double x18 = 1.0 / x17;
    const double x34 = inverse_rho_target * x18;
    const double x35 = x34 + inverse_rho_source;
    const double x66 = (-1.0) * epsilon;
    vdouble allx24 = (vdouble)(-INFINITY);
    vdouble allx38 = (vdouble)(-INFINITY);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v9 = DLOAD(i, ROW(ROW_F));
        const vdouble v11 = DLOAD(i, ROW(ROW_SOFTMIN));
        const vdouble v20 = (vdouble)(x15) * v11;
        const vdouble v21 = v9 - v20;
        const vdouble v22 = fabs(v21);
        const vdouble v23 = (v1 > (vdouble)(0.0)) ? v22 : (vdouble)(0.0);
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v36 = v9 * (vdouble)(inverse_rho_source);
        const vdouble v37 = v2 - v36;
        allx24 = fmax(allx24, v23);
        allx38 = fmax(allx38, v37);
    }
    const double x24 = group_largest(largest_lane(allx24), shared);
    const double x38 = group_largest(largest_lane(allx38), shared);
    vdouble allx31 = (vdouble)(-INFINITY);
    vdouble allx46 = (vdouble)(-INFINITY);
    vdouble allx123 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v7 = softmin_of(maxima, sums, row_level, COLUMN(COLUMN_OWN_COSTS), shares, m, k, i);
        DSTORE(v7, i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v10 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
        const vdouble v27 = (vdouble)(x18) * v7;
        const vdouble v28 = v10 - v27;
        const vdouble v29 = fabs(v28);
        const vdouble v30 = (v3 > (vdouble)(0.0)) ? v29 : (vdouble)(0.0);
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v44 = v7 * (vdouble)(x34);
        const vdouble v45 = v4 - v44;
        const vdouble v122 = v7 * (vdouble)(nothing);
        allx31 = fmax(allx31, v30);
        allx46 = fmax(allx46, v45);
        allx123 += v122;
    }
    const double x31 = group_largest(largest_lane(allx31), shared);
    const double x46 = group_largest(largest_lane(allx46), shared);
    const double x123 = group_sum(sum_of_lanes(allx123), shared);
    const double x25 = x24 / epsilon;
    const double x32 = x31 / epsilon;
    const double x33 = fmax(x25, x32);
    vdouble allx41 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v9 = DLOAD(i, ROW(ROW_F));
        const vdouble v36 = v9 * (vdouble)(inverse_rho_source);
        const vdouble v37 = v2 - v36;
        const vdouble v39 = v37 - (vdouble)(x38);
        const vdouble v40 = exp(v39);
        allx41 += v40;
    }
    const double x41 = group_sum(sum_of_lanes(allx41), shared);
    vdouble allx49 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v7 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v44 = v7 * (vdouble)(x34);
        const vdouble v45 = v4 - v44;
        const vdouble v47 = v45 - (vdouble)(x46);
        const vdouble v48 = exp(v47);
        allx49 += v48;
    }
    const double x49 = group_sum(sum_of_lanes(allx49), shared);
    const double x42 = log(x41);
    const double x43 = x38 + x42;
    const double x50 = log(x49);
    const double x51 = x46 + x50;
    const double x52 = x43 - x51;
    const double x53 = x52 / x35;
    vdouble allx73 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v9 = DLOAD(i, ROW(ROW_F));
        const vdouble v58 = v9 + (vdouble)(x53);
        DSTORE(v58, i, ROW(ROW_SHIFTED));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v68 = (vdouble)(-1.0) * v58;
        const vdouble v69 = v68 * (vdouble)(inverse_rho_source);
        const vdouble v70 = fmin(v69, (vdouble)(300.0));
        const vdouble v71 = expm1(v70);
        const vdouble v72 = v1 * v71;
        allx73 += v72;
    }
    const double x73 = group_sum(sum_of_lanes(allx73), shared);
    vdouble allx65 = (vdouble)(0.0);
    vdouble allx81 = (vdouble)(0.0);
    vdouble allx97[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx97[j] = (vdouble)(0.0);
    vdouble allx99[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx99[j] = (vdouble)(0.0);
    vdouble allx107 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v7 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v54 = v7 - (vdouble)(x53);
        DSTORE(v54, i, COLUMN(COLUMN_SOFTMIN));
        const vdouble v57 = (vdouble)(x18) * v54;
        DSTORE(v57, i, COLUMN(image_at));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v59 = v57 - v54;
        const vdouble v60 = v59 / (vdouble)(epsilon);
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v61 = v60 + v4;
        const vdouble v62 = fmin(v61, (vdouble)(300.0));
        const vdouble v63 = exp(v62);
        const vdouble v64 = (v3 > (vdouble)(0.0)) ? v63 : (vdouble)(0.0);
        const vdouble v76 = (vdouble)(-1.0) * v57;
        const vdouble v77 = v76 * (vdouble)(inverse_rho_target);
        const vdouble v78 = fmin(v77, (vdouble)(300.0));
        const vdouble v79 = expm1(v78);
        const vdouble v80 = v3 * v79;
        const vdouble v8 = DLOAD(i, COLUMN(g_at));
        const vdouble v85 = v57 - v8;
        DSTORE(v85, i, COLUMN(residual_at));
        const vdouble v86 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v87 = begun ? v86 : v64;
        DSTORE(v87, i, COLUMN(COLUMN_MASS));
        const vdouble v91 = DLOAD(i, COLUMN(old_residual_at));
        const vdouble v92 = v85 - v91;
        const vdouble v93 = begun ? v92 : (vdouble)(0.0);
        DSTORE(v93, i, COLUMN(new_difference_at));
        const vdouble v88 = DLOAD(i, COLUMN(old_image_at));
        const vdouble v89 = v57 - v88;
        const vdouble v90 = begun ? v89 : (vdouble)(0.0);
        const vdouble v94 = (vdouble)(0.5) * v93;
        const vdouble v95 = v90 + v94;
        DSTORE(v95, i, COLUMN(new_ahead_at));
        const vdouble v96 = v93 * v87;
        const vdouble v98 = v87 * v85;
        const vdouble v105 = v85 * v87;
        const vdouble v106 = v105 * v85;
        allx65 += v64;
        allx81 += v80;
        for (uint j = 0; j < MEMORY; ++j)
            allx97[j] += DLOAD(i, DIFFERENCES(j)) * v96;
        for (uint j = 0; j < MEMORY; ++j)
            allx99[j] += DLOAD(i, DIFFERENCES(j)) * v98;
        allx107 += v106;
    }
    const double x65 = group_sum(sum_of_lanes(allx65), shared);
    const double x81 = group_sum(sum_of_lanes(allx81), shared);
    double x97[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x97[j] = group_sum(sum_of_lanes(allx97[j]), shared);
    double x99[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x99[j] = group_sum(sum_of_lanes(allx99[j]), shared);
    const double x107 = group_sum(sum_of_lanes(allx107), shared);
    const double x67 = x66 * x65;
    const double x74 = x73 / inverse_rho_source;
    const double x75 = x67 - x74;
    const double x82 = x81 / inverse_rho_target;
    const double x83 = x75 - x82;
    double factorsx100[MEMORY];
    const bool x100 = solve_normal(
        products, x97, x99, place, count, system, factorsx100);
    const double x108 = sqrt(x107);
    const double x109 = radius * x108;
    vdouble allx112 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        vdouble v101 = (vdouble)(0.0);
        for (uint j = 0; j < MEMORY; ++j)
            v101 += factorsx100[j] * DLOAD(i, AHEAD(j));
        DSTORE(v101, i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v85 = DLOAD(i, COLUMN(residual_at));
        const vdouble v103 = (vdouble)(0.5) * v85;
        const vdouble v104 = v103 - v101;
        const vdouble v87 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v110 = v104 * v87;
        const vdouble v111 = v110 * v104;
        allx112 += v111;
    }
    const double x112 = group_sum(sum_of_lanes(allx112), shared);
    const double x113 = sqrt(x112);
    const double x114 = fmax(x113, 2.2250738585072014e-308);
    const double x115 = x109 / x114;
    const double x116 = fmin(1.0, x115);
    const bool x117 = x113 > x109;
    const bool x120 = x100 && x117;
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v57 = DLOAD(i, COLUMN(image_at));
        const vdouble v85 = DLOAD(i, COLUMN(residual_at));
        const vdouble v103 = (vdouble)(0.5) * v85;
        const vdouble v101 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v104 = v103 - v101;
        const vdouble v118 = (vdouble)(x116) * v104;
        const vdouble v119 = v57 + v118;
        DSTORE(v119, i, COLUMN(guess_at));
    }
    if (get_local_id(0) == 0) {
        numbers[NUMBER_RESIDUAL_SIZE] = x33;
        numbers[NUMBER_COLUMN_DUAL] = x83;
        numbers[NUMBER_FOUND] = x100;
        numbers[NUMBER_CUT] = x120;
        numbers[NUMBER_COLUMN_FINITE] = x123;
    }
    const bool numbers_found = x100;
#elif BALANCED == 2
    const double x12 = epsilon * inverse_rho_source;
    const double x13 = 1.0 + x12;
    const double x14 = 1.0 / x13;
    const double x54 = (-1.0) * epsilon;
    vdouble allx20 = (vdouble)(-INFINITY);
    vdouble allx31 = (vdouble)(-INFINITY);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v8 = DLOAD(i, ROW(ROW_F));
        const vdouble v10 = DLOAD(i, ROW(ROW_SOFTMIN));
        const vdouble v16 = (vdouble)(x14) * v10;
        const vdouble v17 = v8 - v16;
        const vdouble v18 = fabs(v17);
        const vdouble v19 = (v1 > (vdouble)(0.0)) ? v18 : (vdouble)(0.0);
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v29 = v8 * (vdouble)(inverse_rho_source);
        const vdouble v30 = v2 - v29;
        allx20 = fmax(allx20, v19);
        allx31 = fmax(allx31, v30);
    }
    const double x20 = group_largest(largest_lane(allx20), shared);
    const double x31 = group_largest(largest_lane(allx31), shared);
    vdouble allx26 = (vdouble)(-INFINITY);
    vdouble allx37 = (vdouble)(-INFINITY);
    vdouble allx106 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v6 = softmin_of(maxima, sums, row_level, COLUMN(COLUMN_OWN_COSTS), shares, m, k, i);
        DSTORE(v6, i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v9 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
        const vdouble v23 = v9 - v6;
        const vdouble v24 = fabs(v23);
        const vdouble v25 = (v3 > (vdouble)(0.0)) ? v24 : (vdouble)(0.0);
        const vdouble v105 = v6 * (vdouble)(nothing);
        allx26 = fmax(allx26, v25);
        allx37 = fmax(allx37, v4);
        allx106 += v105;
    }
    const double x26 = group_largest(largest_lane(allx26), shared);
    const double x37 = group_largest(largest_lane(allx37), shared);
    const double x106 = group_sum(sum_of_lanes(allx106), shared);
    const double x21 = x20 / epsilon;
    const double x27 = x26 / epsilon;
    const double x28 = fmax(x21, x27);
    vdouble allx34 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v8 = DLOAD(i, ROW(ROW_F));
        const vdouble v29 = v8 * (vdouble)(inverse_rho_source);
        const vdouble v30 = v2 - v29;
        const vdouble v32 = v30 - (vdouble)(x31);
        const vdouble v33 = exp(v32);
        allx34 += v33;
    }
    const double x34 = group_sum(sum_of_lanes(allx34), shared);
    vdouble allx40 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v38 = v4 - (vdouble)(x37);
        const vdouble v39 = exp(v38);
        allx40 += v39;
    }
    const double x40 = group_sum(sum_of_lanes(allx40), shared);
    const double x35 = log(x34);
    const double x36 = x31 + x35;
    const double x41 = log(x40);
    const double x42 = x37 + x41;
    const double x43 = x36 - x42;
    const double x44 = x43 / inverse_rho_source;
    vdouble allx61 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v8 = DLOAD(i, ROW(ROW_F));
        const vdouble v46 = v8 + (vdouble)(x44);
        DSTORE(v46, i, ROW(ROW_SHIFTED));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v56 = (vdouble)(-1.0) * v46;
        const vdouble v57 = v56 * (vdouble)(inverse_rho_source);
        const vdouble v58 = fmin(v57, (vdouble)(300.0));
        const vdouble v59 = expm1(v58);
        const vdouble v60 = v1 * v59;
        allx61 += v60;
    }
    const double x61 = group_sum(sum_of_lanes(allx61), shared);
    vdouble allx53 = (vdouble)(0.0);
    vdouble allx65 = (vdouble)(0.0);
    vdouble allx80[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx80[j] = (vdouble)(0.0);
    vdouble allx82[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx82[j] = (vdouble)(0.0);
    vdouble allx90 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v6 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v45 = v6 - (vdouble)(x44);
        DSTORE(v45, i, COLUMN(image_at));
        DSTORE(v45, i, COLUMN(COLUMN_SOFTMIN));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v47 = v45 - v45;
        const vdouble v48 = v47 / (vdouble)(epsilon);
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v49 = v48 + v4;
        const vdouble v50 = fmin(v49, (vdouble)(300.0));
        const vdouble v51 = exp(v50);
        const vdouble v52 = (v3 > (vdouble)(0.0)) ? v51 : (vdouble)(0.0);
        const vdouble v64 = v3 * v45;
        const vdouble v7 = DLOAD(i, COLUMN(g_at));
        const vdouble v68 = v45 - v7;
        DSTORE(v68, i, COLUMN(residual_at));
        const vdouble v69 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v70 = begun ? v69 : v52;
        DSTORE(v70, i, COLUMN(COLUMN_MASS));
        const vdouble v74 = DLOAD(i, COLUMN(old_residual_at));
        const vdouble v75 = v68 - v74;
        const vdouble v76 = begun ? v75 : (vdouble)(0.0);
        DSTORE(v76, i, COLUMN(new_difference_at));
        const vdouble v71 = DLOAD(i, COLUMN(old_image_at));
        const vdouble v72 = v45 - v71;
        const vdouble v73 = begun ? v72 : (vdouble)(0.0);
        const vdouble v77 = (vdouble)(0.5) * v76;
        const vdouble v78 = v73 + v77;
        DSTORE(v78, i, COLUMN(new_ahead_at));
        const vdouble v79 = v76 * v70;
        const vdouble v81 = v70 * v68;
        const vdouble v88 = v68 * v70;
        const vdouble v89 = v88 * v68;
        allx53 += v52;
        allx65 += v64;
        for (uint j = 0; j < MEMORY; ++j)
            allx80[j] += DLOAD(i, DIFFERENCES(j)) * v79;
        for (uint j = 0; j < MEMORY; ++j)
            allx82[j] += DLOAD(i, DIFFERENCES(j)) * v81;
        allx90 += v89;
    }
    const double x53 = group_sum(sum_of_lanes(allx53), shared);
    const double x65 = group_sum(sum_of_lanes(allx65), shared);
    double x80[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x80[j] = group_sum(sum_of_lanes(allx80[j]), shared);
    double x82[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x82[j] = group_sum(sum_of_lanes(allx82[j]), shared);
    const double x90 = group_sum(sum_of_lanes(allx90), shared);
    const double x55 = x54 * x53;
    const double x62 = x61 / inverse_rho_source;
    const double x63 = x55 - x62;
    const double x66 = x63 + x65;
    double factorsx83[MEMORY];
    const bool x83 = solve_normal(
        products, x80, x82, place, count, system, factorsx83);
    const double x91 = sqrt(x90);
    const double x92 = radius * x91;
    vdouble allx95 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        vdouble v84 = (vdouble)(0.0);
        for (uint j = 0; j < MEMORY; ++j)
            v84 += factorsx83[j] * DLOAD(i, AHEAD(j));
        DSTORE(v84, i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v68 = DLOAD(i, COLUMN(residual_at));
        const vdouble v86 = (vdouble)(0.5) * v68;
        const vdouble v87 = v86 - v84;
        const vdouble v70 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v93 = v87 * v70;
        const vdouble v94 = v93 * v87;
        allx95 += v94;
    }
    const double x95 = group_sum(sum_of_lanes(allx95), shared);
    const double x96 = sqrt(x95);
    const double x97 = fmax(x96, 2.2250738585072014e-308);
    const double x98 = x92 / x97;
    const double x99 = fmin(1.0, x98);
    const bool x100 = x96 > x92;
    const bool x103 = x83 && x100;
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v45 = DLOAD(i, COLUMN(image_at));
        const vdouble v68 = DLOAD(i, COLUMN(residual_at));
        const vdouble v86 = (vdouble)(0.5) * v68;
        const vdouble v84 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v87 = v86 - v84;
        const vdouble v101 = (vdouble)(x99) * v87;
        const vdouble v102 = v45 + v101;
        DSTORE(v102, i, COLUMN(guess_at));
    }
    if (get_local_id(0) == 0) {
        numbers[NUMBER_RESIDUAL_SIZE] = x28;
        numbers[NUMBER_COLUMN_DUAL] = x66;
        numbers[NUMBER_FOUND] = x83;
        numbers[NUMBER_CUT] = x103;
        numbers[NUMBER_COLUMN_FINITE] = x106;
    }
    const bool numbers_found = x83;
#elif BALANCED == 1
    const double x12 = epsilon * inverse_rho_target;
    const double x13 = 1.0 + x12;
    const double x14 = 1.0 / x13;
    const double x29 = inverse_rho_target * x14;
    const double x58 = (-1.0) * epsilon;
    vdouble allx19 = (vdouble)(-INFINITY);
    vdouble allx30 = (vdouble)(-INFINITY);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v8 = DLOAD(i, ROW(ROW_F));
        const vdouble v10 = DLOAD(i, ROW(ROW_SOFTMIN));
        const vdouble v16 = v8 - v10;
        const vdouble v17 = fabs(v16);
        const vdouble v18 = (v1 > (vdouble)(0.0)) ? v17 : (vdouble)(0.0);
        allx19 = fmax(allx19, v18);
        allx30 = fmax(allx30, v2);
    }
    const double x19 = group_largest(largest_lane(allx19), shared);
    const double x30 = group_largest(largest_lane(allx30), shared);
    vdouble allx26 = (vdouble)(-INFINITY);
    vdouble allx38 = (vdouble)(-INFINITY);
    vdouble allx110 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v6 = softmin_of(maxima, sums, row_level, COLUMN(COLUMN_OWN_COSTS), shares, m, k, i);
        DSTORE(v6, i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v9 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
        const vdouble v22 = (vdouble)(x14) * v6;
        const vdouble v23 = v9 - v22;
        const vdouble v24 = fabs(v23);
        const vdouble v25 = (v3 > (vdouble)(0.0)) ? v24 : (vdouble)(0.0);
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v36 = v6 * (vdouble)(x29);
        const vdouble v37 = v4 - v36;
        const vdouble v109 = v6 * (vdouble)(nothing);
        allx26 = fmax(allx26, v25);
        allx38 = fmax(allx38, v37);
        allx110 += v109;
    }
    const double x26 = group_largest(largest_lane(allx26), shared);
    const double x38 = group_largest(largest_lane(allx38), shared);
    const double x110 = group_sum(sum_of_lanes(allx110), shared);
    const double x20 = x19 / epsilon;
    const double x27 = x26 / epsilon;
    const double x28 = fmax(x20, x27);
    vdouble allx33 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v2 = DLOAD(i, ROW(ROW_LOG_WEIGHTS));
        const vdouble v31 = v2 - (vdouble)(x30);
        const vdouble v32 = exp(v31);
        allx33 += v32;
    }
    const double x33 = group_sum(sum_of_lanes(allx33), shared);
    vdouble allx41 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v6 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v36 = v6 * (vdouble)(x29);
        const vdouble v37 = v4 - v36;
        const vdouble v39 = v37 - (vdouble)(x38);
        const vdouble v40 = exp(v39);
        allx41 += v40;
    }
    const double x41 = group_sum(sum_of_lanes(allx41), shared);
    const double x34 = log(x33);
    const double x35 = x30 + x34;
    const double x42 = log(x41);
    const double x43 = x38 + x42;
    const double x44 = x35 - x43;
    const double x45 = x44 / x29;
    vdouble allx61 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v8 = DLOAD(i, ROW(ROW_F));
        const vdouble v50 = v8 + (vdouble)(x45);
        DSTORE(v50, i, ROW(ROW_SHIFTED));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v60 = v1 * v50;
        allx61 += v60;
    }
    const double x61 = group_sum(sum_of_lanes(allx61), shared);
    vdouble allx57 = (vdouble)(0.0);
    vdouble allx68 = (vdouble)(0.0);
    vdouble allx84[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx84[j] = (vdouble)(0.0);
    vdouble allx86[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx86[j] = (vdouble)(0.0);
    vdouble allx94 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v6 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v46 = v6 - (vdouble)(x45);
        DSTORE(v46, i, COLUMN(COLUMN_SOFTMIN));
        const vdouble v49 = (vdouble)(x14) * v46;
        DSTORE(v49, i, COLUMN(image_at));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v51 = v49 - v46;
        const vdouble v52 = v51 / (vdouble)(epsilon);
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v53 = v52 + v4;
        const vdouble v54 = fmin(v53, (vdouble)(300.0));
        const vdouble v55 = exp(v54);
        const vdouble v56 = (v3 > (vdouble)(0.0)) ? v55 : (vdouble)(0.0);
        const vdouble v63 = (vdouble)(-1.0) * v49;
        const vdouble v64 = v63 * (vdouble)(inverse_rho_target);
        const vdouble v65 = fmin(v64, (vdouble)(300.0));
        const vdouble v66 = expm1(v65);
        const vdouble v67 = v3 * v66;
        const vdouble v7 = DLOAD(i, COLUMN(g_at));
        const vdouble v72 = v49 - v7;
        DSTORE(v72, i, COLUMN(residual_at));
        const vdouble v73 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v74 = begun ? v73 : v56;
        DSTORE(v74, i, COLUMN(COLUMN_MASS));
        const vdouble v78 = DLOAD(i, COLUMN(old_residual_at));
        const vdouble v79 = v72 - v78;
        const vdouble v80 = begun ? v79 : (vdouble)(0.0);
        DSTORE(v80, i, COLUMN(new_difference_at));
        const vdouble v75 = DLOAD(i, COLUMN(old_image_at));
        const vdouble v76 = v49 - v75;
        const vdouble v77 = begun ? v76 : (vdouble)(0.0);
        const vdouble v81 = (vdouble)(0.5) * v80;
        const vdouble v82 = v77 + v81;
        DSTORE(v82, i, COLUMN(new_ahead_at));
        const vdouble v83 = v80 * v74;
        const vdouble v85 = v74 * v72;
        const vdouble v92 = v72 * v74;
        const vdouble v93 = v92 * v72;
        allx57 += v56;
        allx68 += v67;
        for (uint j = 0; j < MEMORY; ++j)
            allx84[j] += DLOAD(i, DIFFERENCES(j)) * v83;
        for (uint j = 0; j < MEMORY; ++j)
            allx86[j] += DLOAD(i, DIFFERENCES(j)) * v85;
        allx94 += v93;
    }
    const double x57 = group_sum(sum_of_lanes(allx57), shared);
    const double x68 = group_sum(sum_of_lanes(allx68), shared);
    double x84[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x84[j] = group_sum(sum_of_lanes(allx84[j]), shared);
    double x86[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x86[j] = group_sum(sum_of_lanes(allx86[j]), shared);
    const double x94 = group_sum(sum_of_lanes(allx94), shared);
    const double x59 = x58 * x57;
    const double x62 = x59 + x61;
    const double x69 = x68 / inverse_rho_target;
    const double x70 = x62 - x69;
    double factorsx87[MEMORY];
    const bool x87 = solve_normal(
        products, x84, x86, place, count, system, factorsx87);
    const double x95 = sqrt(x94);
    const double x96 = radius * x95;
    vdouble allx99 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        vdouble v88 = (vdouble)(0.0);
        for (uint j = 0; j < MEMORY; ++j)
            v88 += factorsx87[j] * DLOAD(i, AHEAD(j));
        DSTORE(v88, i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v72 = DLOAD(i, COLUMN(residual_at));
        const vdouble v90 = (vdouble)(0.5) * v72;
        const vdouble v91 = v90 - v88;
        const vdouble v74 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v97 = v91 * v74;
        const vdouble v98 = v97 * v91;
        allx99 += v98;
    }
    const double x99 = group_sum(sum_of_lanes(allx99), shared);
    const double x100 = sqrt(x99);
    const double x101 = fmax(x100, 2.2250738585072014e-308);
    const double x102 = x96 / x101;
    const double x103 = fmin(1.0, x102);
    const bool x104 = x100 > x96;
    const bool x107 = x87 && x104;
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v49 = DLOAD(i, COLUMN(image_at));
        const vdouble v72 = DLOAD(i, COLUMN(residual_at));
        const vdouble v90 = (vdouble)(0.5) * v72;
        const vdouble v88 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v91 = v90 - v88;
        const vdouble v105 = (vdouble)(x103) * v91;
        const vdouble v106 = v49 + v105;
        DSTORE(v106, i, COLUMN(guess_at));
    }
    if (get_local_id(0) == 0) {
        numbers[NUMBER_RESIDUAL_SIZE] = x28;
        numbers[NUMBER_COLUMN_DUAL] = x70;
        numbers[NUMBER_FOUND] = x87;
        numbers[NUMBER_CUT] = x107;
        numbers[NUMBER_COLUMN_FINITE] = x110;
    }
    const bool numbers_found = x87;
#elif BALANCED == 3
    const double x31 = (-1.0) * epsilon;
    vdouble allx15 = (vdouble)(-INFINITY);
    vdouble allx34 = (vdouble)(0.0);
    for (uint i = FIRST; i < n; i += STEP) {
        const vdouble v7 = DLOAD(i, ROW(ROW_F));
        DSTORE(v7, i, ROW(ROW_SHIFTED));
        const vdouble v1 = DLOAD(i, ROW(ROW_WEIGHTS));
        const vdouble v9 = DLOAD(i, ROW(ROW_SOFTMIN));
        const vdouble v12 = v7 - v9;
        const vdouble v13 = fabs(v12);
        const vdouble v14 = (v1 > (vdouble)(0.0)) ? v13 : (vdouble)(0.0);
        const vdouble v33 = v1 * v7;
        allx15 = fmax(allx15, v14);
        allx34 += v33;
    }
    const double x15 = group_largest(largest_lane(allx15), shared);
    const double x34 = group_sum(sum_of_lanes(allx34), shared);
    vdouble allx21 = (vdouble)(-INFINITY);
    vdouble allx30 = (vdouble)(0.0);
    vdouble allx37 = (vdouble)(0.0);
    vdouble allx52[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx52[j] = (vdouble)(0.0);
    vdouble allx54[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        allx54[j] = (vdouble)(0.0);
    vdouble allx62 = (vdouble)(0.0);
    vdouble allx83 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v5 = softmin_of(maxima, sums, row_level, COLUMN(COLUMN_OWN_COSTS), shares, m, k, i);
        DSTORE(v5, i, COLUMN(image_at));
        DSTORE(v5, i, COLUMN(COLUMN_SOFTMIN));
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v8 = DLOAD(i, COLUMN(COLUMN_SHIFTED));
        const vdouble v18 = v8 - v5;
        const vdouble v19 = fabs(v18);
        const vdouble v20 = (v3 > (vdouble)(0.0)) ? v19 : (vdouble)(0.0);
        const vdouble v24 = v5 - v5;
        const vdouble v25 = v24 / (vdouble)(epsilon);
        const vdouble v4 = DLOAD(i, COLUMN(COLUMN_LOG_WEIGHTS));
        const vdouble v26 = v25 + v4;
        const vdouble v27 = fmin(v26, (vdouble)(300.0));
        const vdouble v28 = exp(v27);
        DSTORE(v28, i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v29 = (v3 > (vdouble)(0.0)) ? v28 : (vdouble)(0.0);
        const vdouble v36 = v3 * v5;
        const vdouble v6 = DLOAD(i, COLUMN(g_at));
        const vdouble v40 = v5 - v6;
        DSTORE(v40, i, COLUMN(residual_at));
        const vdouble v41 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v42 = begun ? v41 : v29;
        DSTORE(v42, i, COLUMN(COLUMN_MASS));
        const vdouble v46 = DLOAD(i, COLUMN(old_residual_at));
        const vdouble v47 = v40 - v46;
        const vdouble v48 = begun ? v47 : (vdouble)(0.0);
        DSTORE(v48, i, COLUMN(new_difference_at));
        const vdouble v43 = DLOAD(i, COLUMN(old_image_at));
        const vdouble v44 = v5 - v43;
        const vdouble v45 = begun ? v44 : (vdouble)(0.0);
        const vdouble v49 = (vdouble)(0.5) * v48;
        const vdouble v50 = v45 + v49;
        DSTORE(v50, i, COLUMN(new_ahead_at));
        const vdouble v51 = v48 * v42;
        const vdouble v53 = v42 * v40;
        const vdouble v60 = v40 * v42;
        const vdouble v61 = v60 * v40;
        const vdouble v82 = v5 * (vdouble)(nothing);
        allx21 = fmax(allx21, v20);
        allx30 += v29;
        allx37 += v36;
        for (uint j = 0; j < MEMORY; ++j)
            allx52[j] += DLOAD(i, DIFFERENCES(j)) * v51;
        for (uint j = 0; j < MEMORY; ++j)
            allx54[j] += DLOAD(i, DIFFERENCES(j)) * v53;
        allx62 += v61;
        allx83 += v82;
    }
    const double x21 = group_largest(largest_lane(allx21), shared);
    const double x30 = group_sum(sum_of_lanes(allx30), shared);
    const double x37 = group_sum(sum_of_lanes(allx37), shared);
    double x52[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x52[j] = group_sum(sum_of_lanes(allx52[j]), shared);
    double x54[MEMORY];
    for (uint j = 0; j < MEMORY; ++j)
        x54[j] = group_sum(sum_of_lanes(allx54[j]), shared);
    const double x62 = group_sum(sum_of_lanes(allx62), shared);
    const double x83 = group_sum(sum_of_lanes(allx83), shared);
    const double x16 = x15 / epsilon;
    const double x22 = x21 / epsilon;
    const double x23 = fmax(x16, x22);
    const double x32 = x31 * x30;
    const double x35 = x32 + x34;
    const double x38 = x35 + x37;
    double factorsx55[MEMORY];
    const bool x55 = solve_normal(
        products, x52, x54, place, count, system, factorsx55);
    const double x63 = sqrt(x62);
    const double x64 = radius * x63;
    vdouble allx67 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        vdouble v56 = (vdouble)(0.0);
        for (uint j = 0; j < MEMORY; ++j)
            v56 += factorsx55[j] * DLOAD(i, AHEAD(j));
        DSTORE(v56, i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v40 = DLOAD(i, COLUMN(residual_at));
        const vdouble v58 = (vdouble)(0.5) * v40;
        const vdouble v59 = v58 - v56;
        const vdouble v42 = DLOAD(i, COLUMN(COLUMN_MASS));
        const vdouble v65 = v59 * v42;
        const vdouble v66 = v65 * v59;
        allx67 += v66;
    }
    const double x67 = group_sum(sum_of_lanes(allx67), shared);
    const double x68 = sqrt(x67);
    const double x69 = fmax(x68, 2.2250738585072014e-308);
    const double x70 = x64 / x69;
    const double x71 = fmin(1.0, x70);
    const bool x72 = x68 > x64;
    const bool x80 = x55 && x72;
    vdouble allx77 = (vdouble)(0.0);
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v3 = DLOAD(i, COLUMN(COLUMN_WEIGHTS));
        const vdouble v28 = DLOAD(i, COLUMN(COLUMN_SCRATCH_1));
        const vdouble v29 = (v3 > (vdouble)(0.0)) ? v28 : (vdouble)(0.0);
        const vdouble v5 = DLOAD(i, COLUMN(image_at));
        const vdouble v40 = DLOAD(i, COLUMN(residual_at));
        const vdouble v58 = (vdouble)(0.5) * v40;
        const vdouble v56 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v59 = v58 - v56;
        const vdouble v73 = (vdouble)(x71) * v59;
        const vdouble v74 = v5 + v73;
        const vdouble v75 = v74 - v5;
        const vdouble v76 = v29 * v75;
        allx77 += v76;
    }
    const double x77 = group_sum(sum_of_lanes(allx77), shared);
    const double x78 = x77 / x30;
    for (uint i = FIRST; i < m; i += STEP) {
        const vdouble v5 = DLOAD(i, COLUMN(image_at));
        const vdouble v40 = DLOAD(i, COLUMN(residual_at));
        const vdouble v58 = (vdouble)(0.5) * v40;
        const vdouble v56 = DLOAD(i, COLUMN(COLUMN_SCRATCH_0));
        const vdouble v59 = v58 - v56;
        const vdouble v73 = (vdouble)(x71) * v59;
        const vdouble v74 = v5 + v73;
        const vdouble v79 = v74 - (vdouble)(x78);
        DSTORE(v79, i, COLUMN(guess_at));
    }
    if (get_local_id(0) == 0) {
        numbers[NUMBER_RESIDUAL_SIZE] = x23;
        numbers[NUMBER_COLUMN_DUAL] = x38;
        numbers[NUMBER_FOUND] = x55;
        numbers[NUMBER_CUT] = x80;
        numbers[NUMBER_COLUMN_FINITE] = x83;
    }
    const bool numbers_found = x55;
#endif
    // Without an extrapolation the image itself is next.
    const uint next_at = numbers_found ? guess_at : image_at;
    prepare_softmin(COLUMN(next_at), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS),
                    tile_costs, m, n / TILE, planes, k, tile_max, next_level, logits, levels);
}
