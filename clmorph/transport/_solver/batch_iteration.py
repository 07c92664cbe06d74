"""The iteration behind `clmorph.sinkhorn_batch`: that of `_solver.iteration`, of many problems."""

from collections.abc import Callable

import numpy as np

from clmorph._shared.progress import Share
from clmorph._shared.typing import Array, IntArray
from clmorph.transport._solver.batch import some
from clmorph.transport._solver.batch_steps import Reached, Record, Steps, segments
from clmorph.transport._solver.iteration import (
    ANNEALING,
    ANNEALING_SHARE,
    LEAVING_MARGIN,
    LEVEL_TOLERANCE,
    REPEATED,
    annealing,
    may_sum_exactly,
    top_blur,
)
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.reductions import Segments
from clmorph.transport._solver.state import needs_more


class BatchIteration:
    """The solves of many problems by Sinkhorn's iteration, annealed and extrapolated.

    Parameters
    ----------
    problem : Problem
        Made by `problem_of_many`; there are B problems, of N and M points in all.
    blur, tol, max_iter, precision, report, exact
        As in `Iteration`.

    Attributes
    ----------
    f, g, t_rows, t_columns : (N,), (M,), (N,) and (M,) arrays
        The result: potentials and their softmins.
    residual : (B,) array
    roundoffs : (2, B) array
        The bounds of the rounding of T(g) and T(f), in nats.
    status : (B,) array of {"converged", "max_iter", "precision"}
    n_iter : (B,) array
        Number of iterations; softmins that only measure or certify do not count.
    rounding : (B,) array
        Largest residual that rounding alone can cause, in units of epsilon.
    precise : (B,) array of bool
        Whether float32 exponents were too coarse for `tol`.
    """

    def __init__(
        self,
        problem: Problem,
        blur: float,
        tol: float,
        max_iter: int,
        precision: str,
        report: Callable[[float], None],
        exact: bool = False,
    ) -> None:
        self.problem, problem.exact_sums = problem, exact
        self._level_tol = tol if exact else LEVEL_TOLERANCE
        self.tol, self.precision = tol, precision
        self._blur, self._max_iter, self._report = blur, max_iter, report
        count = problem.of_rows.shape[0]
        self.f, self.t_rows = np.zeros(len(problem.a)), np.zeros(len(problem.a))
        self.g, self.t_columns = np.zeros(len(problem.b)), np.zeros(len(problem.b))
        self.residual, self.rounding = np.full(count, np.inf), np.zeros(count)
        self.roundoffs = np.zeros((2, count))
        self.status = np.full(count, "max_iter", object)
        self.precise = np.zeros(count, bool)
        self._record = Record(count)
        self._rows, self._columns = segments(problem)
        self._done = 0.0

    @property
    def n_iter(self) -> IntArray:
        """Iterations of each problem so far."""
        return self._record.n_iter

    def histories(self) -> list[Array]:
        """Return the residuals of every problem after each of its iterations."""
        return self._record.residuals()

    def run(self) -> None:
        """Iterate from the largest blur of each problem's annealing."""
        problem, blur = self.problem, self._blur
        largest = float(problem.largest_cost.max())
        levels = annealing(problem, blur, largest, self._max_iter)
        tops = top_blur(problem.largest_cost)
        g, before = np.zeros(len(problem.b)), np.zeros(len(problem.b))
        limit = int(ANNEALING_SHARE * self._max_iter)
        for number, level in enumerate(levels):
            epsilon, following = level**2, [*levels, blur][number + 1] ** 2
            begun = tops > level
            # Potentials are close to linear in epsilon, so the line through the last two levels is
            # continued to the next one.
            rate = (epsilon - following) / ((level / ANNEALING) ** 2 - epsilon)
            factor = np.where(tops > level / ANNEALING, rate, 0.0)
            if number == 0:
                factor = np.zeros_like(factor)
            more = begun & needs_more(problem, self.precision, epsilon, self._level_tol)
            for precise, which in ((False, begun & ~more), (True, more)):
                numbers = np.flatnonzero(which)
                if not len(numbers):
                    continue
                points = self._columns.points_of(numbers)
                tol = np.full(len(numbers), self._level_tol)
                reached = self._iterate(numbers, g[points], epsilon, tol, limit, precise).g
                step = reached - before[points]
                g[points] = reached + self._columns.spread(factor)[points] * step
                before[points] = reached
            self._share((number + 1) / (len(levels) + 2))
        self._last_level(g)
        self._share(1.0)

    def _share(self, share: float) -> None:
        self._done = max(self._done, share)
        stopped = int(np.count_nonzero(self.residual <= self.tol))
        self._report(Share(self._done, f"{stopped} of {len(self.status)} problems"))

    def _last_level(self, g: Array) -> None:
        """Iterate in float32 as far as its rounding allows, then with better exponents."""
        problem, epsilon, limit = self.problem, self._blur**2, self._max_iter
        everyone, operations = np.arange(len(self.status)), problem.operations
        needed = needs_more(problem, self.precision, epsilon, self.tol)
        self.precise = np.broadcast_to(needed, self.status.shape).copy()
        left: list[tuple[bool, IntArray, Array]] = []
        if self.precision == "auto" and operations.exponent_roundoff > operations.precise_roundoff:
            coarse_tol = np.full(len(everyone), self.tol)
            numbers = np.flatnonzero(self.precise)
            if len(numbers):
                points = self._columns.points_of(numbers)
                measured = self._measured_rounding(numbers, g[points], epsilon)
                coarse_tol[numbers] = np.maximum(self.tol, LEAVING_MARGIN * measured)
            reached = self._iterate(everyone, g, epsilon, coarse_tol, limit, False, leave=True)
            out = (self.status == "max_iter") & (reached.residual > coarse_tol)
            # Float32 was enough if precise softmins confirm the residual.
            checked = np.flatnonzero(out | ~self.precise)
            self._measure(self._part(reached, checked), epsilon)
            ended = np.zeros(len(everyone), bool)
            ended[checked] = out[checked] | (self.status[checked] == "converged")
            rest = self._part(reached, np.flatnonzero(~ended))
            left.append((True, rest.problems, rest.g))
        else:
            for precise in (False, True):
                numbers = np.flatnonzero(self.precise == precise)
                left.append((precise, numbers, g[self._columns.points_of(numbers)]))
        exact = problem.exact_sums
        for precise, numbers, start in left:
            problem.exact_sums = exact
            for share in (1.0, *REPEATED):
                if not len(numbers):
                    break
                tol = np.full(len(numbers), share * self.tol)
                reached = self._iterate(numbers, start, epsilon, tol, limit, precise)
                converged = self.status[numbers] == "converged"
                self._measure(reached, epsilon)
                # The bound of the rounding can have lifted a residual above the tolerance.
                again = converged & (self.status[numbers] != "converged")
                bounds = self.roundoffs.max(axis=0)[numbers]
                status = self.status[numbers]
                further = may_sum_exactly(problem, status, self.precision, self.tol, bounds)
                problem.exact_sums |= bool(np.any(further))
                again |= further
                again &= self.n_iter[numbers] < limit
                rest = self._part(reached, np.flatnonzero(again))
                numbers, start = rest.problems, rest.g

    def _part(self, reached: Reached, places: IntArray) -> Reached:
        """Return a part of the problems, by their places among those reached."""
        rows = Segments(self._rows.counts[reached.problems]).points_of(places)
        columns = Segments(self._columns.counts[reached.problems]).points_of(places)
        return Reached(
            reached.problems[places], reached.f[rows], reached.g[columns],
            reached.residual[places], reached.status[places],
        )  # fmt: skip

    def _measure(self, reached: Reached, epsilon: float) -> None:
        """Compute the softmins of the potentials that are returned, and their residuals."""
        numbers, f, g, _, _ = reached
        if not len(numbers):
            return
        problem = some(self.problem, numbers)
        t_rows, t_columns = problem.bounded_softmins(f, g, epsilon)
        residual = problem.residual(f, g, t_rows, t_columns, epsilon)
        rows, columns = self._rows.points_of(numbers), self._columns.points_of(numbers)
        self.f[rows], self.t_rows[rows] = f, t_rows
        self.g[columns], self.t_columns[columns] = g, t_columns
        self.residual[numbers] = residual
        self.roundoffs[:, numbers] = problem.to_rows.roundoff, problem.to_columns.roundoff
        self._record.add(numbers, residual)
        within = residual <= self.tol
        missed = ~within & (self.status[numbers] == "converged")
        self.status[numbers[within]] = "converged"
        # In exact arithmetic the last half-step can only lower the residual.
        self.status[numbers[missed]] = "precision"

    def _measured_rounding(self, numbers: IntArray, g: Array, epsilon: float) -> Array:
        """Return by how much T(g) changes with precise exponents, in units of epsilon."""
        problem = some(self.problem, numbers)
        coarse = problem.softmin_rows(g, epsilon, precise=False)
        fine = problem.softmin_rows(g, epsilon, precise=True)
        change = np.where(problem.a > 0, np.abs(coarse - fine), 0.0)
        return np.asarray(problem.of_rows.largest(change)) / epsilon

    def _iterate(
        self,
        numbers: IntArray,
        g: Array,
        epsilon: float,
        tol: Array,
        limit: int,
        precise: bool,
        leave: bool = False,
    ) -> Reached:
        """Iterate some problems at one epsilon; see `Steps`."""
        steps = Steps(
            self.problem, numbers, epsilon, tol, limit, self._max_iter, precise, leave,
            self._record,
        )  # fmt: skip
        reached = steps.run(g)
        self.rounding[numbers], self.status[numbers] = steps.rounding, reached.status
        return reached
