"""Shared parts of the solvers `Iteration` and `Multiscale`: state, precision, progress."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from clmorph._shared.typing import Array
from clmorph.transport._solver.problem import Problem

#: Rounding can be the cause of a residual of at most this many times the bound on the rounding of
#: one softmin.
ROUNDING_MARGIN = 8.0
#: Tolerance on an apparent decrease of the dual, relative to the rounding bound of the residual.
SLACK = 1e-2
#: The share of this fall that the dual's own rounding may be.
DUAL_SHARE = 0.1


class State(NamedTuple):
    """Potentials with their softmins, T(g) and T(f), and their residual in units of epsilon."""

    f: Array
    g: Array
    t_rows: Array
    t_columns: Array
    residual: float


@dataclass
class Outcome:
    """The solve of one problem, with the numbers of `Iteration`."""

    problem: Problem
    tol: float
    precision: str
    state: State
    status: str
    residuals: list[float]
    n_softmin: int
    softmins: int  #: of an iteration
    rounding: float
    precise: bool

    @property
    def n_iter(self) -> int:
        """Iterations so far."""
        return -(-self.n_softmin // self.softmins)


def measured(problem: Problem, f: Array, g: Array, epsilon: float) -> State:
    """Return potentials with their softmins and a residual that includes its rounding."""
    softmins = problem.bounded_softmins(f, g, epsilon)
    return State(f, g, *softmins, problem.residual(f, g, *softmins, epsilon))


def slack_of(problem: Problem, floor: Any, rounding: Any, mass: Any, epsilon: float) -> Any:
    """Return by how much rounding and truncation can make a dual seem to be below `floor`."""
    slack = 1e-12 * abs(floor) + SLACK * rounding * epsilon * mass
    return slack + problem.left_out * epsilon * mass


def dual_rounding(problem: Problem, epsilon: float, precise: bool) -> Any:
    """Return the rounding that each penalty of the dual may have; it is small in `slack_of`."""
    return DUAL_SHARE * SLACK * ROUNDING_MARGIN * problem.rounding(epsilon, precise)


def share_done(first: float, residual: float, tol: float) -> float:
    """Return the share of the work that is done, if residuals fall geometrically."""
    if residual <= tol or first <= tol:
        return 1.0
    if not math.isfinite(residual):
        return 0.0
    return min(1.0, max(0.0, math.log(first / residual) / math.log(first / tol)))


def needs_more(problem: Problem, precision: str, epsilon: float, tol: float) -> Any:
    """Return whether a tolerance needs more than float32, and `precision` allows it."""
    if precision != "auto":
        return precision == "float64"
    operations = problem.operations
    if operations.exponent_roundoff == operations.precise_roundoff:
        return True
    return problem.rounding(epsilon, precise=False) > 0.25 * tol
