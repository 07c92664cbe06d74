"""The barycenter of measures: the entrance to both algorithms."""

from __future__ import annotations

from typing import Any

import numpy as np

from clmorph._shared.typing import Array, ArrayLike, IntArray, Progress
from clmorph._shared.validation import check_flag, check_integer, check_progress, shown
from clmorph.backends.arrays import as_floats
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.grid import Grid, are_grids
from clmorph.measures.points import (
    AnyMeasure,
    MeasureLike,
    WeightedPoints,
    as_many,
    as_measure,
    as_measures,
    dimension_of,
)
from clmorph.transport._solver.problem import check_problem
from clmorph.transport.barycenters.fixed_support import fixed_support
from clmorph.transport.barycenters.free_support import free_support
from clmorph.transport.barycenters.result import Barycenter, BarycenterProblem, Call
from clmorph.transport.divergence import check_symmetric, one_regularization
from clmorph.transport.options import SolverOptions
from clmorph.transport.sinkhorn import warn_unless_converged

#: Largest number of iterations, unless the user says it: with a free and with a fixed support.
FREE_ITERATIONS, FIXED_ITERATIONS = 200, 2000


def barycenter(
    measures: Any,
    weights: ArrayLike | None = None,
    support: int | ArrayLike | MeasureLike | None = None,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
    max_iter: int | None = None,
    backend: Backend = "auto",
    *,
    fixed: bool = False,
    debias: bool = True,
    epsilon: float | None = None,
    rho: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Barycenter:
    """Return the barycenter of several measures: the measure with the least mean divergence.

    It minimizes sum_k w_k S(a, b_k), where S is the Sinkhorn divergence of
    `clmorph.sinkhorn_divergence`, or what `debias` says. By default the points of the barycenter
    move; if `fixed`, they stay and their masses are found.

    Parameters
    ----------
    measures : sequence of Measure, WeightedPoints, or (weights (N,), points (N, D))
        Or stacked arrays (weights (K, N), points (K, N, D)). For balanced transport their masses
        must be equal.
    weights : (K,) array, optional
        Share of each measure, at least 0; shares are scaled to the sum 1 and equal by default. A
        measure with the share 0 has no influence.
    support : int, (N, D) array, measure, or (weights (N,), points (N, D)), optional
        Of a free support the number of points, which begin at means of random draws from all
        measures, or with a reach at draws from their mixture; or the points with which the
        iteration begins, with their masses if it is a measure; by default as many points as the
        largest measure has. Of a fixed support the points; their masses do not matter. Between
        grids a fixed support may be a grid, whose mask counts, and is that of the first measure by
        default.
    blur, epsilon
        As in `clmorph.sinkhorn`.
    reach : float or None
        As in `clmorph.sinkhorn`, but one number for both sides. With a reach, masses of the
        measures may differ, and the masses of the points change as the optimum demands. None is
        balanced transport, in which points of a free support keep their masses.
    tol : float
        Residual at which the iteration stops, see `Barycenter`.
    max_iter : int, optional
        Largest number of iterations; by default 200 with a free support, each with a solve for each
        measure, and 2000 with a fixed one.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    fixed : bool
        Whether the points of the support stay.
    debias : bool
        Whether S is minimized. False minimizes the transport value OT itself on a free support,
        which is then too narrow. On a fixed one it is the usual entropic barycenter: OT with the
        entropy relative to even masses on the support, of the measures' mean mass, in place of a,
        as in other libraries. That is not the OT of `clmorph.sinkhorn`, which would be least for
        masses at few points; it is blurred by about blur. With a reach its mass depends on the
        extent of the support.
    rho : float, optional
        reach^2, in place of `reach`; infinity is balanced.
    seed : int
        Seed of the random draws of points.
    progress : callable, optional
        A function that is called with the share of the work that is done, from 0 to 1.

    Returns
    -------
    Barycenter

    Raises
    ------
    InputError
        If an argument cannot be used, or masses differ and `reach` is None.

    Warns
    -----
    ConvergenceWarning
        If the residual does not reach `tol`.

    Notes
    -----
    F(a) = sum_k w_k S(a, b_k) is convex in the masses but not in the points, so that a free support
    finds a minimum near the points with which it begins.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> x = np.linspace(-1, 1, 81)[:, None]
    >>> bells = [(np.exp(-0.5 * ((x[:, 0] - m) / s) ** 2), x) for m, s in ((-0.4, 0.1), (0.4, 0.2))]
    >>> bells = [(a / a.sum(), x) for a, x in bells]
    >>> found = clmorph.barycenter(bells, support=x, fixed=True, blur=0.05, backend="numpy")
    >>> mean = found.weights @ x[:, 0]
    >>> width = np.sqrt(found.weights @ (x[:, 0] - mean) ** 2)
    >>> abs(round(float(mean), 3)), round(float(width), 2)
    (0.0, 0.15)
    """
    call = checked_call(blur, reach, epsilon, rho, tol, max_iter, fixed, debias, seed)
    report = check_progress(progress)
    problem = prepared(measures, weights, support, call)
    operations = get_backend(backend)
    for first in (problem.measures[0], problem.start):
        for each in problem.measures:
            check_problem((first, each), call.goal._replace(tol=np.inf), operations)
    found = (fixed_support if fixed else free_support)(problem, call, operations, report)
    warn_unless_converged(
        found.status,
        f"barycenter: residual {found.residual:.1e} after {found.n_iter} iterations, above the "
        f"tolerance {call.goal.tol:g}; raise max_iter, tol or blur",
    )
    return found


def checked_call(
    blur: Any, reach: Any, epsilon: Any, rho: Any, tol: Any, max_iter: Any, fixed: Any,
    debias: Any, seed: Any,
) -> Call:  # fmt: skip
    """Return the checked options of `barycenter`, which are its parameters."""
    fixed, debias = check_flag("fixed", fixed), check_flag("debias", debias)
    most = (FIXED_ITERATIONS if fixed else FREE_ITERATIONS) if max_iter is None else max_iter
    goal = one_regularization(blur, reach, epsilon, rho, tol, most)
    return Call(goal, fixed, debias, check_integer("seed", seed, 0, 2**63))


def prepared(measures: Any, weights: Any, support: Any, call: Call) -> BarycenterProblem:
    """Return the checked measures, shares and support of `barycenter`."""
    whole = _checked(measures)
    shares = _shares(weights, len(whole))
    # A share that float64 cannot tell from 0 would divide 0 by 0.
    shown_ones = [k for k, share in enumerate(shares) if share > 0]
    used, parts = [whole[k] for k in shown_ones], [float(shares[k]) for k in shown_ones]
    mass = float(np.dot(parts, [each.weights.sum() for each in used]))
    if call.fixed:
        return BarycenterProblem(used, parts, _fixed_start(support, used, mass))
    return BarycenterProblem(used, parts, _free_start(support, used, parts, mass, call))


def _checked(measures: Any) -> list[AnyMeasure]:
    """Return measures that can be compared with one another."""
    found = [
        as_measure(f"measures[{k}]", each) for k, each in enumerate(as_many("measures", measures))
    ]
    if not found:
        raise InputError("measures: the list is empty; expected at least one")
    check_symmetric(*found)
    for each in found[1:]:
        as_measures(found[0], each)
    return found


def _shares(weights: Any, count: int) -> Array:
    """Return the shares of measures, with the sum 1."""
    if weights is None:
        return np.full(count, 1.0 / count)
    found = as_floats("weights", weights, "a share for each measure")
    if found.shape != (count,):
        raise InputError(
            f"weights have shape {found.shape}: expected ({count},), one for each measure"
        )
    largest = found.max()
    if not np.all(np.isfinite(found)) or found.min() < 0 or largest <= 0:
        raise InputError("weights: expected finite shares of at least 0, not all 0")
    found = found / largest
    return np.asarray(found / found.sum())


def _free_start(
    support: Any, measures: list[AnyMeasure], shares: list[float], mass: float, call: Call
) -> WeightedPoints:
    """Return the points with which the iteration begins."""
    if support is None or isinstance(support, int | np.integer):
        count = max(map(len, measures))
        if support is not None:
            count = check_integer("support", support, 1, 1 << 24)
        chosen = _means if np.isinf(call.goal.rho[0]) else _drawn
        points = chosen(measures, shares, count, call.seed)
        return WeightedPoints(points, np.full(count, mass / count))
    return _as_points(support, mass, measures[0])


def _means(measures: list[AnyMeasure], shares: list[float], count: int, seed: int) -> Array:
    """Return points, each the mean of one draw from each measure, weighted by the shares."""
    rng = np.random.default_rng(seed)
    points = np.zeros((count, measures[0].points.shape[1]))
    for measure, share in zip(measures, shares, strict=True):
        points += share * measure.points[rng.permutation(_chosen(measure.weights, count, rng))]
    return points


def _drawn(measures: list[AnyMeasure], shares: list[float], count: int, seed: int) -> Array:
    """Return points drawn from the mixture of measures, so that none is beyond the reach of all."""
    weights = [share * each.weights for each, share in zip(measures, shares, strict=True)]
    chosen = _chosen(np.concatenate(weights), count, np.random.default_rng(seed))
    return np.concatenate([measure.points for measure in measures])[chosen]


def _chosen(weights: Array, count: int, rng: np.random.Generator) -> IntArray:
    """Draw points by their weights, one from each of equal parts of the mass."""
    sums = np.cumsum(weights)
    wanted = (np.arange(count) + rng.random(count)) / count * sums[-1]
    # A point without mass is never the first that exceeds a sum.
    return np.minimum(np.searchsorted(sums, wanted, side="right"), np.flatnonzero(weights)[-1])


def _fixed_start(support: Any, measures: list[AnyMeasure], mass: float) -> WeightedPoints | Grid:
    """Return a fixed support with even masses; of grids that of the first one by default."""
    if are_grids(*measures) and (support is None or isinstance(support, Grid)):
        grid = as_measure("support", measures[0] if support is None else support)
        assert isinstance(grid, Grid)
        _check_dimension(grid, measures[0])
        inside = np.ones(grid.shape) if grid.mask is None else grid.mask.astype(float)
        return grid.with_masses(inside * (mass / inside.sum()))
    if support is None or isinstance(support, int | np.integer):
        raise InputError(
            f"support={shown(support)}: a fixed support needs its points, such as those of a grid"
        )
    found = _as_points(support, 1.0, measures[0])
    return WeightedPoints(found.points, np.full(len(found), mass / len(found)))


def _as_points(support: Any, mass: float, like: AnyMeasure) -> WeightedPoints:
    """Return points, or a measure, as weighted points; points alone have equal masses."""
    if not isinstance(support, AnyMeasure | tuple):
        points = as_floats("support", support, "points (N, D)")
        count = max(1, len(points) if points.ndim else 1)
        support = (np.full(count, mass / count), points)
    found = as_measure("support", support)
    _check_dimension(found, like)
    return WeightedPoints(found.points, found.weights)


def _check_dimension(support: AnyMeasure, measure: AnyMeasure) -> None:
    ours, theirs = dimension_of(support), dimension_of(measure)
    if ours != theirs:
        raise InputError(
            f"support has points in {ours} dimensions, the measures in {theirs}: expected the same"
        )
