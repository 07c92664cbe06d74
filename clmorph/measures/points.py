"""Weighted points that are not an image, in any dimension up to 1,024 and any unit; also many."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph._shared.printable import printable
from clmorph._shared.typing import Array, ArrayLike
from clmorph.backends.arrays import as_floats
from clmorph.backends.interface import MAX_DIMENSION, MAX_POINTS
from clmorph.errors import InputError
from clmorph.measures.grid import Grid, check_grid
from clmorph.measures.measure import Measure, check_masses, check_measure

#: Largest coordinate, in the unit of blur and reach.
MAX_COORDINATE = 1e6
#: What many measures are, in errors.
_EXPECTED = "stacked arrays (weights (B, N), points (B, N, D)), or a list of measures"


@dataclass(frozen=True, repr=False, eq=False)
class WeightedPoints:
    """The measure sum_i a_i delta_(X_i) of weighted points in R^D.

    Attributes
    ----------
    points : (N, D) array
        Finite coordinates in any unit, D from 1 to 1,024; `blur` and `reach` have the same unit.
        Any array that `clmorph.backends.arrays.as_array` takes.
    weights : (N,) array
        Masses a_i, at least 0, of positive sum.
    offsets : (N,) array, optional
        A cost for each point, which is added to the cost of all its pairs; cost units.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> clmorph.WeightedPoints(np.zeros((4, 2)), np.full(4, 0.25))
    <4 WeightedPoints in 2D, mass 1>
    """

    points: Array
    weights: Array
    offsets: Array | None = None

    def __repr__(self) -> str:
        return f"<{len(self)} WeightedPoints in {self.points.shape[1]}D, mass {self.mass:g}>"

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def mass(self) -> float:
        """Total mass."""
        return float(as_floats("weights", self.weights).sum())


#: The kinds of measure that the solver takes.
AnyMeasure = Measure | WeightedPoints | Grid
#: The source and the target of a problem.
Pair = tuple[AnyMeasure, AnyMeasure]
#: Argument of the public functions: a measure, (weights (N,), points (N, D) or (N,)), or points
#: alone, an array, whose weights are then 1 / N.
MeasureLike = AnyMeasure | tuple[ArrayLike, ArrayLike] | ArrayLike


def as_pair(source: Any, target: Any) -> Pair:
    """Return two measures with points in one space.

    Their cost is C_ij = |X_i - Y_j|^2 / 2 (paper, Eq. 1 with the factor 1/2), plus the offsets r_i
    and s_j if the measures have offsets.
    """
    pair = as_measures(source, target)
    if isinstance(pair[0], Measure) and isinstance(pair[1], Measure) and pair[0].has_metric_map:
        return _bilinear(pair[0], pair[1])
    return pair


def as_measures(source: Any, target: Any) -> Pair:
    """Return two checked measures that can be compared, without the lift of `as_pair`."""
    pair = as_measure("source", source), as_measure("target", target)
    if isinstance(pair[0], Measure) and isinstance(pair[1], Measure):
        for name in ("color_weight", "extent", "color_space"):
            ours, theirs = getattr(pair[0], name), getattr(pair[1], name)
            if ours != theirs:
                raise InputError(
                    f"source has {name}={ours!r}, target {theirs!r}: lift both with the same"
                )
        ours, theirs = pair[0].color_metric, pair[1].color_metric
        alike = ours is theirs if ours is None or theirs is None else np.array_equal(ours, theirs)
        if pair[1].has_metric_map or not (alike or (pair[0].has_metric_map and theirs is None)):
            raise InputError(
                "source and target have different color metrics: lift both with the same "
                "matrix, or the source alone with a map of them"
            )
        if pair[0].has_metric_map:
            return pair
    dimensions = dimension_of(pair[0]), dimension_of(pair[1])
    if dimensions[0] != dimensions[1]:
        raise InputError(
            f"source has points in {dimensions[0]} dimensions, target in {dimensions[1]}: "
            "expected the same"
        )
    return pair


def are_equal(one: AnyMeasure, other: AnyMeasure) -> bool:
    """Return whether two measures have the same points, weights and offsets."""
    names = ["weights", "offsets", "points"]
    if isinstance(one, Grid) and isinstance(other, Grid):
        names.remove("points")  # they are many more numbers than the axes
        if one.shape != other.shape or not all(map(np.array_equal, one.axes, other.axes)):
            return False
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def dimension_of(measure: AnyMeasure) -> int:
    """Return the dimension of a measure's points."""
    return measure.dimension if isinstance(measure, Grid) else measure.points.shape[1]


def corners_of(measure: AnyMeasure) -> Array:
    """Return points, (K, D), whose bounding box is that of the measure."""
    return measure.corners if isinstance(measure, Grid) else measure.points


def _bilinear(source: Measure, target: Measure) -> tuple[WeightedPoints, WeightedPoints]:
    """Lift a cost whose metric of color depends on the source pixel (paper, section 5).

    |c - d|^2_M / 2 = c^T M c / 2 - (M c)^T d + sum_k M_kk d_k^2 / 2 + sum_(k<l) M_kl d_k d_l is
    a sum of products of one number of the source pixel and one of the target pixel.
    With these nine numbers as coordinates of colors, C_ij = |X_i - Y_j|^2 / 2 + r_i + s_j.
    """
    c, d = (measure.color_weight * measure.coordinates for measure in (source, target))
    # Distances do not depend on the origin of colors, but products do. A central origin makes the
    # products small, so float32 rounds them by less.
    middle = 0.5 * (c.mean(axis=0) + d.mean(axis=0))
    c, d = c - middle, d - middle
    metric = source.color_metric
    assert metric is not None  # the caller has checked that there is a map
    k, m = np.triu_indices(3)
    mc = np.einsum("nkl,nl->nk", metric, c)
    ours = np.column_stack((mc, -np.where(k == m, 0.5, 1.0) * metric[:, k, m]))
    theirs = np.column_stack((d, d[:, k] * d[:, m]))
    # Terms that are the same for every source pixel go into the offsets of the target.
    common = ours.mean(axis=0)
    ours = ours - common
    sizes = [np.sqrt(np.mean(features**2, axis=0)) for features in (ours, theirs)]
    matters = (sizes[0] > 0) & (sizes[1] > 0)
    scale = np.zeros(len(common))
    np.divide(sizes[1], sizes[0], out=scale, where=matters)
    scale = np.sqrt(scale)
    x = np.column_stack((source.positions, ours * scale))
    y = np.column_stack((target.positions, theirs / np.where(matters, scale, np.inf)))
    r = 0.5 * (np.sum(source.positions**2, axis=1) + np.sum(mc * c, axis=1) - np.sum(x**2, axis=1))
    s = 0.5 * (np.sum(target.positions**2, axis=1) - np.sum(y**2, axis=1)) - theirs @ common
    return WeightedPoints(x, source.weights, r), WeightedPoints(y, target.weights, s)


def as_measure(name: str, value: Any) -> AnyMeasure:
    """Return a usable measure unchanged, or one of (weights, points) or of points alone."""
    if isinstance(value, Measure):
        check_measure(name, value)
        return value
    if isinstance(value, Grid):
        return check_grid(name, value)
    if isinstance(value, WeightedPoints):
        made = _weighted_points(name, value.weights, value.points, value.offsets)
        ours = [each for each in (value.weights, value.points, value.offsets) if each is not None]
        # The solver can use such arrays without conversion.
        plain = all(type(each) is np.ndarray and each.dtype == np.float64 for each in ours)
        return value if plain else made
    shape = getattr(value, "shape", None)
    # Some libraries have a type of their own for shapes.
    sides = tuple(shape) if isinstance(shape, Iterable) else None
    if isinstance(value, (tuple, list)):
        if len(value) == 2:
            return _weighted_points(name, *value)
    elif sides and sides[0] and len(sides) <= 2:
        return _weighted_points(name, _ALIKE, value)
    of = "" if sides is None else f" of shape {sides}"
    raise InputError(
        f"{name} is a {type(value).__name__}{of}: expected a Measure (clmorph.lift(image) "
        "makes one), a pair (weights (N,), points (N, D)), or an array of points (N, D)"
    )


def as_image_measure(name: str, value: Any, why: str, instead: str = "") -> Measure:
    """Return a measure that must be a lifted image; `why` and `instead` explain it in errors."""
    if not isinstance(value, Measure):
        raise InputError(
            f"{name} is a {type(value).__name__}: expected a Measure, as {why}; make one with "
            f"clmorph.lift(image){instead}"
        )
    check_measure(name, value)
    return value


#: In place of weights: 1 / N for each point.
_ALIKE = object()


def _weighted_points(name: str, weights: Any, points: Any, offsets: Any = None) -> WeightedPoints:
    """Check arrays and return them as weighted points."""
    expected = "points (N, D)"
    if weights is not _ALIKE:
        expected = f"weights (N,) and {expected}, in this order"
        weights = as_floats(f"{name}: its weights", weights, expected)
    points = as_floats(f"{name}: its points", points, expected)
    if weights is _ALIKE:
        weights = np.ones(points.shape[:1])
        weights /= max(1, weights.size)
    if offsets is not None:
        offsets = as_floats(f"{name}: its offsets", offsets, "one cost for each point, (N,)")
    if points.ndim == 1:
        points = points[:, None]
    if weights.ndim != 1 or points.ndim != 2 or len(weights) != len(points) or not len(weights):
        raise InputError(
            f"{name}: weights have shape {weights.shape}, points {points.shape}; expected (N,) "
            "and (N, D) with N > 0, in this order"
        )
    if not 1 <= points.shape[1] <= MAX_DIMENSION or len(points) > MAX_POINTS:
        raise InputError(
            f"{name} has {len(points)} points in {points.shape[1]} dimensions: expected at most "
            f"{MAX_POINTS} points in 1 to {MAX_DIMENSION} dimensions"
        )
    far = points[~(np.abs(points) <= MAX_COORDINATE)]
    if far.size:
        raise InputError(
            f"{name}: a coordinate is {far[0]:g}; expected finite coordinates within "
            f"+-{MAX_COORDINATE:g}: remove missing ones, and choose another unit for large ones"
        )
    check_masses(f"{name}: its weights", weights)
    if offsets is not None and (
        offsets.shape != weights.shape or not np.all(np.abs(offsets) <= MAX_COORDINATE**2)
    ):
        raise InputError(
            f"{name}: its offsets have shape {offsets.shape}: expected {weights.shape}, finite "
            f"and within +-{MAX_COORDINATE**2:g}"
        )
    return WeightedPoints(points, weights, offsets)


class Checked(list[WeightedPoints]):
    """Measures that need no further check, all of one dimension."""


def as_many(name: str, value: Any) -> list[Any]:
    """Return measures, or what is given for each; stacked arrays become a `Checked` list."""
    if isinstance(value, tuple) and len(value) == 2 and all(map(_is_array, value)):
        return _unstacked(name, *value)
    foreign = isinstance(value, str | bytes | Mapping | AnyMeasure)
    if foreign or _is_array(value) or not isinstance(value, Iterable):
        raise InputError(f"{name} is a {type(value).__name__}: expected {_EXPECTED}")
    try:
        return list(value)
    except Exception as error:
        # Foreign types can raise any exception.
        reason = printable(str(error) or type(error).__name__, 120)
        raise InputError(f"{name} cannot be read ({reason}): expected {_EXPECTED}") from None


def _is_array(value: Any) -> bool:
    return hasattr(value, "shape") and not isinstance(value, AnyMeasure)


def _unstacked(name: str, weights: Any, points: Any) -> Checked:
    """Return the measures of stacked arrays, checked at once."""
    weights = as_floats(f"{name}: its weights", weights, _EXPECTED)
    points = as_floats(f"{name}: its points", points, _EXPECTED)
    if weights.ndim == points.ndim == 2:
        points = points[:, :, None]
    if weights.ndim != 2 or points.ndim != 3 or weights.shape != points.shape[:2]:
        raise InputError(
            f"{name}: weights have shape {weights.shape}, points {points.shape}; expected (B, N) "
            "and (B, N, D), or a list of measures"
        )
    with np.errstate(over="ignore"):
        totals = weights.sum(axis=1)
    usable = bool(np.all(weights >= 0) and np.all((totals >= 1e-30) & (totals <= 1e30)))
    usable = usable and bool(np.all(np.abs(points) <= MAX_COORDINATE)) and weights.shape[1] > 0
    usable = usable and 1 <= points.shape[2] <= MAX_DIMENSION
    pairs = zip(weights, points, strict=True)
    if not usable:
        # The message names the first measure that is wrong, and what is wrong with it.
        for number, pair in enumerate(pairs):
            as_measure(f"{name}[{number}]", pair)
    return Checked(WeightedPoints(own_points, own_weights) for own_weights, own_points in pairs)
