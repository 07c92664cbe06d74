"""The iteration f <- (f + Delta T(f)) / 2 of measures with themselves, where f = g (paper, 2.2).

The Gaussian kernel is positive, so near the solution this contracts by 1/2 at least. Where the plan
is nearly diagonal, the general iteration determines f + g alone.
"""

from typing import Any

import numpy as np

from clmorph._shared.typing import Array, IntArray, Progress
from clmorph.measures.points import Pair, are_equal
from clmorph.transport._solver.batch import some
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.steps import Steps
from clmorph.transport.regularization import Goal


def is_symmetric(pair: Pair, rho: tuple[float, float]) -> bool:
    """Return whether a problem is that of a measure with itself, with one reach for both sides."""
    source, target = pair
    return (
        rho[0] == rho[1]
        and source.offsets is None
        and target.offsets is None
        and are_equal(source, target)
    )


class SymmetricSteps(Steps):
    """Steps of one problem or of many, all symmetric; see `Steps`. Nothing is extrapolated."""

    ahead = 0

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def begin(self, g: Array, epsilon: float, precise: bool) -> None:
        self._f, self._epsilon, self._precise = g, epsilon, precise

    def update_rows(self) -> tuple[Any, Any]:
        self._softmin = self._problem.softmin(0, self._f, self._epsilon, self._precise)
        return self._problem.masses[0], 0.0

    def update_columns(self) -> tuple[Any, Any, Any]:
        f, softmin = self._f, self._softmin
        return self._problem.residual(f, f, softmin, softmin, self._epsilon), 0.0, 0.0

    def go_on(self, extrapolate: Any) -> Any:
        damping = self._problem.damping(self._epsilon)[0]
        self._f = 0.5 * (self._f + damping * self._softmin)
        return extrapolate & False

    def potentials(self) -> tuple[Array, Array, Array]:
        return self._f, self._f, self._softmin

    def keep(self, problems: IntArray) -> Problem:
        points = self._problem.of_rows.points_of(problems)
        self._problem, self._f = some(self._problem, problems), self._f[points]
        return self._problem


def solve_symmetric(problem: Problem, goal: Goal, report: Progress) -> Iteration:
    """Return the solves of one or many measures with themselves."""
    problem.to_columns = problem.to_rows
    # Each iteration halves the residual unless it consists of rounding.
    iteration = Iteration(problem, goal, report, patience=1, steps=SymmetricSteps, softmins=1)
    return iteration.run(np.zeros(len(problem.a)))
