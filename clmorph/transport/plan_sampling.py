"""Random draws from a plan that is too large to keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph._shared.validation import check_integer
from clmorph.backends.select import Backend, get_backend
from clmorph.measures.points import AnyMeasure, MeasureLike, as_pair
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport.options import MAX_DRAWS
from clmorph.transport.plan import Plan, plan_of_pairs
from clmorph.transport.potentials import Potentials


@dataclass(frozen=True, eq=False)
class Draws:
    """Pairs drawn from a plan: k from each row, and l from each column."""

    targets: NDArray[np.int32]  #: (N, k), drawn with the probabilities pi_ij / r_i
    sources: NDArray[np.int32]  #: (M, l), drawn with the probabilities pi_ij / c_j
    row_mass: Array  #: r, (N,)
    column_mass: Array  #: c, (M,)

    def masses(self) -> tuple[Array, Array]:
        """Return the mass of each draw from a row, (N, k), and from a column, (M, l).

        A pair is drawn k pi_ij / r_i times from its row and l pi_ij / c_j times from its column
        on average, so that draws of mass 1 / (k / r_i + l / c_j) add up to pi_ij on average
        (the balance heuristic of Veach and Guibas 1995). All masses are then scaled so that their
        sum is the plan's whole mass.
        """
        with np.errstate(divide="ignore", over="ignore"):
            rows = self.targets.shape[1] / self.row_mass
            columns = self.sources.shape[1] / self.column_mass
            found = (
                1.0 / (rows[:, None] + columns[self.targets]),
                1.0 / (rows[self.sources] + columns[:, None]),
            )
        drawn = float(found[0].sum() + found[1].sum())
        scale = float(self.row_mass.sum()) / drawn if drawn > 0 else 0.0
        return found[0] * scale, found[1] * scale


def n_draws(draws: int) -> tuple[int, int]:
    """Return the numbers of draws from each row and from each column.

    All draws but one are taken from rows, because many strata of one side spread more evenly than
    few strata of both sides. One draw from each column is enough to reach every target point.
    """
    return max(1, draws - 1), 1


def sample_plan(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    draws: int,
    *,
    seed: int = 0,
    backend: Backend = "auto",
) -> Plan:
    """Draw pairs from the rows and the columns of a plan (paper, Eq. 2), without storing the plan.

    If the potentials have a truncation, pairs that it leaves out are never drawn.

    Draws are stratified: a row is divided into equal parts of its mass, and draw s falls into part
    s, so that even a few draws spread over the whole row. One draw from each column makes mass
    arrive at every target point that the plan reaches, even with few draws. The masses of the draws
    are unbiased: on average they add up to the plan's masses in each pair, row and column; their
    total is exact. `Plan.marginals` of the result are those of the whole plan.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
    potentials : Potentials
    draws : int
        Number of draws for each point: all but one (and at least one) come from each row, and one
        comes from each column. A pair that is drawn twice becomes one pair with the sum of both
        masses.
    seed : int
        Seed of the random numbers.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`. Backends order points differently, so the same seed gives
        different draws.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
    >>> drawn = clmorph.sample_plan(source, target, potentials, 2, backend="numpy")
    >>> drawn.shape, round(float(drawn.mass.sum()), 3), round(drawn.total_mass, 3)
    ((3, 2), 0.828, 0.828)
    """
    source, target = as_pair(source, target)
    draws = check_integer("draws", draws, 1, MAX_DRAWS)
    drawn = draw_pairs(source, target, potentials, n_draws(draws), seed=seed, backend=backend)
    (n, by_row), (m, by_column) = drawn.targets.shape, drawn.sources.shape
    rows = np.concatenate((np.repeat(np.arange(n), by_row), drawn.sources.ravel()))
    columns = np.concatenate((drawn.targets.ravel(), np.repeat(np.arange(m), by_column)))
    mass = np.concatenate([part.ravel() for part in drawn.masses()])
    pairs = rows.astype(np.int64), columns.astype(np.int64)
    return plan_of_pairs(pairs, mass, (n, m), (drawn.row_mass, drawn.column_mass))


def draw_pairs(
    source: AnyMeasure,
    target: AnyMeasure,
    potentials: Potentials,
    draws: tuple[int, int],
    *,
    seed: int = 0,
    backend: Backend = "auto",
) -> Draws:
    """Draw pairs from each row and from each column of a plan."""
    seed = check_integer("seed", seed, 0, 2**63)
    rng = np.random.default_rng(seed)
    pair = as_pair(source, target)
    operations = get_backend(backend)
    of_rows = RowsOfPlan(operations, pair, potentials).checked()
    of_columns = of_rows.swapped()
    epsilon, precise = potentials.epsilon, potentials.precise

    def draw(own: RowsOfPlan, count: int) -> NDArray[np.int32]:
        thresholds = (np.arange(count) + rng.random((len(own.softmin), count))) / count
        # The division can round up to 1.
        thresholds = np.minimum(thresholds, np.nextafter(1.0, 0.0))
        return operations.sample_plan_rows(
            *own.clouds, own.potentials.g, own.softmin, epsilon, thresholds, precise, own.near
        )

    return Draws(draw(of_rows, draws[0]), draw(of_columns, draws[1]), of_rows.mass, of_columns.mass)
