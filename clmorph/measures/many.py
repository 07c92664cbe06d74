"""Many measures in one argument: a list of them, or stacked arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from clmorph._shared.printable import printable
from clmorph.backends.arrays import as_floats
from clmorph.backends.interface import MAX_DIMENSION
from clmorph.errors import InputError
from clmorph.measures.grid import Grid
from clmorph.measures.measure import Measure
from clmorph.measures.points import MAX_COORDINATE, WeightedPoints, as_measure

_EXPECTED = "stacked arrays (weights (B, N), points (B, N, D)), or a list of measures"


class Checked(list[WeightedPoints]):
    """Measures that need no further check, all of one dimension."""


def as_many(name: str, value: Any) -> list[Any]:
    """Return measures, or what is given for each; stacked arrays become a `Checked` list."""
    if isinstance(value, tuple) and len(value) == 2 and all(map(_is_array, value)):
        return _unstacked(name, *value)
    foreign = isinstance(value, str | bytes | Mapping | Measure | WeightedPoints | Grid)
    if foreign or _is_array(value) or not isinstance(value, Iterable):
        what = printable(type(value).__name__)
        raise InputError(f"{name} is a {what}: expected {_EXPECTED}")
    try:
        return list(value)
    except Exception as error:
        # Foreign types can raise any exception.
        reason = printable(str(error) or type(error).__name__, 120)
        raise InputError(f"{name} cannot be read ({reason}): expected {_EXPECTED}") from None


def _is_array(value: Any) -> bool:
    return hasattr(value, "shape") and not isinstance(value, Measure | WeightedPoints | Grid)


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
