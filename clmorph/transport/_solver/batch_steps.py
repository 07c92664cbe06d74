"""Steps of many problems at the same time, each until its own residual is small.

All problems take a step together, so that one launch of a kernel serves them all. Each stops by
itself, and problems that have stopped are taken out of the vectors. What a step computes is written
in `Problem` and `Anderson`, for one problem and for many.
"""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import AnyArray, Array, BoolArray, IntArray
from clmorph.transport._solver.anderson import Anderson
from clmorph.transport._solver.batch import some
from clmorph.transport._solver.half_steps import without_drift
from clmorph.transport._solver.iteration import NOISE_MARGIN, SHORT, STALLED
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.reductions import Segments
from clmorph.transport._solver.state import ROUNDING_MARGIN, slack_of

#: Problems that have stopped are taken out once they are this share of those in the vectors.
STOPPED = 1 / 16


class Reached(NamedTuple):
    """Potentials of some problems after the last half-step of a level."""

    problems: IntArray  #: (k,) their numbers
    f: Array
    g: Array
    residual: Array  #: (k,) before that half-step
    status: AnyArray  #: (k,) array of str, as in `Iteration.status`


class Record:
    """What many problems have done so far.

    Parameters
    ----------
    count : int
        Number of problems.
    """

    def __init__(self, count: int) -> None:
        self.n_softmin = np.zeros(count, np.int64)
        self._histories: list[tuple[IntArray, Array]] = []

    @property
    def n_iter(self) -> IntArray:
        """(count,) iterations of each problem."""
        return np.asarray(-(-self.n_softmin // 2))

    def add(self, problems: IntArray, residual: Array) -> None:
        """Remember the residuals of some problems."""
        self._histories.append((problems, residual))

    def residuals(self) -> list[Array]:
        """Return the residuals of every problem, in the order in which they were remembered."""
        numbers = np.concatenate([numbers for numbers, _ in self._histories])
        values = np.concatenate([values for _, values in self._histories])
        order = np.argsort(numbers, kind="stable")
        ends = np.cumsum(np.bincount(numbers, minlength=len(self.n_softmin)))
        return np.split(values[order], ends[:-1])


@dataclass
class _Each:
    """What is known of each of the problems in the vectors: (k,) arrays."""

    places: IntArray  #: their places among all problems of this run
    tol: Array
    rounding: Array
    best: Array  #: smallest residual
    since_best: IntArray  #: iterations since then
    running: BoolArray
    guessed: BoolArray  #: whether the potentials are extrapolated ones
    floor: Array  #: the dual that was reached before
    noise: Array  #: see `NOISE_MARGIN`

    def taken(self, kept: IntArray) -> "_Each":
        """Return this for some of the problems."""
        return _Each(*(getattr(self, each.name)[kept] for each in fields(self)))


class Steps:
    """One run of many problems at one epsilon.

    Parameters
    ----------
    problem : Problem
        All problems, see `problem_of_many`.
    numbers : (k,) array
        The problems that run.
    epsilon : float
        Cost units.
    tol : (k,) array
        Residual at which each stops, in units of epsilon.
    limit, max_iter : int
        Number of iterations, those of earlier runs included, after which a problem stops in this
        run, and in any.
    precise : bool
        Whether exponents are computed in more than float32.
    leave : bool
        As in `Iteration._iterate`.
    record : Record
    """

    def __init__(
        self,
        problem: Problem,
        numbers: IntArray,
        epsilon: float,
        tol: Array,
        limit: int,
        max_iter: int,
        precise: bool,
        leave: bool,
        record: Record,
    ) -> None:
        self._numbers, self._epsilon, self._record = numbers, epsilon, record
        self._limit, self._max_iter, self._precise, self._leave = limit, max_iter, precise, leave
        self._problem = problem = some(problem, numbers)
        count = len(numbers)
        #: Largest residuals that rounding alone can cause, (k,), in units of epsilon.
        self.rounding = ROUNDING_MARGIN * problem.rounding(epsilon, precise)
        self._layout = segments(problem)
        self._memory = Anderson(problem.of_columns)
        self._each = _Each(
            np.arange(count), tol, self.rounding, np.full(count, np.inf),
            np.zeros(count, np.int64), np.ones(count, bool), np.zeros(count, bool),
            np.full(count, -np.inf), np.zeros(count),
        )  # fmt: skip
        self._reached = Reached(
            numbers, np.zeros(len(problem.a)), np.zeros(len(problem.b)), np.zeros(count),
            np.full(count, "max_iter", object),
        )  # fmt: skip

    def run(self, g: Array) -> Reached:
        """Iterate from potentials g, (M,), as `Iteration._iterate` does."""
        epsilon, fallback = self._epsilon, g
        while True:
            problem, each = self._problem, self._each
            f, g_shifted, t_rows, _ = problem.update_f(
                g, problem.softmin_rows(g, epsilon, self._precise), epsilon
            )
            self._record.n_softmin[self._running_numbers(each.running)] += 1
            bad = self._bad(f, g_shifted, t_rows)
            live = each.running & ~bad
            if not live.any():
                each.guessed = np.zeros_like(bad)
                g = _where(problem, bad, fallback, g)
                continue
            t_columns = problem.softmin_columns(f, epsilon, self._precise)
            residual = problem.residual(f, g_shifted, t_rows, t_columns, epsilon)
            image, f, t_columns, _ = problem.update_g(f, t_columns, epsilon)
            if self._stop(live, residual, f, image):
                return self._reached
            column_mass = problem.column_mass(image, t_columns, epsilon)
            mass = problem.of_columns.sum(column_mass)
            # Problems that are taken back keep what they had reached before.
            each.floor = np.where(bad, each.floor, problem.dual(f, image, mass, epsilon))
            # An extrapolation can cost one softmin more, which the limit must allow.
            n_iter = self._record.n_iter[self._numbers[each.places]]
            may = each.running & live & (n_iter + 1 < self._limit) & (self._max_iter >= SHORT)
            following, each.guessed = image, np.zeros_like(bad)
            if may.any():
                guess, each.guessed = self._memory.extrapolate(g, image, column_mass, may)
                following = without_drift(problem, guess, image, column_mass)
            # A problem that was taken back goes on from where the plain iteration was.
            g, fallback = _where(problem, bad, fallback, following), image
            if np.count_nonzero(each.running) <= (1 - STOPPED) * len(each.running):
                kept = np.flatnonzero(each.running)
                points = segments(problem)[1].points_of(kept)
                self._problem, self._each = some(problem, kept), each.taken(kept)
                self._memory.take(kept, points, segments(self._problem)[1])
                g, fallback = g[points], fallback[points]

    def _running_numbers(self, which: BoolArray) -> IntArray:
        """Return the numbers of those of the problems in the vectors."""
        return np.asarray(self._numbers[self._each.places[which]])

    def _bad(self, f: Array, g: Array, t_rows: Array) -> BoolArray:
        """Return the problems whose dual is below what the plain half-step had reached."""
        problem, each, epsilon = self._problem, self._each, self._epsilon
        if not each.guessed.any():
            return each.guessed
        mass = problem.of_rows.sum(problem.row_mass(f, t_rows, epsilon))
        dual = problem.dual(f, g, mass, epsilon)
        # A half-step does not lower the dual: rounding does, or pairs left out.
        fall = np.where(each.running & ~each.guessed, each.floor - dual, 0.0)
        each.noise = np.maximum(each.noise, NOISE_MARGIN * fall)
        slack = each.noise + slack_of(problem, each.floor, each.rounding, mass, epsilon)
        bad: BoolArray = each.guessed & ~(dual >= each.floor - slack)
        self._memory.accepted(each.guessed & ~bad)
        if bad.any():
            self._memory.rejected(bad)
        return bad

    def _stop(self, live: BoolArray, residual: Array, f: Array, g: Array) -> bool:
        """Stop the problems that are done, and return whether all are."""
        each, going = self._each, self._running_numbers(live)
        self._record.n_softmin[going] += 1
        self._record.add(going, residual[live])
        since = np.where(residual < 0.9 * each.best, 0, each.since_best + 1)
        each.since_best = np.where(live, since, each.since_best)
        each.best = np.where(live, np.minimum(each.best, residual), each.best)
        stalled = each.since_best >= STALLED
        if not self._leave:
            stalled &= residual <= each.rounding
        within, n_iter = residual <= each.tol, self._record.n_iter[self._numbers[each.places]]
        finished = live & (within | stalled | (n_iter >= self._limit))
        if not finished.any():
            return False
        here = np.flatnonzero(finished)
        places = each.places[here]
        for into, layout, own, values in zip(
            self._reached[1:3], self._layout, segments(self._problem), (f, g), strict=True
        ):
            into[layout.points_of(places)] = values[own.points_of(here)]
        self._reached.residual[places] = residual[here]
        self._reached.status[places[stalled[here]]] = "precision"
        self._reached.status[places[within[here]]] = "converged"
        each.running = each.running & ~finished
        return not each.running.any()


def segments(problem: Problem) -> tuple[Segments, Segments]:
    """Return the reductions of many problems, over rows and over columns."""
    of_rows, of_columns = problem.reductions
    assert isinstance(of_rows, Segments)
    assert isinstance(of_columns, Segments)
    return of_rows, of_columns


def _where(problem: Problem, which: BoolArray, one: Array, other: Array) -> Array:
    """Return potentials g of one kind for some problems, and of the other for the others."""
    return np.where(problem.of_columns.spread(which), one, other) if which.any() else other
