"""The soft minimum between two clouds, as an object that remembers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.errors import InputError
from clmorph.operations import Operations

Array = NDArray[np.float64]


class Softmin:
    """T: potentials of the columns to soft minima over the rows (paper, section 3.1).

    Parameters
    ----------
    operations : Operations
    rows, columns
        Its clouds.
    """

    def __init__(self, operations: Operations, rows: Any, columns: Any) -> None:
        self.operations, self.rows, self.columns = operations, rows, columns

    def __call__(self, potential: Array, epsilon: float, precise: bool = False) -> Array:
        """Return T(potential), (N,) for (M,)."""
        return _finite(
            self.operations.softmin(self.rows, self.columns, potential, epsilon, precise)
        )


def _finite(softmin: Array) -> Array:
    """Return a softmin if it is finite; float32 ends before float64 does."""
    if np.all(np.isfinite(softmin)):
        return softmin
    raise InputError(
        "points are too far apart for this blur on this device, whose float32 overflows: raise "
        "blur, scale the points, or use backend='numpy'"
    )
