"""What operations return beside arrays, and the types of their arrays."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]


class PlanRows(NamedTuple):
    """Kept pairs of a plan, row after row, columns ascending inside a row."""

    indptr: NDArray[np.int64]  #: (N + 1,) where each row begins
    indices: NDArray[np.int32]  #: (kept,) column of each pair
    mass: Float64  #: (kept,) mass of each pair


class Bins(NamedTuple):
    """Particles sorted into square bins of the canvas and its margin."""

    shape: tuple[int, int]  #: bins along y and x, margins included
    starts: NDArray[np.int64]  #: (bins + 1,) where each bin begins in `order`
    order: NDArray[np.int64]  #: (K,) particles by bin; inside a bin in their own order


class NearPairs(NamedTuple):
    """The pairs of two clouds that matter, as `Operations.near_pairs` found them.

    What is left out is known: a row's sum over all columns is at most 1 + `skipped` times that
    over these pairs, for the potential and epsilon that they were found for.
    """

    pairs: Any  #: the backend's own
    softmin: Float64  #: (N,) T(g) over these pairs, or over some more; cost units
    skipped: Float64  #: (N,) above 0 where anything is left out
    n_pairs: int  #: pairs that are visited
    n_columns: int  #: most columns of a row
    largest: float  #: largest cost among them, cost units


class StoredPairs(NamedTuple):
    """Pairs of a plan that a backend keeps, see `Operations.store_pairs`."""

    pairs: Any  #: the backend's own
    n_pairs: int


def bin_grid(shape: tuple[int, int], margin: int, size: float) -> tuple[int, int]:
    """Return the number of bins along y and x for a canvas and its margin."""
    height, width = (int(-(-side // size)) + 2 * margin for side in shape)
    return height, width
