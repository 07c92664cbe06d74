"""Coarse problems that approximate a large one, by clusters or by pairs of notable mass."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import MAX_EXPONENT
from clmorph.backends.records import (
    PlanTerms,
    ProgramError,
    ResidentIteration,
    StoredPairs,
    StoredVectors,
)
from clmorph.measures.cluster import Clusters
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.problem import MASS_ROUNDING, Problem, State
from clmorph.transport._solver.softmin import Softmin, check_finite
from clmorph.transport.certificate import Side


class StoredChoice(NamedTuple):
    """Which pairs are stored."""

    #: The least share that a pair has in the sum of its row or column. Pairs that lists of near
    #: pairs leave out are not stored, whatever their share.
    share: float
    trust_radius: float  #: the number of epsilons by which potentials may move
    #: The choice is taken only at residuals over the points up to this, in units of epsilon.
    residual: float = np.inf


#: Choices of the pairs to store. If one choice has too many pairs, the next one is tried. The
#: logarithm of a pair that is not stored grows by the rise of both its potentials, and mostly by
#: far less: islands of color that move by a hundred epsilons and more move as a whole. Nothing
#: proves that these pairs stay negligible within the radius: the residual over the points shows
#: whether they do. The last choice is for potentials that will hardly move: it stores what has
#: nearly all mass now.
STORED_CHOICES = (
    StoredChoice(1e-13, 60.0), StoredChoice(1e-7, 8.0), StoredChoice(1e-4, 6.0, residual=1.0),
)  # fmt: skip
#: The mass of the plan may fall by this factor while stored pairs are trusted, and closed forms of
#: the dual still have enough digits.
PLAN_CHANGE = 10.0
#: The relative rounding of a mass where iterations on the device have pairs of float32.
PAIR_ROUNDING = 1e-12


class CorrectedProblem(Problem):
    """A problem whose softmins carry a known correction tau.

    f = Delta (T(g) + tau) maximizes the dual over f of a problem whose masses are
    a exp(tau / epsilon) while its softmins keep a. So with masses and softmins replaced in this
    way every formula of `Problem` holds without a change, its dual included. Source of the idea:
    Brandt, "Multi-level adaptive solutions to boundary-value problems" (1977).
    """

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._own = self.a, self.b

    def softmin(
        self, side: int, old: Array, epsilon: float, precise: bool, bounded: bool = False
    ) -> Array:
        """Return T(g) or T(f), corrected."""
        return super().softmin(side, old, epsilon, precise, bounded) + self.corrections[side]

    def correct(self, rows: Array, columns: Array, epsilon: float) -> None:
        """Set the corrections tau of T(g), (N,), and of T(f), (M,)."""
        # Larger corrections are limited, because they are meaningless; the residual over the
        # points will show that.
        most = MAX_EXPONENT * epsilon
        rows, columns = np.clip(rows, -most, most), np.clip(columns, -most, most)
        if not any(self.inverse_rho):
            # Balanced: the masses asked for must stay equal.
            total = float((self._own[0] * np.exp(rows / epsilon)).sum())
            total /= float((self._own[1] * np.exp(columns / epsilon)).sum())
            columns = columns + epsilon * np.log(total)
        self.corrections, self._asked = (rows, columns), False
        self.a = self._own[0] * np.exp(rows / epsilon)
        self.b = self._own[1] * np.exp(columns / epsilon)
        self._weigh()

    def _sides(self, f: Array, g: Array, t_rows: Array, t_columns: Array) -> list[Side]:
        # Pairs left out change the correction, not where the cycles end; a residual that counted
        # them would not reach the tolerance. The finest problem's certificate counts its own pairs.
        sides = super()._sides(f, g, t_rows, t_columns)
        return [side._replace(left_out=0.0) for side in sides]


class Reordering(NamedTuple):
    """The restriction to a coarse problem that has the points in another order."""

    order: IntArray

    def restrict(self, values: Array, weights: Array) -> Array:
        """Return the values in the coarse problem's order."""
        return values[self.order]

    def points_of(self, values: Array) -> Array:
        """Return values of the coarse problem in the order of the points."""
        result = np.empty_like(values)
        result[self.order] = values
        return result


class CoarseGrid(NamedTuple):
    """A coarse problem, with the operators that transfer values between it and the points."""

    problem: CorrectedProblem
    source: Clusters | Reordering
    target: Clusters | Reordering
    to_target: Softmin  #: prolongs from its rows to the points of the target

    def prolong(self, new_f: Array, old_f: Array, epsilon: float) -> Array:
        """Return the change of T(f) at the points of the target, (M,), from f of the grid."""
        change: Array = self.to_target(new_f, epsilon) - self.to_target(old_f, epsilon)
        return self.target.points_of(change) if isinstance(self.target, Reordering) else change


def expanded(
    softmin: Softmin, potential: Array, epsilon: float, clusters: Clusters, measure: AnyMeasure
) -> Array:
    """Estimate T(potential) at points from its value and gradient at their clusters, its rows.

    The gradient at a center X is X less the mean destination of its row. As |x|^2 / 2 - T(x) is
    convex, the result is not below T: near pairs chosen by it leave out no more than they may.
    """
    values, means = softmin.operations.barycentric_projection(
        softmin.rows, softmin.columns, potential, epsilon, False, softmin.near
    )
    centers, offsets = clusters.measure.points, clusters.measure.offsets
    if offsets is not None and measure.offsets is not None:
        values = values - offsets
    shifts = measure.points - centers[clusters.labels]
    slopes = (centers - check_finite(means))[clusters.labels] + 0.5 * shifts
    result: Array = check_finite(values)[clusters.labels] + np.einsum("nd,nd->n", shifts, slopes)
    return result if measure.offsets is None else result + measure.offsets


class StoredSoftmin(Softmin):
    """The soft minimum over stored pairs, whose vectors have the order of `StoredPairs.orders`.

    They were stored for potentials of the columns, (M,), and of the rows; `start` is the latter
    plus epsilon log(masses). Rows without a stored pair keep their softmin, (N,).
    """

    def __init__(
        self,
        like: Softmin,
        stored: StoredPairs,
        by_column: bool,
        weights: tuple[Array, Array],
        potential: Array,
        softmin: Array,
        start: Array,
    ) -> None:
        super().__init__(like.operations, like.rows, like.columns, weights)
        self.stored, self._by_column = stored, by_column
        #: The potential for which the pairs were stored.
        self.origin = potential
        self._softmin, self._start = softmin, start

    def __call__(
        self, potential: Array, epsilon: float, precise: bool = False, bounded: bool = False
    ) -> Array:
        """Return T(potential), (N,) of (M,); flags are ignored, because exponents are small."""
        changes = (potential - self.origin) / epsilon
        logarithms = self.operations.sum_stored(self.stored, changes, self._by_column, True)
        alone = logarithms == -np.inf
        softmin = np.where(alone, 0.0, logarithms)
        softmin *= -epsilon
        softmin += self._start
        np.copyto(softmin, self._softmin, where=alone)
        return softmin

    def vectors(self, masses: Array, correction: Array | float, origin: Array) -> StoredVectors:
        """Return what an iteration on the device has of the rows, whose softmin is corrected."""
        return StoredVectors(masses, self._start + correction, self._softmin + correction, origin)

    def rounding(
        self, largest_cost: Any, epsilon: float, precise: bool, exact: bool = False
    ) -> float:
        """Return the effect of rounding on a softmin in nats; exponents are small here."""
        return 64 * self.operations.sum_roundoff


class StoredProblem(CorrectedProblem):
    """A problem over stored pairs; it holds near the potentials for which they were stored.

    The pairs are trusted around `center`, potentials f, (N,).
    """

    center: Array

    def __init__(
        self,
        like: Problem,
        softmins: tuple[StoredSoftmin, StoredSoftmin],
        choice: StoredChoice,
        plan_mass: float,
        epsilon: float,
    ) -> None:
        super().__init__(*softmins, like.rho, like.largest_cost)
        self.choice, self.trust_radius = choice, choice.trust_radius
        self._plan_mass, self._epsilon = plan_mass, epsilon
        self._started: ResidentIteration | None = None

    def start_iteration(self) -> ResidentIteration | None:
        """Return the device's iteration; None where closed forms of penalties have few digits."""
        enough = self.dual_rounding(self._epsilon, False) / PLAN_CHANGE
        rounding = MASS_ROUNDING if self.operations.has_float64 else PAIR_ROUNDING
        given = self._plan_mass, self._epsilon, enough, rounding
        for side, inverse in enumerate(self.inverse_rho):
            if inverse and not self.has_closed_form(side, *given):
                return None
        (to_rows, to_columns), (of_rows, of_columns) = self.softmins, self.corrections
        self._started = self.operations.start_stored_iteration(
            to_rows.stored,
            (
                to_rows.vectors(self.a, of_rows, to_columns.origin),
                to_columns.vectors(self.b, of_columns, to_rows.origin),
            ),
            self.center, self.inverse_rho, self._started,
        )  # fmt: skip
        return self._started

    def farthest(self, f: Any) -> Any:
        """Return the farthest move of a potential from the center, by points of positive mass."""
        of, massive = self.of_rows, self.a > 0
        moved, mean = f - self.center, self._mean_move(f)
        up, down = (of.largest(np.where(massive, each, -np.inf)) for each in (moved, -moved))
        return np.maximum(up - mean, down + mean)

    def held(self, f: Array, epsilon: float) -> tuple[Array, bool]:
        """Return the nearest trusted potentials to f, and whether f itself is not trusted."""
        moved = f - self.center - self._mean_move(f)
        radius = self.trust_radius * epsilon
        return f + np.clip(moved, -radius, radius) - moved, bool(self.farthest(f) > radius)

    def _mean_move(self, f: Any) -> Any:
        """Return the mean by mass of f minus the center: a shift of all potentials moves none."""
        return self.of_rows.inner(self.a, f - self.center) / self.masses[0]


def stored_grid(
    problem: Problem, state: State, epsilon: float, most: int, choices: Iterable[StoredChoice]
) -> CoarseGrid | None:
    """Return the problem over the pairs of notable mass near (f, g); None if they are too many.

    Of the choices the first one that has at most `most` pairs is taken.
    """
    near, sides = (problem.to_rows.near, problem.to_columns.near), range(2)
    potentials, softmins = (state.f, state.g), (state.t_rows, state.t_columns)
    # Logarithms of the marginals, above shares of which pairs are stored.
    wholes = [
        (potentials[side] - softmins[side]) / epsilon + problem.logarithms[side] for side in sides
    ]
    for choice in choices:
        by_row, by_column = (
            np.where(np.isneginf(each), np.inf, each + np.log(choice.share)) for each in wholes
        )
        try:
            plan = PlanTerms(problem.rows, problem.columns, *potentials, epsilon, by_row, by_column)
            stored = problem.operations.store_pairs(plan, most, near)
        except ProgramError as error:
            error.tell("no pairs are stored between iterations, which then take longer")
            return None
        if stored is None:
            continue
        orders = stored.orders
        masses = problem.a[orders[0]], problem.b[orders[1]]
        own = [potentials[side][orders[side]] for side in sides]
        to_rows, to_columns = (
            StoredSoftmin(
                problem.softmins[side], stored, side == 1, (masses[side], masses[1 - side]),
                own[1 - side], softmins[side][orders[side]],
                (potentials[side] + epsilon * problem.logarithms[side])[orders[side]],
            )
            for side in sides
        )  # fmt: skip
        plan_mass = float(problem.marginal(0, state.f, state.t_rows, epsilon).sum())
        smaller = StoredProblem(problem, (to_rows, to_columns), choice, plan_mass, epsilon)
        return CoarseGrid(smaller, Reordering(orders[0]), Reordering(orders[1]), to_columns)
    return None
