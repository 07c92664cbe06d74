"""Weighted points that are not an image: any dimension up to 8, any unit."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph.errors import InputError
from clmorph.measures import Measure
from clmorph.operations import MAX_DIMENSION, MAX_POINTS

#: Largest coordinate, in the unit of blur and reach.
MAX_COORDINATE = 1e6


@dataclass(frozen=True, repr=False)
class WeightedPoints:
    """A sum of Diracs in R^D.

    Attributes
    ----------
    points : (N, D) array
    weights : (N,) array
        Masses, at least 0.
    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]

    def __repr__(self) -> str:
        return f"<{len(self)} WeightedPoints in {self.points.shape[1]}D, mass {self.mass:g}>"

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def mass(self) -> float:
        """Total mass."""
        return float(self.weights.sum())


#: What the solver transports.
AnyMeasure = Measure | WeightedPoints
#: What the public functions take: a measure, or (weights (N,), points (N, D) or (N,)).
MeasureLike = AnyMeasure | tuple[ArrayLike, ArrayLike]


def as_pair(source: Any, target: Any) -> tuple[AnyMeasure, AnyMeasure]:
    """Return two measures that live in one space.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights, points)

    Raises
    ------
    InputError
        If they are not, or do not.
    """
    pair = _as_measure("source", source), _as_measure("target", target)
    if isinstance(pair[0], Measure) and isinstance(pair[1], Measure):
        for name in ("color_weight", "extent"):
            ours, theirs = getattr(pair[0], name), getattr(pair[1], name)
            if ours != theirs:
                raise InputError(
                    f"source has {name}={ours!r}, target {theirs!r}: lift both with the same"
                )
    dimensions = pair[0].points.shape[1], pair[1].points.shape[1]
    if dimensions[0] != dimensions[1]:
        raise InputError(
            f"source has points in {dimensions[0]} dimensions, target in {dimensions[1]}: "
            "expected the same"
        )
    return pair


def _as_measure(name: str, value: Any) -> AnyMeasure:
    if isinstance(value, (Measure, WeightedPoints)):
        return value
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(
            f"{name} is a {type(value).__name__}: expected a Measure (clmorph.lift(image) makes "
            "one), or a pair (weights (N,), points (N, D))"
        )
    arrays = []
    for part, content in zip(("weights", "points"), value, strict=True):
        try:
            arrays.append(np.array(content, dtype=float))
        except (TypeError, ValueError):
            raise InputError(
                f"{name}: its {part} are no array of numbers; expected (weights (N,), points "
                "(N, D)), in this order"
            ) from None
    weights, points = arrays
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
    if not np.all(np.abs(points) <= MAX_COORDINATE):
        raise InputError(
            f"{name}: expected finite coordinates within +-{MAX_COORDINATE:g}; remove missing "
            "ones, and choose another unit for large ones"
        )
    with np.errstate(over="ignore"):
        total = weights.sum()
    if not (np.all(weights >= 0) and 1e-30 <= total <= 1e30):
        raise InputError(
            f"{name}: expected weights of at least 0 with a positive sum, from 1e-30 to 1e30; "
            "replace negative or missing ones by 0, and scale them"
        )
    return WeightedPoints(points, weights)
