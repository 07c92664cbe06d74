"""The parts of `cl_kernels/half_steps.cl` that are no formulas."""

HEAD = """\
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
"""
ARGUMENTS = """\
    const uint n, const uint m, const uint shares, const uint planes, const uint control,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double radius,
    const __global float* restrict maxima,       // (shares, {size})
    const __global float* restrict sums,         // (shares, {size})
    const __global double* restrict row_level,   // ({size} / TILE,): of this softmin
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    const __global double* restrict tile_costs,  // ({other} / TILE, {size} / TILE)
    __global double* restrict tile_max,          // (largest number of tiles,)
    __global double* restrict next_level,        // ({other} / TILE,): of the next softmin
    __global float* restrict logits,             // (2, {size}): of the next softmin
    __global float* restrict levels,             // ({other} / TILE, planes, {size} / TILE)
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see half_step_slots.py
"""
#: For each kernel: its size and the other one, its comment, and what stands before and after.
KERNELS = {
    "row_step": (
        "n", "m",
        """\
// After T(g): f, the shift of g, and the dual. Then the softmin of the columns, T(f), is prepared.
""",
        """\
    const double nothing = 0.0;
    const uint g_at = G_AT;
""",
        """\
    prepare_softmin(ROW(ROW_F), ROW(ROW_OFFSETS), ROW(ROW_LOG2_WEIGHTS), tile_costs, n, m / TILE,
                    planes, k, tile_max, next_level, logits, levels);
""",
    ),
    "column_step": (
        "m", "n",
        """\
// After T(f): the residual, the image of g, the shift of f, the dual, and the extrapolated g. Then
// the softmin of the rows, T(g), is prepared.
""",
        """\
    const double nothing = 0.0;
    const bool begun = BEGUN;
    const uint place = PLACE, count = COUNT, g_at = G_AT;
    const uint image_at = COLUMN_IMAGE_0 + PARITY, old_image_at = COLUMN_IMAGE_1 - PARITY;
    const uint residual_at = COLUMN_RESIDUAL_0 + PARITY;
    const uint old_residual_at = COLUMN_RESIDUAL_1 - PARITY;
    const uint guess_at = COLUMN_GUESS_0 + PARITY;
    const uint new_ahead_at = COLUMN_AHEAD + place;
    const uint new_difference_at = COLUMN_DIFFERENCES + place;
""",
        """\
    // Without an extrapolation the image itself is next.
    const uint next_at = numbers_found ? guess_at : image_at;
    prepare_softmin(COLUMN(next_at), COLUMN(COLUMN_OFFSETS), COLUMN(COLUMN_LOG2_WEIGHTS),
                    tile_costs, m, n / TILE, planes, k, tile_max, next_level, logits, levels);
""",
    ),
}  # fmt: skip
