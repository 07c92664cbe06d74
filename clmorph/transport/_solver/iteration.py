"""The accelerated iteration behind `clmorph.sinkhorn` and `clmorph.sinkhorn_batch`.

The solver maximizes the dual at falling blurs (annealing). At each it extrapolates Sinkhorn's
half-steps (`_solver.anderson`), and takes an extrapolation back if the dual is then below that of
the plain half-step by more than rounding explains: the limit is that of the plain iteration.
Numbers of one problem are arrays of many (`_solver.reductions`), which step together.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph._shared.progress import Share
from clmorph._shared.typing import Array, IntArray
from clmorph.transport._solver.batch import one_of, some
from clmorph.transport._solver.problem import ROUNDING_MARGIN, Problem, State
from clmorph.transport._solver.steps import Steps, new_steps
from clmorph.transport.regularization import Goal

#: Factor between the blurs of the annealing.
ANNEALING = 0.5
#: There is no annealing where damping alone contracts the iteration by at least this factor.
EASY = 0.5
#: Residual, in units of its own epsilon, at which the iteration leaves a level before the last.
LEVEL_TOLERANCE = 0.2
#: Largest share of the allowed iterations that the annealing takes.
ANNEALING_SHARE = 0.5
#: With fewer allowed iterations than this there is neither annealing nor extrapolation, because
#: they would cost more than they save.
SHORT = 20
#: The usual patience: iterations without a new best residual after which the iteration ends, as
#: rounding is then the reason. Residuals of balanced problems were seen to fall by less than a
#: tenth in twelve iterations and to go on falling.
STALLED = 25
#: Shares of the tolerance that are tried one after the other where the final residual, the bound
#: of its rounding included, is above the tolerance.
REPEATED = (0.8, 0.4)
#: Exact sums take over where the bound of their rounding is this share of the tolerance at most.
EXACT_SHARE = 0.5
#: A dual may fall by this many times the largest fall that was seen after a plain half-step.
NOISE_MARGIN = 2.0
#: Problems that have stopped are taken out of the vectors once they are this share of those there.
STOPPED = 1 / 16
#: The iteration changes from float32 to better exponents at this many times the measured rounding
#: of float32.
LEAVING_MARGIN = 4.0


@dataclass
class Outcome:
    """The solve of one problem, with the numbers of `Iteration`."""

    problem: Problem
    goal: Goal
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


@dataclass(eq=False)
class Iteration:
    """The solve of one problem, or of many, by Sinkhorn's iteration, annealed and extrapolated.

    Its iterations have `softmins` each, of which `begun` were before. After `patience` of them
    without a new best residual it ends, if rounding explains that. `certify` makes the last
    softmins bounded ones. With `exact` all sums are exact, and all levels are solved to the
    tolerance: between groups of points far apart, mass finds its way at large blurs alone.

    The result is f, t_rows (N,) and g, t_columns (M,), and for each of B problems the residual, the
    bounds `roundoffs` of T(g) and T(f) in nats, (2, B), the status, the largest residual that
    rounding alone can cause, and whether float32 exponents were too coarse (`precise`).
    """

    problem: Problem
    goal: Goal
    report: Callable[[float], None]
    certify: bool = True
    patience: int = STALLED
    exact: bool = False
    steps: Callable[[Problem], Steps] = new_steps
    softmins: int = 2
    begun: int = 0

    def __post_init__(self) -> None:
        problem = self.problem
        problem.exact_sums = self.exact
        self._level_tol = self.goal.tol if self.exact else LEVEL_TOLERANCE
        self._done, self._level_share, self._reported = 0.0, 1.0, 0.0
        self._everyone = np.arange(np.size(problem.masses[0]))
        count = len(self._everyone)
        self.f, self.t_rows = np.zeros(len(problem.a)), np.zeros(len(problem.a))
        self.g, self.t_columns = np.zeros(len(problem.b)), np.zeros(len(problem.b))
        self.residual, self.rounding = np.full(count, np.inf), np.zeros(count)
        self.roundoffs = np.zeros((2, count))
        self.status = np.full(count, "max_iter", object)
        self.precise = np.zeros(count, bool)
        self.n_softmin = np.full(count, self.begun)
        self._records: list[tuple[IntArray, Any, Any]] = []

    @property
    def n_iter(self) -> IntArray:
        """Iterations of each problem so far."""
        return np.asarray(-(-self.n_softmin // self.softmins))

    @functools.cached_property
    def histories(self) -> list[Array]:
        """The residuals of each problem after each of its iterations, once all have ended."""
        if not self.problem.of_rows.shape:
            return [np.array([residual for _, live, residual in self._records if live])]
        numbers, live, values = (np.hstack(each) for each in zip(*self._records, strict=True))
        numbers, values = numbers[live], values[live]
        order = np.argsort(numbers, kind="stable")
        ends = np.cumsum(np.bincount(numbers, minlength=len(self.n_softmin)))
        return np.split(values[order], ends[:-1])

    def outcome(self, number: int = 0) -> Outcome:
        """Return the result of a problem."""
        rows, columns = self.problem.reductions
        f, t_rows = (rows.part(each, number).copy() for each in (self.f, self.t_rows))
        g, t_columns = (columns.part(each, number).copy() for each in (self.g, self.t_columns))
        return Outcome(
            one_of(self.problem, number, self.roundoffs[:, number]), self.goal,
            State(f, g, t_rows, t_columns, float(self.residual[number])), self.status[number],
            self.histories[number].tolist(), int(self.n_softmin[number]), self.softmins,
            float(self.rounding[number]), bool(self.precise[number]),
        )  # fmt: skip

    def run(self, start: Array | None = None) -> "Iteration":
        """Iterate from potentials g, or from the largest blur of each problem's annealing."""
        problem, columns, goal = self.problem, self.problem.of_columns, self.goal
        tops = np.atleast_1d(problem.top_blur)
        before = np.zeros_like(self.g)
        levels = []
        if start is not None:
            self.g[:] = start
        else:
            levels = annealing(problem, goal, float(tops.max()))
        self._level_share = 1.0 / (len(levels) + 3)
        limit = int(ANNEALING_SHARE * goal.max_iter)
        for number, level in enumerate(levels):
            epsilon, following = level**2, [*levels, goal.blur][number + 1] ** 2
            # Potentials are close to linear in epsilon, so the line through the last two levels is
            # continued to the next one.
            beyond = (tops > level / ANNEALING) & (number > 0)
            more = problem.needs_more(goal.precision, epsilon, self._level_tol)
            for precise in (False, True):
                numbers = np.flatnonzero((tops > level) & (more == precise))
                if not len(numbers):
                    continue
                self._iterate(numbers, epsilon, self._level_tol, limit, precise)
                points = columns.points_of(numbers)
                step = (self.g[points] - before[points]) * (epsilon - following)
                step = step / ((level / ANNEALING) ** 2 - epsilon)
                step = np.where(columns.some(numbers).spread(beyond[numbers]), step, 0.0)
                before[points] = self.g[points]
                self.g[points] += step
            self._done += self._level_share
        self._level_share = 1.0 - self._done
        self._last_level()
        self._report_share(1.0)
        return self

    def _report_share(self, share: float) -> None:
        """Report the share of the work that is done, which never falls."""
        self._reported = max(self._reported, share)
        if self.problem.of_rows.shape:
            note = (
                f"{np.count_nonzero(self.residual <= self.goal.tol)} of {len(self.status)} problems"
            )
        else:
            note = f"residual {self._records[-1][2]:.0e} of {self.goal.tol:.0e}"
        self.report(Share(self._reported, note))

    def _last_level(self) -> None:
        """Iterate in float32 as far as its rounding allows, then with better exponents."""
        problem, goal, epsilon = self.problem, self.goal, self.goal.epsilon
        limit, operations, exact = goal.max_iter, problem.operations, problem.exact_sums
        self.precise[:] = problem.needs_more(goal.precision, epsilon, goal.tol)
        left = [(which, np.flatnonzero(self.precise == which)) for which in (False, True)]
        if goal.precision == "auto" and operations.exponent_roundoff > operations.precise_roundoff:
            tol = np.full(len(self._everyone), goal.tol)
            if self.precise.any():
                measured = LEAVING_MARGIN * self._measured_rounding(left[1][1], epsilon)
                tol[self.precise] = np.maximum(goal.tol, measured)
            residual = self._iterate(self._everyone, epsilon, tol, limit, False, leave=True)
            out = (self.status == "max_iter") & (residual > tol)
            # Float32 was enough if precise softmins confirm the residual.
            checked = out | ~self.precise
            self._measure(np.flatnonzero(checked), epsilon, precise=True, before=False)
            left = [(True, np.flatnonzero(~(out | (checked & (self.status == "converged")))))]
        for precise, numbers in left:
            problem.exact_sums = exact
            for share in (1.0, *REPEATED):
                if not len(numbers):
                    break
                self._iterate(numbers, epsilon, share * goal.tol, limit, precise)
                converged = self.status[numbers] == "converged"
                self._measure(numbers, epsilon, precise, precise)
                status = self.status[numbers]
                # The bound of the rounding can have lifted a residual above the tolerance.
                again = converged & (status != "converged")
                coarse = operations.sum_roundoff > operations.precise_roundoff
                coarse = coarse and not problem.exact_sums and goal.precision == "auto"
                if self.certify and coarse and problem.truncation is None:
                    # Sums in float32 have ended a solve whose tolerance exact sums can reach.
                    bounds = self.roundoffs.max(axis=0)[numbers]
                    further = (status == "precision") & (bounds < EXACT_SHARE * goal.tol)
                    again |= further
                    problem.exact_sums |= bool(further.any())
                numbers = numbers[again & (self.n_iter[numbers] < limit)]

    def _measure(self, numbers: IntArray, epsilon: float, precise: bool, before: bool) -> None:
        """Compute last softmins, precise ones or not, and residuals; T(f) was so `before`."""
        if not len(numbers):
            return
        problem = some(self.problem, numbers)
        rows, columns = (of.points_of(numbers) for of in self.problem.reductions)
        # Softmins keep what they get, and these vectors change.
        f, g, t_columns = np.array(self.f[rows]), np.array(self.g[columns]), self.t_columns[columns]
        if self.certify:
            t_rows, t_columns = problem.bounded_softmins(f, g, epsilon)
        else:
            t_rows = problem.softmin(0, g, epsilon, precise)
            if precise != before:
                t_columns = problem.softmin(1, f, epsilon, precise)
        residual = problem.residual(f, g, t_rows, t_columns, epsilon)
        self._records.append((numbers, np.ones(len(numbers), bool), residual))
        self.t_rows[rows], self.t_columns[columns] = t_rows, t_columns
        self.residual[numbers] = residual
        self.roundoffs[0, numbers] = problem.to_rows.roundoff
        self.roundoffs[1, numbers] = problem.to_columns.roundoff
        within = self.residual[numbers] <= self.goal.tol
        missed = ~within & (self.status[numbers] == "converged")
        self.status[numbers[within]] = "converged"
        # In exact arithmetic the last half-step can only lower the residual.
        self.status[numbers[missed]] = "precision"

    def _measured_rounding(self, numbers: IntArray, epsilon: float) -> Array:
        """Return by how much T(g) changes with precise exponents, in units of epsilon."""
        problem = some(self.problem, numbers)
        g = np.array(self.g[self.problem.of_columns.points_of(numbers)])
        coarse, fine = (problem.softmin(0, g, epsilon, each) for each in (False, True))
        change = np.where(problem.a > 0, np.abs(coarse - fine), 0.0)
        return np.atleast_1d(problem.of_rows.largest(change)) / epsilon

    def _iterate(
        self, numbers: IntArray, epsilon: float, tol: Any, limit: int, precise: bool,
        leave: bool = False,
    ) -> Array:  # fmt: skip
        """Iterate from g at one epsilon until residuals are `tol` or `limit` iterations are over.

        f, g and T(f) are then those of the last iteration; the result is the residual before g was
        updated. A problem also ends where its residual no longer falls because of rounding, or,
        with `leave`, for any reason: a slow problem falls by less than float32 resolves.
        """
        problem = some(self.problem, numbers)
        of: Any = problem.of_rows
        count = len(numbers)
        steps = self.steps(problem)
        steps.begin(np.array(self.g[self.problem.of_columns.points_of(numbers)]), epsilon, precise)
        self.status[numbers] = "max_iter"
        self.rounding[numbers] = ROUNDING_MARGIN * problem.rounding(epsilon, precise)
        tol, rounding, n_softmin = (
            values if of.shape else values.tolist()[0]
            for values in (np.full(count, tol), self.rounding[numbers], self.n_softmin[numbers])
        )
        floor, noise, best = of.filled(-np.inf), of.filled(0.0), of.filled(np.inf)
        since_best, running, guessed = of.filled(0), of.filled(True), of.filled(False)
        reached = np.zeros(len(self.status))
        current, whole = numbers, (*self.problem.reductions, self.problem.of_columns)
        first, least_tol = 0.0, -of.largest_of(-tol)
        while True:
            mass, dual = steps.update_rows()
            n_softmin = n_softmin + running
            # A half-step does not lower the dual: rounding does, or pairs left out.
            noise = of.larger(noise, of.choose(guessed, 0.0, NOISE_MARGIN * (floor - dual)))
            live = running
            if of.any(guessed):
                slack = noise + problem.slack(floor, rounding, mass, epsilon)
                bad = of.without(guessed, dual >= floor - slack)
                steps.accept(of.without(guessed, bad))
                if of.any(bad):
                    steps.take_back(bad)
                    n_softmin, live = n_softmin + bad * steps.ahead, of.without(running, bad)
                    if not of.any(live):
                        guessed = of.without(guessed, bad)
                        continue
            residual, column_dual, moved = steps.update_columns()
            n_softmin = n_softmin + live * (self.softmins - 1)
            self._records.append((current, live, residual))
            since_best = of.choose(live, (since_best + 1) * (residual >= 0.9 * best), since_best)
            best = of.choose(live, of.smaller(best, residual), best)
            first = first or of.largest_of(residual)
            share = share_done(first, of.largest_of(best), least_tol)
            self._report_share(self._done + self._level_share * share)
            stalled = live & (since_best >= self.patience) & (leave | (residual <= rounding))
            within, n_iter = live & (residual <= tol), -(-n_softmin // self.softmins)
            outside = moved > problem.trust_radius * epsilon
            ended = within | stalled | (live & (n_iter >= limit)) | outside
            if of.any(ended):
                here = of.numbers(ended)
                for into, values, of_all, own in zip(
                    (self.f, self.g, self.t_columns), steps.potentials(), whole,
                    (*problem.reductions, problem.of_columns), strict=True,
                ):  # fmt: skip
                    into[of_all.points_of(current[here])] = values[own.points_of(here)]
                reached[current[here]] = np.atleast_1d(residual)[here]
                self.n_softmin[current[here]] = np.atleast_1d(n_softmin)[here]
                for status, which in (("precision", stalled), ("converged", within)):
                    self.status[current[of.numbers(which)]] = status
                running = of.without(running, ended)
                if not of.any(running):
                    return reached[numbers]
            problem.settle(residual)
            # The dual that the plain iteration has reached.
            floor = of.choose(live, column_dual, floor)
            # An extrapolation can cost one softmin more, which the limit must allow.
            may = running & live & (n_iter + 1 < limit) & (self.goal.max_iter >= SHORT)
            guessed = steps.go_on(may)
            if of.any(ended) and np.count_nonzero(running) <= (1 - STOPPED) * len(current):
                kept = np.flatnonzero(running)
                problem, current = steps.keep(kept), current[kept]
                of = problem.of_rows
                tol, rounding, floor, noise, best, since_best, running, guessed, n_softmin = (
                    values[kept]
                    for values in (
                        tol, rounding, floor, noise, best, since_best, running, guessed, n_softmin,
                    )
                )  # fmt: skip


def annealing(problem: Problem, goal: Goal, top: float) -> list[float]:
    """Return the blurs of the annealing, falling, below `top`, without the last one."""
    slowest = np.prod(problem.damping(goal.epsilon))
    if slowest <= EASY or goal.max_iter < SHORT:
        return []
    level = goal.blur / ANNEALING
    levels: list[float] = []
    while level < top and len(levels) < goal.max_iter // 8:
        levels.append(level)
        level /= ANNEALING
    return levels[::-1]


def share_done(first: float, residual: float, tol: float) -> float:
    """Return the share of the work that is done, if residuals fall geometrically."""
    if residual <= tol or first <= tol:
        return 1.0
    if not math.isfinite(residual):
        return 0.0
    return min(1.0, max(0.0, math.log(first / residual) / math.log(first / tol)))
