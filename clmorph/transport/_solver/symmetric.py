"""The iteration for problems of measures with themselves, whose potentials f and g are equal.

It is f <- (f + Delta T(f)) / 2 (paper, 2.2). The Gaussian kernel is positive, so near the solution
this contracts by 1/2 at least. The general iteration has no such rate: where the plan is nearly
diagonal, it determines f + g alone, and f - g stays what it happens to be.
"""

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array, BoolArray, IntArray, Progress
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.batch import some
from clmorph.transport._solver.batch_steps import STOPPED, Record
from clmorph.transport._solver.iteration import REPEATED, may_sum_exactly
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.reductions import Segments
from clmorph.transport._solver.state import ROUNDING_MARGIN, State


def is_symmetric(pair: tuple[AnyMeasure, AnyMeasure], rho: tuple[float, float]) -> bool:
    """Return whether a problem is that of a measure with itself, with one reach for both sides."""
    source, target = pair
    return (
        rho[0] == rho[1]
        and source.offsets is None
        and target.offsets is None
        and are_equal(source, target)
    )


def are_equal(source: AnyMeasure, target: AnyMeasure) -> bool:
    """Return whether two measures have the same points and the same weights."""
    return np.array_equal(source.points, target.points) and np.array_equal(
        source.weights, target.weights
    )


@dataclass
class Alone:
    """The solve of one measure with itself, with the attributes of `Iteration`."""

    problem: Problem
    state: State
    status: str
    residuals: Array
    n_iter: int
    rounding: float
    tol: float
    precision: str
    precise: bool


class SymmetricIteration:
    """The solves of one or many measures with themselves.

    Parameters
    ----------
    problem : Problem
        One problem, or B problems made by `problem_of_many`; all are symmetric.
    blur, tol, max_iter, precision, report
        As in `Iteration`. One iteration takes one softmin.

    Attributes
    ----------
    f, t_rows : (N,) arrays
        The result: potentials and their softmins, which `g` and `t_columns` are too.
    residual, roundoffs, status, n_iter, rounding, precise
        As in `BatchIteration`; B is 1 for one problem.
    """

    def __init__(
        self,
        problem: Problem,
        blur: float,
        tol: float,
        max_iter: int,
        precision: str,
        report: Progress,
    ) -> None:
        problem.to_columns = problem.to_rows
        self.problem, self.tol, self.precision = problem, tol, precision
        self._epsilon, self._max_iter, self._report = blur**2, max_iter, report
        count = len(np.atleast_1d(problem.masses[0]))
        self.f, self.t_rows = np.zeros(len(problem.a)), np.zeros(len(problem.a))
        self.residual = np.full(count, np.inf)
        self.roundoffs = np.zeros((2, count))
        self.status = np.full(count, "max_iter", object)
        self.precise = np.full(count, precision != "float32")
        self.rounding = self._rounding(precise=precision != "float32")
        self.n_iter: IntArray = np.zeros(count, np.int64)
        self._record = Record(count)

    @property
    def g(self) -> Array:
        """The other potentials, which are equal."""
        return self.f

    @property
    def t_columns(self) -> Array:
        """Their softmins."""
        return self.t_rows

    def histories(self) -> list[Array]:
        """Return the residuals of every problem after each of its iterations."""
        return self._record.residuals()

    def alone(self) -> "Alone":
        """Return the result of one problem."""
        return Alone(
            self.problem,
            State(self.f, self.f, self.t_rows, self.t_rows, float(self.residual[0])),
            self.status[0], self.histories()[0], int(self.n_iter[0]), float(self.rounding[0]),
            self.tol, self.precision, bool(self.precise[0]),
        )  # fmt: skip

    def run(self) -> None:
        """Iterate in float32 as far as its rounding allows, then with better exponents."""
        numbers = np.arange(len(self.status))
        if self.precision == "auto":
            self._iterate(numbers, np.maximum(self.tol, self._rounding(precise=False)), False)
            self._report(0.5)
        for share in (1.0, *REPEATED):
            stalled = self._iterate(numbers, np.full(len(numbers), share * self.tol), True)
            self._measure(numbers)
            out = self.n_iter[numbers] >= self._max_iter
            self.status[numbers[~out]] = "precision"
            self.status[numbers[self.residual[numbers] <= self.tol]] = "converged"
            status, bounds = self.status[numbers], self.roundoffs.max(axis=0)[numbers]
            exact = may_sum_exactly(self.problem, status, self.precision, self.tol, bounds)
            self.problem.exact_sums |= bool(np.any(exact))
            # The bound of the rounding can have lifted a residual above the tolerance.
            numbers = numbers[(self.residual[numbers] > self.tol) & ~out & (exact | ~stalled)]
            if not len(numbers):
                break
        self._report(1.0)

    def _rounding(self, precise: bool) -> Array:
        """Return the largest residuals that rounding alone can cause, in units of epsilon."""
        rounding = ROUNDING_MARGIN * self.problem.rounding(self._epsilon, precise)
        return np.broadcast_to(rounding, self.status.shape).astype(float)

    def _iterate(self, numbers: IntArray, tol: Array, better: bool) -> BoolArray:
        """Iterate some problems until each is within its tolerance, or no longer falls.

        Parameters
        ----------
        numbers : (k,) array
        tol : (k,) array
        better : bool
            Whether exponents are more than float32, if the precision allows.

        Returns
        -------
        (k,) array of bool
            The problems whose residuals consist of rounding, and no longer fall.
        """
        epsilon, precise = self._epsilon, better and self.precision != "float32"
        ended_by_rounding = np.zeros(len(numbers), bool)
        places = np.flatnonzero(self.n_iter[numbers] < self._max_iter)
        rounding, before = self._rounding(precise)[numbers], np.full(len(numbers), np.inf)
        while len(places):
            here = numbers[places]
            problem, points = self._some(here)
            damping, f = problem.damping(epsilon)[0], self.f[points]
            running = np.ones(len(here), bool)
            while np.count_nonzero(running) > (1 - STOPPED) * len(running):
                softmin = problem.softmin_rows(f, epsilon, precise)
                residual = np.atleast_1d(problem.residual(f, f, softmin, softmin, epsilon))
                self.n_iter[here[running]] += 1
                self._record.add(here[running], residual[running])
                stalled = (residual <= rounding[places]) & (residual > 0.9 * before[places])
                stalled &= running & (residual > tol[places])
                ended_by_rounding[places] |= stalled
                before[places] = residual
                running &= (residual > tol[places]) & ~stalled
                running &= self.n_iter[here] < self._max_iter
                f = np.where(problem.of_rows.spread(running), 0.5 * (f + damping * softmin), f)
            self.f[points] = f
            places = places[running]
        return ended_by_rounding

    def _some(self, numbers: IntArray) -> tuple[Problem, IntArray | slice]:
        """Return some of the problems as one, and the indices of their points."""
        if len(numbers) == len(self.status):
            return self.problem, slice(None)
        assert isinstance(self.problem.of_rows, Segments)
        return some(self.problem, numbers), self.problem.of_rows.points_of(numbers)

    def _measure(self, numbers: IntArray) -> None:
        """Compute the softmins of the potentials that are returned, and their residuals."""
        problem, points = self._some(numbers)
        f = self.f[points]
        softmin = problem.to_rows(f, self._epsilon, bounded=True)
        residual = np.atleast_1d(problem.residual(f, f, softmin, softmin, self._epsilon))
        self.t_rows[points], self.residual[numbers] = softmin, residual
        self.roundoffs[:, numbers] = problem.to_rows.roundoff
        self._record.add(numbers, residual)
