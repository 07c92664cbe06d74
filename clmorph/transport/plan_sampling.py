"""Summaries of a plan that is too large to keep: draws from it, or moments of its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph._shared.validation import check_integer, shown
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.images.color import from_space
from clmorph.measures.measure import Measure
from clmorph.measures.points import AnyMeasure, MeasureLike, as_pair
from clmorph.transport._solver.problem import largest_cost
from clmorph.transport._solver.softmin import Softmin, plan_softmin
from clmorph.transport.options import MAX_DRAWS
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials, check_origin, check_potentials

#: How exactly colors must follow from lifted points, in coordinates of their space.
COLOR_ERROR = 1e-6


@dataclass(frozen=True, repr=False, eq=False)
class Barycentric:
    """Where each source pixel goes on average, over the whole plan, and how widely.

    Attributes
    ----------
    positions : (N, 2) array
        Mean destination sum_j pi_ij y_j / r_i, in the common frame; between plain points (N, D),
        in their unit.
    colors : (N, 3) array
        Mean color there, taken in the color space of the cost; (N, 0) between plain points.
    covariance : (N, D, D) array
        Of the destination as it is lifted: (x, y, lambda r, lambda g, lambda b), or what a color
        space or a metric makes of it.
    row_mass, column_mass : (N,) and (M,) arrays
        Marginals of the plan.
    """

    positions: Array
    colors: Array
    covariance: Array
    row_mass: Array
    column_mass: Array

    def __repr__(self) -> str:
        return f"<Barycentric of {len(self)} points, mass {self.row_mass.sum():g}>"

    def __len__(self) -> int:
        return len(self.row_mass)

    @property
    def marginals(self) -> tuple[Array, Array]:
        """(N,) and (M,) masses that leave and arrive, as those of a `Plan`."""
        return self.row_mass, self.column_mass


@dataclass(frozen=True, eq=False)
class Draws:
    """Pairs drawn from a plan: as many from each row, and as many from each column.

    Attributes
    ----------
    targets : (N, k) array of int
        Target points drawn from each row, pi_ij / r_i.
    sources : (M, l) array of int
        Source points drawn from each column, pi_ij / c_j.
    row_mass, column_mass : (N,) and (M,) arrays
        Marginals r and c of the plan.
    """

    targets: NDArray[np.int32]
    sources: NDArray[np.int32]
    row_mass: Array
    column_mass: Array

    def masses(self) -> tuple[Array, Array]:
        """Return the mass of each draw from a row, (N, k), and from a column, (M, l).

        A pair is drawn k pi_ij / r_i times from its row and l pi_ij / c_j times from its column
        on average, so that draws of mass 1 / (k / r_i + l / c_j) add up to pi_ij on average
        (the balance heuristic of Veach and Guibas 1995). All are scaled to the plan's whole mass.
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
    """Return how many of so many draws a point are taken from each row and from each column.

    All but one from rows: finer strata of one side spread more evenly than coarse ones of both,
    and one is enough for every target point to be reached.
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
    """Draw pairs from the rows and the columns of a plan, in streaming and without bias.

    Where potentials come with a truncation, what it leaves out is never drawn.

    Draws are stratified: draw s falls into the s-th of equal parts of its row, so that few draws
    already spread as the row does. One draw of each column lets mass arrive wherever the plan
    brings some, however few the draws. Their masses add up to the plan's on average, in each
    pair, row and column, and exactly in all; the plan's own marginals are `Plan.marginals`.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
    potentials : Potentials
    draws : int
        For each point: all but one from its row, but at least one, and one from each column. A
        pair that is drawn twice is one of the sum of both masses.
    seed : int
    backend : str or Operations
        See `clmorph.get_backend`. Backends order points differently, so the same seed draws
        others.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    from scipy.sparse import coo_array

    source, target = as_pair(source, target)
    draws = check_integer("draws", draws, 1, MAX_DRAWS)
    drawn = draw_pairs(source, target, potentials, n_draws(draws), seed=seed, backend=backend)
    (n, by_row), (m, by_column) = drawn.targets.shape, drawn.sources.shape
    rows = np.concatenate((np.repeat(np.arange(n), by_row), drawn.sources.ravel()))
    columns = np.concatenate((drawn.targets.ravel(), np.repeat(np.arange(m), by_column)))
    mass = np.concatenate([part.ravel() for part in drawn.masses()])
    pairs = rows.astype(np.int64), columns.astype(np.int64)
    plan = coo_array((mass, pairs), shape=(n, m)).tocsr()  # sums what is twice there
    plan.sort_indices()
    plan.eliminate_zeros()
    return Plan(
        plan.indptr.astype(np.int64), plan.indices.astype(np.int32), plan.data, (n, m),
        drawn.row_mass, drawn.column_mass,
    )  # fmt: skip


def draw_pairs(
    source: AnyMeasure,
    target: AnyMeasure,
    potentials: Potentials,
    draws: tuple[int, int],
    *,
    seed: int = 0,
    backend: Backend = "auto",
) -> Draws:
    """Draw so many pairs from each row of a plan, and so many from each column.

    Parameters
    ----------
    source, target : Measure or WeightedPoints
    potentials : Potentials
    draws : (from each row, from each column)
    seed, backend
        As in `sample_plan`.

    Returns
    -------
    Draws

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    seed = check_integer("seed", seed, 0, 2**63)
    rng = np.random.default_rng(seed)
    pair = as_pair(source, target)
    operations, clouds, to_rows, by_row = _rows(*pair, potentials, backend)
    swapped = potentials.swapped()
    to_columns = plan_softmin(operations, clouds[::-1], pair[::-1], swapped)
    epsilon, precise = potentials.epsilon, potentials.precise
    by_column = to_columns(potentials.f, epsilon, precise)

    def draw(own: Potentials, softmin: Softmin, sums: Array, count: int) -> NDArray[np.int32]:
        thresholds = (np.arange(count) + rng.random((len(sums), count))) / count
        # Dividing can round up to 1.
        thresholds = np.minimum(thresholds, np.nextafter(1.0, 0.0))
        return operations.sample_plan_rows(
            softmin.rows, softmin.columns, own.g, sums, epsilon, thresholds, precise, softmin.near
        )

    return Draws(
        draw(potentials, to_rows, by_row, draws[0]),
        draw(swapped, to_columns, by_column, draws[1]),
        _row_mass(pair[0].weights, potentials, by_row),
        _row_mass(pair[1].weights, swapped, by_column),
    )


def check_barycentric(name: str, value: Any, sizes: tuple[int, int]) -> Barycentric:
    """Return mean destinations of pixels of images of so many pixels.

    Raises
    ------
    InputError
        If `value` is none such.
    """
    if not isinstance(value, Barycentric):
        raise InputError(
            f"{name}={shown(value)}: expected a Plan, as clmorph.transport_plan returns it, or a "
            "Barycentric, as clmorph.barycentric_plan does"
        )
    n, m = sizes
    parts = (
        (value.positions, (n, 2)),
        (value.colors, (n, 3)),
        (value.row_mass, (n,)),
        (value.column_mass, (m,)),
    )
    if not all(
        type(array) is np.ndarray and array.shape == shape and np.all(np.isfinite(array))
        for array, shape in parts
    ):
        raise InputError(
            f"{name} is not of these measures: expected mean destinations of {n} pixels among "
            f"{m}, finite; compute them for these measures with clmorph.barycentric_plan"
        )
    return value


def barycentric_plan(
    source: MeasureLike, target: MeasureLike, potentials: Potentials, *, backend: Backend = "auto"
) -> Barycentric:
    """Compute mean and covariance of every point's destination, in streaming, nothing pruned.

    Where potentials come with a truncation, what it leaves out is left out here too.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
        Only between two images destinations have colors.
    potentials : Potentials
    backend : str or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Barycentric

    Raises
    ------
    InputError
        If an argument cannot be used; if the color weight or the metric leaves part of color
        out of the cost, and hence out of the plan's means.
    """
    images = isinstance(source, Measure) and isinstance(target, Measure)
    pair = as_pair(source, target)
    to_colors: Callable[[Array], Array] = lambda mean: mean[:, :0]  # noqa: E731
    if isinstance(source, Measure) and isinstance(target, Measure):
        to_colors = destination_colors(source, target)
    operations, clouds, to_rows, softmin = _rows(*pair, potentials, backend)
    epsilon, precise = potentials.epsilon, potentials.precise
    mean, covariance = operations.plan_moments(
        *clouds, potentials.g, softmin, epsilon, precise, to_rows.near
    )
    to_columns = plan_softmin(operations, clouds[::-1], pair[::-1], potentials.swapped())
    columns = to_columns(potentials.f, epsilon, precise)
    return Barycentric(
        positions=mean[:, :2] if images else mean,
        colors=to_colors(mean),
        covariance=covariance,
        row_mass=_row_mass(pair[0].weights, potentials, softmin),
        column_mass=_row_mass(pair[1].weights, potentials.swapped(), columns),
    )


def destination_colors(source: Measure, target: Measure) -> Callable[[Array], Array]:
    """Return what makes sRGB colors (K, 3) of mean lifted destinations (K, D).

    Raises
    ------
    InputError
        If the cost does not see all of color.
    """
    _, lifted = as_pair(source, target)
    # Whatever the lifting does, it is linear in the coordinates of colors.
    features = np.column_stack((lifted.points, np.ones(len(target))))
    linear, *_ = np.linalg.lstsq(features, target.coordinates)
    if np.abs(features @ linear - target.coordinates).max() > COLOR_ERROR:
        raise InputError(
            f"color_weight={target.color_weight:g} or the color metric leaves part of color out of "
            "the cost, so barycentric destinations have no mean color: expected a positive color "
            "weight and a metric of full rank; use small ones, or draws from the plan"
        )
    return lambda mean: from_space(mean @ linear[:-1] + linear[-1], target.color_space)


def _rows(
    source: AnyMeasure, target: AnyMeasure, potentials: Potentials, backend: Backend
) -> tuple[Operations, tuple[Any, Any], Softmin, Array]:
    """Return the operations, the uploaded clouds, what takes T(g), and T(g)."""
    check_potentials("potentials", potentials, (len(source), len(target)))
    operations = get_backend(backend)
    clouds = (
        operations.upload(source.points, source.weights, source.offsets),
        operations.upload(target.points, target.weights, target.offsets),
    )
    to_rows = plan_softmin(operations, clouds, (source, target), potentials)
    softmin = to_rows(potentials.g, potentials.epsilon, potentials.precise)
    rounding = to_rows.rounding(
        len(target), largest_cost(source.points, target.points), potentials.epsilon,
        potentials.precise,
    )  # fmt: skip
    check_origin(potentials, _row_mass(source.weights, potentials, softmin), rounding)
    return operations, clouds, to_rows, softmin


def _row_mass(weights: Array, potentials: Potentials, softmin: Array) -> Array:
    with np.errstate(divide="ignore", over="ignore"):
        return np.exp((potentials.f - softmin) / potentials.epsilon + np.log(weights))
