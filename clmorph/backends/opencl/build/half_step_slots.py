"""Where vectors and numbers of ``cl_kernels/half_steps.cl`` stand in its buffers."""

from clmorph.backends.interface import MEMORY, MIXING, RIDGE

#: What the host writes for each cloud, before the others.
GIVEN = ("WEIGHTS", "LOG_WEIGHTS", "OWN_COSTS", "OFFSETS", "LOG2_WEIGHTS")
#: Vectors of the rows, in their order in the buffer.
ROW_SLOTS = (*GIVEN, "F", "SHIFTED", "SOFTMIN")
#: Vectors of the columns: MARGINAL is this iterate's, MASS that of the first one stored. Those with
#: two numbers belong to this iterate and to the one before.
COLUMN_SLOTS = (
    *GIVEN, "START", "SHIFTED", "SOFTMIN", "MASS", "MARGINAL", "STEP",
    "IMAGE_0", "IMAGE_1", "RESIDUAL_0", "RESIDUAL_1", "GUESS_0", "GUESS_1",
    "AHEAD", "DIFFERENCES",
)  # fmt: skip
#: Numbers that the host reads after each iteration.
NUMBERS = (
    "MASS", "ROW_DUAL", "ROW_FINITE", "RESIDUAL_SIZE", "COLUMN_DUAL", "COLUMN_FINITE", "FOUND",
    "CUT",
)  # fmt: skip
#: What the host says of each problem before an iteration, uint32; the radius has two.
PROBLEM = (
    "NUMBER", "FIRST_ROW", "N", "FIRST_COLUMN", "M", "FIRST_PAIR",
    "CONTROL", "RADIUS_LOW", "RADIUS_HIGH",
)  # fmt: skip


def macros() -> dict[str, int | float]:
    """Return the macros that name these places."""
    named = macros_of(ROW_SLOTS, COLUMN_SLOTS, NUMBERS)
    fields = {f"PROBLEM_{name}": place for place, name in enumerate(PROBLEM)}
    return named | fields | {"PROBLEM_COUNT": len(PROBLEM), "NUMBER_COUNT": len(NUMBERS)}


def macros_of(
    rows: tuple[str, ...], columns: tuple[str, ...], numbers: tuple[str, ...]
) -> dict[str, int | float]:
    """Return the macros that name places of vectors and numbers, and those of the acceleration."""
    places = {"ROW": rows, "COLUMN": columns, "NUMBER": numbers}
    named: dict[str, int | float] = {
        f"{kind}_{name}": place
        for kind, names in places.items()
        for place, name in enumerate(names)
    }
    # The differences follow those of the images.
    named["COLUMN_DIFFERENCES"] = columns.index("AHEAD") + MEMORY
    return named | {
        "MEMORY": MEMORY, "RIDGE_PPT": round(1e12 * RIDGE),
        "MIXING_PERCENT": round(100 * MIXING),
    }  # fmt: skip
