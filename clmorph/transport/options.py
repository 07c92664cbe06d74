"""Options of the solver and of the plan (paper, 2.1 and 3.1)."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from clmorph._shared.option_kinds import choice, flag, integer, number
from clmorph._shared.options import Options, option

#: Length scale of creation and destruction of mass: one for both measures, or one for each; None is
#: balanced.
Reach = float | tuple[float | None, float | None] | None
#: The square of a reach; infinity is balanced.
Rho = float | tuple[float, float] | None
#: Algorithm of `clmorph.sinkhorn`: accelerated and certified, or GeomLoss's schedule.
Method = Literal["certified", "geomloss"]
#: Floating-point precision of the exponents while the solver iterates.
Precision = Literal["auto", "float32", "float64"]
#: Reference of the share `relative` of `clmorph.transport_plan`: the largest pair of the row or
#: column, or the largest pair of the plan.
RelativeTo = Literal["rows", "plan"]

#: Largest number of random draws from a row of a plan.
MAX_DRAWS = 4096

#: Lengths, in the unit of the points (for images: the longer side), and their squares.
LENGTH = number(1e-6, 1e6)
_SQUARE = replace(number(1e-12, 1e12), check=lambda name, value: value)
#: The value is checked by `clmorph.transport.regularization`, which handles reach and rho.
_REACH = replace(
    LENGTH, check=lambda name, value: value, pair=True, expected="a number",
    metavar="number|balanced|source,target",
)  # fmt: skip
_RHO = replace(_REACH, schema=_SQUARE.schema, words=(("balanced", math.inf),))


@dataclass(frozen=True, init=False)
class SolverOptions(Options):
    """Options of `clmorph.sinkhorn` that define the problem and when the solver stops."""

    blur: float | None = option(
        0.03, LENGTH,
        "Length scale of the entropic blur; a smaller one is sharper and slower.",
        "Transport", unit="image sides",
    )  # fmt: skip
    reach: Reach = option(
        None, _REACH,
        "Length scale beyond which mass fades rather than moves; balanced: nothing fades. Two "
        "values belong to source and target.",
        "Transport", unit="image sides", word="balanced", off=(),
    )  # fmt: skip
    epsilon: float | None = option(
        None, _SQUARE,
        "The square of blur, in place of blur.", "Transport", unit="cost units",
    )  # fmt: skip
    rho: Rho = option(
        None, _RHO, "The square of reach, in place of reach.", "Transport", unit="cost units"
    )
    tol: float = option(
        1e-3, number(0.0, 1e3, open_low=True), "Residual at which the solver stops.",
        "Transport", unit="epsilon", word="",
    )  # fmt: skip
    max_iter: int = option(
        2000, integer(1, 10**9),
        "Number of iterations after which the solver stops in any case.", "Transport", word="",
    )  # fmt: skip


@dataclass(frozen=True, init=False)
class AlgorithmOptions(Options):
    """Further options of `clmorph.sinkhorn`, which select the algorithm but not the problem."""

    method: Method = option("certified", choice(Method), "Algorithm.", "Transport", word="")
    scaling: float = option(
        0.9, number(0.01, 0.999), "Factor between the blurs of GeomLoss's schedule.", "Transport",
        word="",
    )  # fmt: skip
    precision: Precision = option(
        "auto", choice(Precision), "Precision of exponents.", "Transport", word=""
    )


@dataclass(frozen=True, init=False)
class PlanOptions(Options):
    """Options of the plan, which select the pairs that become particles."""

    log_threshold: float | None = option(
        None, number(-1e4, 1e4),
        "Drop the pairs of the plan whose log pi is below this threshold (the paper's tau is -13); "
        "relative: drop pairs that are small compared with the largest of their row or column.",
        "Transport", unit="nats", word="relative",
    )  # fmt: skip
    barycentric: bool = option(
        False, flag(), "Draw one particle a pixel, which travels to its mean destination.",
        "Transport", word="",
    )  # fmt: skip
    sample: int | None = option(
        None, integer(1, MAX_DRAWS),
        "Draw this number of particles a pixel from the plan at random, at least two: one from "
        "each column, and the others from each row.",
        "Transport",
    )  # fmt: skip
    seed: int = option(0, integer(0, 2**63), "Seed of the random draws.", "Transport", word="")


@dataclass(frozen=True, init=False)
class PruningOptions(Options):
    """Further options of `clmorph.transport_plan`, which select and limit the kept pairs."""

    relative: float = option(
        1e-4, number(0.0, 1.0, open_low=True),
        "Share of the largest pair of its row or column that a pair needs to be kept.",
        "Transport", word="",
    )  # fmt: skip
    relative_to: RelativeTo = option(
        "rows", choice(RelativeTo),
        "The pair to which `relative` refers: the largest of the row or column, or of the plan.",
        "Transport", word="",
    )  # fmt: skip
    max_bytes: float = option(
        4 * 2.0**30, number(1.0, 1e18), "The most memory that the pairs may take.", "Transport",
        unit="bytes", word="",
    )  # fmt: skip
