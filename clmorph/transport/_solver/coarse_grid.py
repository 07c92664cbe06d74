"""Smaller problems that stand for a large one: of its cells, or of its pairs that matter."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.records import StoredPairs
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.softmin import Softmin
from clmorph.transport.certificate import MAX_EXPONENT

Array = NDArray[np.float64]

#: Pairs are stored from this share of their row's or column's sum on, and serve until potentials
#: have moved by so many epsilons. A pair that is left out grows by as much as both its potentials
#: rise, mostly far less; whether one has come to matter the points' residual tells.
STORED_SHARE, TRUST = 1e-26, 50.0


class CorrectedProblem(Problem):
    """A problem whose softmins are off by a known correction.

    f = Delta (T(g) + tau) is what maximizes the dual over f when the mass that is asked for is
    a exp(tau / epsilon) while the softmins keep a; so with masses and softmins replaced in this
    way every formula of `Problem` holds as it stands, its dual included.
    """

    def __init__(
        self,
        to_rows: Softmin,
        to_columns: Softmin,
        weights: tuple[Array, Array],
        rho: tuple[float, float],
        largest_cost: float,
    ) -> None:
        super().__init__(to_rows, to_columns, weights, rho, largest_cost)
        self._own = weights
        self._corrections: tuple[Array | float, Array | float] = (0.0, 0.0)

    def softmin_rows(self, g: Array, epsilon: float, precise: bool) -> Array:
        """T(g), corrected."""
        return super().softmin_rows(g, epsilon, precise) + self._corrections[0]

    def softmin_columns(self, f: Array, epsilon: float, precise: bool) -> Array:
        """T(f), corrected."""
        return super().softmin_columns(f, epsilon, precise) + self._corrections[1]

    def correct(self, rows: Array, columns: Array, epsilon: float) -> None:
        """Set the corrections tau of T(g), (N,), and of T(f), (M,)."""
        # What is off by more is no correction of anything: the points' residual will tell.
        most = MAX_EXPONENT * epsilon
        rows, columns = np.clip(rows, -most, most), np.clip(columns, -most, most)
        if not any(self.inverse_rho):
            # Balanced: the masses asked for must stay equal.
            total = float((self._own[0] * np.exp(rows / epsilon)).sum())
            total /= float((self._own[1] * np.exp(columns / epsilon)).sum())
            columns = columns + epsilon * np.log(total)
        self._corrections = rows, columns
        self.a = self._own[0] * np.exp(rows / epsilon)
        self.b = self._own[1] * np.exp(columns / epsilon)
        with np.errstate(divide="ignore"):
            self.log_a, self.log_b = np.log(self.a), np.log(self.b)
        self.masses = float(self.a.sum()), float(self.b.sum())

    def begin(self, f: Array) -> None:
        """Learn where a solve begins."""

    def nearer(self, f: Array, epsilon: float) -> Array:
        """Return f, but no farther away than this problem is good for."""
        return f


class Groups(Protocol):
    """Which point of a smaller problem each point belongs to."""

    def mean(self, values: Array, weights: Array) -> Array:
        """Return the mean of values over each group, by mass: (N,) arrays to (groups,)."""


class Alone:
    """Every point is a group of its own."""

    def mean(self, values: Array, weights: Array) -> Array:
        """Return the values."""
        return values


class Grid(NamedTuple):
    """A smaller problem, and how it and the points' problem see each other."""

    problem: CorrectedProblem
    source: Groups
    target: Groups
    to_target: Softmin  #: from its rows to the points of the target
    to_source: Softmin  #: from its columns to the points of the source


class StoredSoftmin(Softmin):
    """The soft minimum over stored pairs.

    Parameters
    ----------
    like : Softmin
        Whose clouds, and masses.
    stored : StoredPairs
        Of the plan of two potentials.
    by_column : bool
        Sum over the plan's rows.
    potential, softmin : arrays
        That of the columns that pairs were stored for, and its softmin, which is what rows
        keep that have no pair.
    start : (N,) array
        Of the rows' potential for which they were stored, plus epsilon times the logarithms of
        the rows' masses.
    """

    def __init__(
        self,
        like: Softmin,
        stored: StoredPairs,
        by_column: bool,
        potential: Array,
        softmin: Array,
        start: Array,
    ) -> None:
        super().__init__(like.operations, like.rows, like.columns, like.weights)
        self._stored, self._by_column = stored, by_column
        self._potential, self._softmin, self._start = potential, softmin, start

    def __call__(
        self, potential: Array, epsilon: float, precise: bool = False, bounded: bool = False
    ) -> Array:
        """Return T(potential), (N,) for (M,); exponents are small here, and nothing is bounded."""
        changes = (potential - self._potential) / epsilon
        logarithms = self.operations.sum_stored(self._stored, changes, self._by_column)
        alone = np.isneginf(logarithms)
        return np.where(
            alone, self._softmin, self._start - epsilon * np.where(alone, 0, logarithms)
        )

    def rounding(self, n_columns: int, largest_cost: float, epsilon: float, precise: bool) -> float:
        """By how many nats rounding may change a softmin: exponents are small here."""
        return 64 * self.operations.sum_roundoff


class StoredProblem(CorrectedProblem):
    """A problem over stored pairs, near the potentials they were stored for."""

    center: Array

    def begin(self, f: Array) -> None:
        """Learn where a solve begins."""
        self.center = f

    def is_astray(self, f: Array, epsilon: float) -> bool:
        """Whether potentials have moved so far that other pairs may matter."""
        return bool(np.abs(self._moved(f)).max() > TRUST * epsilon)

    def nearer(self, f: Array, epsilon: float) -> Array:
        """Return f, but no farther away than pairs are good for."""
        moved = self._moved(f)
        return f + np.clip(moved, -TRUST * epsilon, TRUST * epsilon) - moved

    def _moved(self, f: Array) -> Array:
        """Return f less where it began, but for what is the same for all points."""
        moved = np.where(self.a > 0, f - self.center, 0.0)
        return moved - float(self.a @ moved) / self.masses[0]


def stored_grid(
    problem: Problem, f: Array, g: Array, softmins: tuple[Array, Array], epsilon: float, most: int
) -> Grid | None:
    """Return the problem over the pairs that matter near (f, g); None if they are too many.

    Parameters
    ----------
    problem : Problem
    f, g : (N,) and (M,) arrays
    softmins : (T(g), T(f))
    epsilon : float
    most : int
        Pairs to store at most.
    """
    by_row, by_column = (
        _threshold(potential, softmin, log_weights, epsilon)
        for potential, softmin, log_weights in (
            (f, softmins[0], problem.log_a), (g, softmins[1], problem.log_b)
        )
    )  # fmt: skip
    near = problem.to_rows.near, problem.to_columns.near
    stored = problem.operations.store_pairs(
        problem.rows, problem.columns, f, g, epsilon, by_row, by_column, most, near
    )
    if stored is None:
        return None
    starts = f + epsilon * problem.log_a, g + epsilon * problem.log_b
    to_rows = StoredSoftmin(problem.to_rows, stored, False, g, softmins[0], starts[0])
    to_columns = StoredSoftmin(problem.to_columns, stored, True, f, softmins[1], starts[1])
    smaller = StoredProblem(
        to_rows, to_columns, (problem.a, problem.b), problem.rho, problem.largest_cost
    )
    return Grid(smaller, Alone(), Alone(), to_columns, to_rows)


def _threshold(potential: Array, softmin: Array, log_weights: Array, epsilon: float) -> Array:
    """Log pi_ij from which on pairs of a row are stored; rows without mass have none."""
    thresholds = (potential - softmin) / epsilon + log_weights + np.log(STORED_SHARE)
    return np.where(np.isneginf(thresholds), np.inf, thresholds)
