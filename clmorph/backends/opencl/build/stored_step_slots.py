"""Where vectors and numbers of ``cl_kernels/stored_steps.cl`` stand in its buffers."""

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import half_step_slots

#: Vectors of either side that the host writes: masses and their logarithms; the softmin plus
#: epsilon times the logarithm of the sum over stored pairs, which is the same for all potentials;
#: the softmin of points without a stored pair, which stays; the potential for which the pairs were
#: stored; and the center of the trust region, which the columns do not have.
GIVEN = ("WEIGHTS", "LOG_WEIGHTS", "BASE", "ALONE", "ORIGIN", "CENTER")
_SCRATCH = tuple(f"SCRATCH_{number}" for number in range(half_step_slots.SCRATCH))
#: Vectors of the rows, in their order in the buffer.
ROW_SLOTS = ("F", "SHIFTED", "SOFTMIN", *_SCRATCH)
#: Vectors of the columns. Those with two numbers belong to this iterate and to the one before.
COLUMN_SLOTS = (
    "START", "SHIFTED", "SOFTMIN", "MASS", *_SCRATCH,
    "IMAGE_0", "IMAGE_1", "RESIDUAL_0", "RESIDUAL_1", "GUESS_0", "GUESS_1",
    "AHEAD", "DIFFERENCES",
)  # fmt: skip
#: Numbers that the host reads after each iteration, and those that only the device needs: the
#: logarithm of the plan's mass, and the midranges of the changes of the potentials, which sums over
#: stored pairs take, and which the next ones will take.
NUMBERS = (
    *half_step_slots.NUMBERS, "MOVED", "LOG_MASS",
    "ROW_MIDDLE", "ROW_NEXT", "COLUMN_MIDDLE", "COLUMN_NEXT",
)  # fmt: skip
#: The largest number of sums of one stage, and of numbers that stages leave to later ones.
PARTIALS, SCALARS = 2 * MEMORY + 8, MEMORY + 48
#: The number of stages of the half-step of f and of that of g, for each value of BALANCED.
STAGES = {0: (3, 5), 1: (3, 5), 2: (3, 5), 3: (1, 4)}
#: The limit (log2) at which changes of potentials are clipped: sums at larger changes are useless.
LARGEST_CHANGE = 10_000


def macros() -> dict[str, int | float]:
    """Return the macros that name these places."""
    given: dict[str, int | float] = {f"GIVEN_{name}": place for place, name in enumerate(GIVEN)}
    named = half_step_slots.macros_of(ROW_SLOTS, COLUMN_SLOTS, NUMBERS)
    return named | given | {"PARTIALS": PARTIALS}
