"""Mean and covariance of every point's destination, for plans that are too large to keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph._shared.validation import shown
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.images.color import from_space
from clmorph.measures.measure import Measure
from clmorph.measures.points import MeasureLike, as_pair
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport.potentials import Potentials

#: Largest error of colors that are computed from lifted points, in coordinates of the color space.
COLOR_ERROR = 1e-6

#: Most coordinates of points whose covariances are computed: a launch takes time by their square.
MAX_COVARIANCE = 64


@dataclass(frozen=True, repr=False, eq=False)
class Barycentric:
    """Mean and covariance of the destination of each source point, over the whole plan.

    Attributes
    ----------
    positions : (N, 2) array
        Mean destination T(x_i) = sum_j pi_ij y_j / r_i (paper, 4), in the common frame. Between
        plain points it is (N, D), in their unit.
    colors : (N, 3) array
        Mean color of the destination, as sRGB; the mean is taken in the color space of the cost.
        (N, 0) between plain points.
    covariance : (N, D, D) array
        Covariance of the lifted destination (x, y, lambda r, lambda g, lambda b). With another
        color space or a metric, its coordinates replace the colors.
    row_mass, column_mass : (N,) and (M,) arrays
        Marginals r and c of the plan.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = clmorph.lift(np.array([[0.0, 1.0], [0.0, 1.0]]), color_weight=2.0)
    >>> target = clmorph.lift(np.array([[1.0, 0.0], [1.0, 0.0]]), color_weight=2.0)
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.05, reach=0.3, backend="numpy")
    >>> means = clmorph.barycentric_plan(source, target, potentials, backend="numpy")
    >>> len(means), means.covariance.shape
    (4, (4, 5, 5))
    >>> means.positions.round(3).tolist()
    [[1.0, 0.0], [0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
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
        """(N,) and (M,) masses that leave and arrive, as in `Plan.marginals`."""
        return self.row_mass, self.column_mass


def check_barycentric(name: str, value: Any, sizes: tuple[int, int]) -> Barycentric:
    """Return mean destinations after checking that they belong to images of these sizes."""
    if not isinstance(value, Barycentric):
        raise InputError(
            f"{name}={shown(value)}: expected a Plan, as clmorph.transport_plan returns it, or a "
            "Barycentric, as clmorph.barycentric_plan does"
        )
    n, m = sizes
    parts = value.positions, value.colors, value.row_mass, value.column_mass
    if not all(
        type(array) is np.ndarray and array.shape == shape and np.all(np.isfinite(array))
        for array, shape in zip(parts, ((n, 2), (n, 3), (n,), (m,)), strict=True)
    ):
        raise InputError(
            f"{name} is not of these measures: expected mean destinations of {n} pixels among "
            f"{m}, finite; compute them for these measures with clmorph.barycentric_plan"
        )
    return value


def barycentric_plan(
    source: MeasureLike, target: MeasureLike, potentials: Potentials, *, backend: Backend = "auto"
) -> Barycentric:
    """Compute mean and covariance of the destination of every point, without storing the plan.

    No pair is pruned. If the potentials have a truncation, it applies here too.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)
        The measures of the potentials. Destinations have colors only between two images.
    potentials : Potentials
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Barycentric

    Raises
    ------
    InputError
        If an argument cannot be used, if points have more than 64 coordinates (a covariance has the
        square of that many numbers), or if the cost does not depend on all of color (because of
        the color weight or the metric), so that the mean destination does not determine the mean
        color.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = clmorph.lift(np.array([[0.0, 1.0], [0.0, 1.0]]), color_weight=2.0)
    >>> target = clmorph.lift(np.array([[1.0, 0.0], [1.0, 0.0]]), color_weight=2.0)
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.05, reach=0.3, backend="numpy")
    >>> clmorph.barycentric_plan(source, target, potentials, backend="numpy")
    <Barycentric of 4 points, mass 0.0633731>
    """
    pair = as_pair(source, target)
    dimension = pair[0].points.shape[1]
    if dimension > MAX_COVARIANCE:
        raise InputError(
            f"covariances of points have {dimension} x {dimension} numbers, expected at most "
            f"{MAX_COVARIANCE} coordinates; `Potentials.map` gives mean destinations alone"
        )
    to_colors = None
    if isinstance(source, Measure) and isinstance(target, Measure):
        to_colors = destination_colors(source, target)
    rows = RowsOfPlan(get_backend(backend), pair, potentials).checked()
    kind = potentials.epsilon, potentials.precise
    mean, covariance = rows.operations.plan_moments(
        *rows.clouds, potentials.g, rows.softmin, *kind, rows.near
    )
    return Barycentric(
        positions=mean[:, :2] if to_colors else mean,
        colors=to_colors(mean) if to_colors else mean[:, :0],
        covariance=covariance,
        row_mass=rows.mass,
        column_mass=rows.swapped().mass,
    )


def destination_colors(source: Measure, target: Measure) -> Callable[[Array], Array]:
    """Return the function from mean lifted destinations (K, D) to sRGB colors (K, 3)."""
    _, lifted = as_pair(source, target)
    # For every cost, lifted points are linear in the coordinates of colors.
    features = np.column_stack((lifted.points, np.ones(len(target))))
    linear, *_ = np.linalg.lstsq(features, target.coordinates)
    if np.abs(features @ linear - target.coordinates).max() > COLOR_ERROR:
        raise InputError(
            f"color_weight={target.color_weight:g} or the color metric leaves part of color out of "
            "the cost, so barycentric destinations have no mean color: expected a positive color "
            "weight and a metric of full rank; use small ones, or draws from the plan"
        )
    return lambda mean: from_space(mean @ linear[:-1] + linear[-1], target.color_space)
