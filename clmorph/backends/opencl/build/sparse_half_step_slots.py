"""Where vectors and numbers of ``cl_kernels/sparse_half_steps.cl`` stand in its buffers."""

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import half_step_slots

#: Vectors of either side that the host writes: masses and their logarithms; the softmin plus
#: epsilon times the logarithm of the sum over stored pairs, which is the same for all potentials;
#: the softmin of points without a stored pair, which stays; the potential for which the pairs were
#: stored; and the center of the trust region, which the columns do not have.
GIVEN = ("WEIGHTS", "LOG_WEIGHTS", "BASE", "ALONE", "ORIGIN", "CENTER")
#: Vectors that kernels write, of the rows and of the columns.
ROW_SLOTS = half_step_slots.ROW_SLOTS[len(half_step_slots.GIVEN) :]
COLUMN_SLOTS = half_step_slots.COLUMN_SLOTS[len(half_step_slots.GIVEN) :]
#: Numbers that the host reads after each iteration, and those that only the device needs: the
#: logarithm of the plan's mass; the midranges of the changes of the potentials, which sums over
#: stored pairs take, and which the next ones will take; and the plan's mass after the half-step of
#: g, the sum of the columns' marginal, and the residual's norm.
NUMBERS = (
    *half_step_slots.NUMBERS, "MOVED", "LOG_MASS",
    "ROW_MIDDLE", "ROW_NEXT", "COLUMN_MIDDLE", "COLUMN_NEXT",
    "PLAN_MASS", "MARGINALS", "RESIDUAL_NORM",
)  # fmt: skip
#: The largest number of sums of one stage.
PARTIALS = 2 * MEMORY + 4
#: The limit (log2) at which changes of potentials are clipped: sums at larger changes are useless.
LARGEST_CHANGE = 10_000


def macros() -> dict[str, int | float]:
    """Return the macros that name these places."""
    given: dict[str, int | float] = {f"GIVEN_{name}": place for place, name in enumerate(GIVEN)}
    named = half_step_slots.macros_of(ROW_SLOTS, COLUMN_SLOTS, NUMBERS)
    return named | given | {"PARTIALS": PARTIALS, "LARGEST_CHANGE": LARGEST_CHANGE}
