"""The entropic map: where a potential sends points that need not be points of the measures.

By duality, one potential g and the measure b that it belongs to are enough:

    T(x) = sum_j w_j(x) y_j,   w_j(x) ~ b_j exp((g_j - C(x, y_j)) / epsilon),   sum_j w_j(x) = 1,

because f_i only scales row i of the plan (Eq. 2 of the paper). At a point x_i of the source, T(x_i)
is the plan's barycentric projection; between them T is smooth, with the derivative
Cov_w(x)(y) / epsilon.

Source: Pooladian, Niles-Weed, "Entropic estimation of optimal transport maps" (2021), section 3.
"""

from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.arrays import as_floats
from clmorph.backends.interface import Operations
from clmorph.backends.rounding import rounding_error
from clmorph.errors import InputError
from clmorph.measures.measure import Measure
from clmorph.measures.points import MAX_COORDINATE, AnyMeasure, as_measure, as_measures

#: Points that are mapped at once.
CHUNK = 1 << 18
#: Nats of rounding in an exponent above which exponents are formed in more than float32.
ROUNDING = 1e-4


class Mapped(NamedTuple):
    """Points after an entropic map."""

    means: Array  #: (K, D) mean destinations T(x)
    softmins: Array  #: (K,) T(g)(x) = -epsilon log sum_j b_j exp((g_j - C(x, y_j)) / epsilon)


def entropic_map(
    points: Array,
    target: AnyMeasure,
    potential: Array,
    epsilon: float,
    operations: Operations,
    precise: bool = False,
) -> Mapped:
    """Map points (K, D), K may be 0, by the potential (M,) of a measure, a part at a time.

    Exponents are formed in more than float32 if `precise`, or if the points are so far from the
    target that float32 would round them by more than `ROUNDING`.
    """
    massive = target.points[target.weights > 0]
    low, high = massive.min(axis=0), massive.max(axis=0)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    centered = points - middle
    squares = np.square(centered).sum(axis=1)
    scales = _scales(np.sqrt(squares), radius)
    means, softmins = np.empty(points.shape), np.empty(len(points))
    for scale in np.unique(scales):
        columns = _scaled(target, middle, scale, operations)
        alike = np.flatnonzero(scales == scale)
        for start in range(0, len(alike), CHUNK):
            part = alike[start : start + CHUNK]
            rows = operations.upload(centered[part] / scale, np.ones(len(part)))
            distance = np.sqrt(squares[part].max()) / scale + scale * radius
            rounding = rounding_error(
                operations, len(target), 0.5 * distance**2 / epsilon, precise=False
            )
            options = epsilon, bool(precise or rounding > ROUNDING)
            found, mean = operations.barycentric_projection(rows, columns, potential, *options)
            if not (np.all(np.isfinite(found)) and np.all(np.isfinite(mean))):
                raise InputError(
                    "points are too far from the target for this blur on this device: leave "
                    "them out, or use backend='numpy'"
                )
            # A mean of the target's points lies among them, which rounding does not know.
            means[part] = np.clip(middle + mean / scale, low, high)
            softmins[part] = found + 0.5 * (1.0 - scale**-2) * squares[part]
    return Mapped(means, softmins)


def _scales(distances: Array, radius: float) -> Array:
    """Return the numbers by which points are divided while the target is multiplied by them.

    Means are rounded relative to the distance (K,) between points and target. C(x, y) / epsilon has
    no other mixed term than x.y / epsilon, which stays; the squares go into offsets. So both become
    equally large. Powers of 2 round nothing, and few of them occur.
    """
    far = (distances > radius) & (radius > 0)
    ratios = np.divide(distances, radius, out=np.ones(len(distances)), where=far)
    return np.asarray(2.0 ** np.ceil(0.5 * np.log2(ratios)))


def _scaled(target: AnyMeasure, middle: Array, scale: float, operations: Operations) -> Any:
    """Return the target around its middle as a cloud, multiplied by a number; see `_scales`."""
    centered, offsets = target.points - middle, target.offsets
    if scale != 1.0:
        more = 0.5 * (1.0 - scale**2) * np.square(centered).sum(axis=1)
        offsets = more if offsets is None else offsets + more
    return operations.upload(scale * centered, target.weights, offsets)


def as_places(points: Any, target: AnyMeasure) -> Array:
    """Return points that are to be mapped into a measure, as a (K, D) array."""
    if isinstance(points, AnyMeasure):
        if isinstance(points, Measure) and isinstance(target, Measure):
            return as_measures(points, target)[0].points
        places = as_measure("points", points).points
    else:
        places = as_floats("points", points, "coordinates (K, D)")
    dimension = target.points.shape[1]
    if places.ndim == 1 and dimension == 1:
        places = places[:, None]
    if places.ndim != 2 or places.shape[1] != dimension:
        raise InputError(
            f"points have shape {places.shape}: expected (K, {dimension}), in the coordinates of "
            "the measures' points"
        )
    if not np.all(np.abs(places) <= MAX_COORDINATE):
        raise InputError(
            f"points: expected finite coordinates within +-{MAX_COORDINATE:g}; remove missing ones"
        )
    return places
