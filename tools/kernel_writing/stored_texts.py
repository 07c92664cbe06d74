"""The parts of `cl_kernels/stored_steps.cl` that are no formulas."""

import re

from kernel_writing.staged import StagedWriter
from kernel_writing.writer import SIZES

HEAD = """\
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
"""
ARGUMENTS = """\
    const uint n, const uint m, const uint control, const uint stage, const uint groups,
    const double k, const double epsilon, const double inverse_rho_source,
    const double inverse_rho_target, const double source_mass, const double target_mass,
    const double radius,
    const __global float* restrict maxima,       // ({size},): of this softmin
    const __global float* restrict sums,         // ({size},)
    const __global double* restrict given_rows,     // (slots, n)
    const __global double* restrict given_columns,  // (slots, m)
    __global double* restrict rows,              // (slots, n)
    __global double* restrict columns,           // (slots, m)
    __global float* restrict changes,            // ({size},): of the potential of the next softmin
    __global double* restrict partials,          // (PARTIALS, groups)
    __global double* restrict scalars,           // (SCALARS,): numbers of the stages before
    __global double* restrict products,          // (MEMORY, MEMORY)
    __global double* restrict numbers)           // see stored_step_slots.py
"""
_COMMENTS = {
    "row": "After T(g): f, the shift of g, the dual, and the changes of f for the next softmin.",
    "column": "After T(f): the residual, the image of g, the shift of f, the dual, and the next g.",
}
_SLOTS = {
    "image_at": "COLUMN_IMAGE_0 + PARITY", "old_image_at": "COLUMN_IMAGE_1 - PARITY",
    "residual_at": "COLUMN_RESIDUAL_0 + PARITY", "old_residual_at": "COLUMN_RESIDUAL_1 - PARITY",
    "guess_at": "COLUMN_GUESS_0 + PARITY", "new_ahead_at": "COLUMN_AHEAD + PLACE",
    "new_difference_at": "COLUMN_DIFFERENCES + PLACE", "g_at": "G_AT", "place": "PLACE",
    "count": "COUNT",
}  # fmt: skip
#: What the names in formulas stand for: of both half-steps, and of one.
_NUMBERS = {
    "row": {"middle": "COLUMN_MIDDLE", "next_middle": "ROW_NEXT"},
    "column": {"middle": "ROW_MIDDLE", "next_middle": "COLUMN_NEXT", "log_mass": "LOG_MASS"},
}


def begin(name: str, kind: str) -> str:
    """Return the text before the stages of a kernel.

    Parameters
    ----------
    name : {"row", "column"}
    kind : {"loops", "joins"}
    """
    text = "\n" + f"// {_COMMENTS[name]}\n" * (kind == "loops")
    text += "__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))\n"
    text += f"void {name}_{kind}(\n{ARGUMENTS.format(size=SIZES[name])}{{\n"
    text += "    __local double shared[GROUP];\n    double found[PARTIALS];\n"
    if kind == "joins" and name == "column":
        text += "    __local double system[MEMORY * SYSTEM_ROW];\n"
    if kind == "loops":
        text += "    uint n_found = 0;\n    ulong largest = 0;\n"
    return text


def end(kind: str) -> str:
    """Return the text after the stages of a kernel; see `begin`."""
    if kind == "joins":
        return "}\n"
    return """\
    for (uint place = 0; place < n_found; ++place)
        leave_partial(group_reduced(found[place], largest >> place & 1ul, shared), place, partials);
}
"""


def joins(writer: StagedWriter) -> str:
    """Return the text before the stages that joins what the groups have left of each sum."""
    text = ""
    counts, largest = zip(*writer.found, strict=True)
    for kind, name, values in (("uint", "n_found", counts), ("ulong", "largest", largest)):
        choice = " : ".join(f"stage == {stage} ? {value}" for stage, value in enumerate(values))
        text += f"    const {kind} {name} = {choice} : 0;\n"
    text += """\
    for (uint place = 0; place < n_found; ++place) {
        const bool is_largest = largest >> place & 1ul;
        const double own = joined(partials, place, groups, is_largest);
        found[place] = group_reduced(own, is_largest, shared);
    }
"""
    if writer.solved_at is not None:
        stage, row, right = writer.solved_at
        text += f"""\
    double factors[MEMORY];
    const bool determined = solve_normal(products, found + {row}, found + {right}, PLACE,
                                         stage == {stage} ? COUNT : 0, system, factors);
"""
    return text


def stage_text(name: str, stage: int, lines: list[str]) -> str:
    """Return the text of a stage of a kernel, with the variables that its lines need.

    Parameters
    ----------
    name : {"row", "column"}
    stage : int
    lines : list of str
    """
    variables = {
        **{each: f"const double {each} = numbers[NUMBER_{of}]" for each, of in
           _NUMBERS[name].items()},
        "nothing": "const double nothing = 0.0", "begun": "const bool begun = BEGUN",
        **{each: f"const uint {each} = {of}" for each, of in _SLOTS.items()},
    }  # fmt: skip
    body = "\n".join(lines)
    needed = [f"    {text};" for each, text in variables.items() if re.search(rf"\b{each}\b", body)]
    text = f"    {'else ' * bool(stage)}if (stage == {stage}) {{\n"
    for line in needed + lines:
        text += f"{'' if line.startswith('#') else '    '}{line}\n"
    return text + "    }\n"
