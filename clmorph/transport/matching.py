"""The cheapest assignment of points to points, certified: `clmorph.assignment`."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph._shared.progress import Share
from clmorph._shared.typing import Array, ArrayLike, Progress
from clmorph._shared.validation import check_integer, check_number, check_progress
from clmorph.backends.arrays import as_floats
from clmorph.backends.interface import MAX_DIMENSION, Operations
from clmorph.backends.multi_device import for_one_solve
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.measures.measure import check_masses
from clmorph.measures.points import as_measure
from clmorph.transport.assignment_search import FEW_PAIRS, Solution, solved
from clmorph.transport.pair_costs import Costs, Indices
from clmorph.transport.regularization import regularization
from clmorph.transport.sinkhorn import solve

#: epsilon of the entropic start, relative to the mean cost of all pairs; its tolerance, the largest
#: number of its iterations, and nats that pairs left out may change.
EPSILON, TOLERANCE, ITERATIONS, TRUNCATION = 3e-3, 0.2, 300, 0.1
#: epsilon of plans from which candidates are drawn, in the same unit.
DRAWN = 1e-3
#: Pairs from which leaving some out hastens that, and so do coarser problems up to this dimension.
LARGE, FLAT = 1 << 23, 3
#: Points left over, for each one that is assigned, with which prices begin at 0 instead.
SPARE = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class Assignment:
    """Points assigned to points, and the proof that no other assignment costs much less.

    Attributes
    ----------
    rows, columns : (K,) arrays of int
        Point ``x[rows[k]]`` is assigned to ``y[columns[k]]``; rows ascend, and K is the smaller
        number of points, as in `scipy.optimize.linear_sum_assignment`.
    cost : float
        Sum over the rows of weight times half the squared distance.
    bound : float
        No assignment has a lower cost.
    prices : ((N,) array, (M,) array)
        f and g with f_i + g_j <= w_i |x_i - y_j|^2 / 2 for all pairs, which prove the bound: it is
        the sum of all f and g, less the rounding of this sum. Points of the larger cloud have
        prices of at most 0, but for rounding.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> found = clmorph.assignment(np.array([0.0, 1.0]), np.array([1.5, 0.5]), backend="numpy")
    >>> found.columns.tolist(), round(found.cost, 6), round(found.gap, 6)
    ([1, 0], 0.125, 0.0)
    """

    rows: Indices
    columns: Indices
    cost: float
    bound: float
    prices: tuple[Array, Array]

    def __repr__(self) -> str:
        return f"<Assignment of {len(self.rows)} points, cost {self.cost:.6g}, gap {self.gap:.1e}>"

    @property
    def gap(self) -> float:
        """Proven share of the bound by which the cost exceeds the cheapest one at most."""
        above = self.cost - self.bound
        return above / self.bound if self.bound > 0 else (np.inf if above > 0 else 0.0)


def assignment(
    x: ArrayLike,
    y: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    gap: float = 0.0,
    seed: int = 0,
    backend: Backend = "auto",
    progress: Progress | None = None,
) -> Assignment:
    """Assign points to points one to one, so that the sum of half squared distances is least.

    Parameters
    ----------
    x, y : (N, D) and (M, D) arrays, or (N,) and (M,)
        If there are fewer points of one cloud, all of these are assigned, to different points of
        the other one.
    weights : (N,) array, optional
        How much the cost of each point of x counts, at least 0; 1 / K each by default, with the
        smaller number of points K, so that the cost is a mean. They need N <= M.
    gap : float
        Share of the bound by which the cost may exceed it. 0 asks for the cheapest assignment: its
        cost is that of `scipy.optimize.linear_sum_assignment`, to the rounding of float64.
    seed : int
        Seed of draws of pairs, where there are more than 2^27 and the gap is above 0.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`. The device solves the entropic problem at whose potentials
        the search begins.
    progress : callable, optional
        A function that is called with the share of the work that is done, from 0 to 1.

    Returns
    -------
    Assignment

    Raises
    ------
    InputError
        If an argument cannot be used.

    Warns
    -----
    ConvergenceWarning
        If the gap is not reached; the result is what was found, and its bound is proven.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> rng = np.random.default_rng(0)
    >>> x, y = rng.random((100, 2)), rng.random((150, 2))
    >>> found = clmorph.assignment(x, y, backend="numpy")
    >>> from scipy.optimize import linear_sum_assignment
    >>> from scipy.spatial.distance import cdist
    >>> costs = cdist(x, y, "sqeuclidean") / 2 / 100
    >>> bool(np.isclose(found.cost, costs[linear_sum_assignment(costs)].sum(), rtol=1e-12))
    True
    >>> bool(np.all(found.prices[0][:, None] + found.prices[1] <= costs + 1e-12))
    True
    """
    gap = check_number("gap", gap, 0.0, 1e3)
    seed = check_integer("seed", seed, 0, 2**32 - 1)
    report = check_progress(progress)
    clouds = _points("x", x), _points("y", y)
    dimensions = clouds[0].shape[1], clouds[1].shape[1]
    if dimensions[0] != dimensions[1]:
        raise InputError(
            f"x has points in {dimensions[0]} dimensions, y in {dimensions[1]}: expected the same"
        )
    swapped = len(clouds[0]) > len(clouds[1])
    shares = None if weights is None else _weights(weights, len(clouds[0]), swapped)
    lifted = shares is not None or len(clouds[0]) != len(clouds[1])
    if lifted and dimensions[0] >= MAX_DIMENSION:
        raise InputError(
            f"x and y have {dimensions[0]} coordinates: with weights, or different numbers of "
            f"points, expected at most {MAX_DIMENSION - 1}"
        )
    # Costs are formed from differences of points, in their mean cost's unit.
    first, second = clouds[::-1] if swapped else clouds
    mean = 1.0 if shares is None else float(shares.mean())
    costs = Costs(first, second, None if shares is None else shares / mean)
    operations = for_one_solve(get_backend(backend))
    found = certified(costs, gap, operations, seed, report)
    unit = mean if shares is not None else 1.0 / len(first)
    f, g = (unit * each for each in found.prices)
    rows, columns = np.arange(len(first)), found.columns
    if swapped:
        columns = np.argsort(found.columns)
        rows, f, g = found.columns[columns], g, f
    warn_unless_reached(found, gap)
    return Assignment(rows, columns, unit * found.cost, unit * found.bound, (f, g))


def certified(
    costs: Costs, gap: float, operations: Operations, seed: int, report: Progress
) -> Solution:
    """Return an assignment from an entropic start; the parameters are checked ones."""
    if costs.spare or costs.weights is not None:
        return _scaled(costs, gap, 0.0, operations, seed, report)
    # With t = mean(x) - mean(y), costs are those of clouds around one point, plus t . (x - y) less
    # what they are at both means: the best assignment is the same, whatever t is.
    means = costs.x.mean(axis=0), costs.y.mean(axis=0)
    x, y, t = costs.x - means[0], costs.y - means[1], means[0] - means[1]
    constant = len(x) * float(t @ t) / 2
    found = _scaled(Costs(x, y), gap, constant, operations, seed, report)
    f, g = found.prices
    own = np.arange(len(x))
    cost = float(costs.of_pairs(own, found.columns).sum())
    bound = found.bound + constant
    bound -= 16 * np.finfo(float).eps * (np.abs(x @ t).sum() + np.abs(y @ t).sum() + bound)
    return found._replace(
        prices=(f + x @ t + t @ t / 2, g - y @ t),
        cost=cost,
        bound=float(min(max(bound, 0.0), cost)),
    )


def _scaled(
    costs: Costs, gap: float, constant: float, operations: Operations, seed: int, report: Progress
) -> Solution:
    """Solve in units of the mean cost, so that lengths of any size can be used."""
    scale = costs.scale
    g = np.zeros(len(costs.y))
    if scale <= 0 or len(costs.x) * len(costs.y) <= FEW_PAIRS:
        return solved(costs, g, scale, gap, seed, report, constant=constant)
    unit = Costs(costs.x / scale**0.5, costs.y / scale**0.5, costs.weights)
    line = unit.x.shape[1] == 1 and not unit.spare and unit.weights is None
    prices, start = _in_order(unit) if line else (None, None)
    large = len(unit.x) * len(unit.y) >= LARGE
    coarse = large and unit.x.shape[1] <= FLAT
    if prices is None and unit.spare < SPARE * len(unit.x):
        prices = solve(
            operations, unit.measures(),
            regularization(EPSILON**0.5, tol=TOLERANCE, max_iter=ITERATIONS, precision="float32"),
            lambda share: report(Share(0.3 * share, "prices")),
            truncation=TRUNCATION if large else "auto", multiscale=coarse or "auto",
        ).g  # fmt: skip
    elif prices is None:
        prices = g  # most points of the larger cloud are left, whose prices are 0
    found = solved(
        unit, prices, EPSILON, gap, seed,
        lambda share: report(Share(0.3 + 0.7 * share, getattr(share, "note", ""))), start,
        constant / scale, operations, DRAWN,
    )  # fmt: skip
    f, g = (scale * each for each in found.prices)
    return Solution(found.columns, (f, g), scale * found.cost, scale * found.bound, found.reached)


def _in_order(costs: Costs) -> tuple[Array, Indices]:
    """Return prices and the cheapest assignment of points of a line, which keeps their order.

    With C = (x - y)^2 / 2, g = y^2 / 2 less a convex function, whose slope between two columns is
    between the points of their rows.
    """
    x, y = costs.x[:, 0], costs.y[:, 0]
    rows, columns = np.argsort(x, kind="stable"), np.argsort(y, kind="stable")
    slopes = (x[rows][1:] + x[rows][:-1]) / 2
    g, start = np.empty(len(y)), np.empty(len(x), np.intp)
    g[columns] = np.square(y[columns]) / 2 - np.append(0.0, np.cumsum(slopes * np.diff(y[columns])))
    start[rows] = columns
    return g, start


def warn_unless_reached(found: Solution, gap: float) -> None:
    """Warn the caller of a public function, which calls this itself, if a gap was not reached."""
    if not found.reached:
        warnings.warn(
            f"the cost is proven to be at most {found.gap:.3%} above the cheapest one, which is "
            f"more than the gap of {gap:.3%} that was asked for: give a larger gap",
            ConvergenceWarning,
            stacklevel=3,
        )


def _points(name: str, value: Any) -> Array:
    """Return checked points, (N, D)."""
    points = as_floats(name, value, "points (N, D)")
    if points.ndim not in (1, 2) or not points.size:
        raise InputError(f"{name} has shape {points.shape}: expected points (N, D) with N > 0")
    return as_measure(name, (np.ones(len(points)), points)).points


def _weights(value: Any, count: int, swapped: bool) -> Array:
    weights = as_floats("weights", value, "one number for each point of x, (N,)")
    if weights.shape != (count,):
        raise InputError(f"weights have shape {weights.shape}: expected ({count},)")
    check_masses("weights", weights)
    if swapped:
        raise InputError("weights need at least as many points in y as in x")
    return weights
