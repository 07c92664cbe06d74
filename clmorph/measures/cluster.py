"""Cells: nearby points of a measure taken together, as a coarser measure."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.measures.points import AnyMeasure, WeightedPoints

Array = NDArray[np.float64]

#: Keys of cells stay below this while coordinates are packed into them.
_LARGEST_KEY = 1 << 62


class Cells(NamedTuple):
    """A coarser measure, and which of its points each point belongs to.

    Attributes
    ----------
    measure : WeightedPoints
        The masses of the cells at their centers of mass. Within-cell spread is not added to the
        cost: what it costs on average is won back, to the second order and where the plan is as
        wide as the blur, by mass choosing where in the cell it goes.
    labels : (N,) array of int
        Cell of each point.
    """

    measure: WeightedPoints
    labels: NDArray[np.intp]

    def mean(self, values: Array, weights: Array) -> Array:
        """Return the mean of values over each cell, by mass: (N,) arrays to (cells,)."""
        return _means(self.labels, len(self.measure), values[:, None], weights)[:, 0]


def make_cells(measure: AnyMeasure, side: float) -> Cells:
    """Take the points of a measure together that share a cube of this side.

    Every cell is small, however few points it holds, unlike the leaves of a tree over equal
    numbers of points: where points are sparse each keeps its own cell.

    Parameters
    ----------
    measure : Measure or WeightedPoints
    side : float
        The points' unit.
    """
    points = measure.points
    corner = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    labels, size = np.zeros(len(points), np.int64), 1
    for column in corner.T:
        extent = int(column.max()) + 1
        if size * extent > _LARGEST_KEY:
            labels = np.unique(labels, return_inverse=True)[1]
            size = int(labels.max()) + 1
        labels, size = labels * extent + column, size * extent
    kept, labels = np.unique(labels, return_inverse=True)
    count = len(kept)
    offsets = np.zeros(len(points)) if measure.offsets is None else measure.offsets
    means = _means(labels, count, np.column_stack((points, offsets)), measure.weights)
    masses = np.bincount(labels, measure.weights, count).astype(float)
    whole = WeightedPoints(
        means[:, :-1], masses, None if measure.offsets is None else means[:, -1].copy()
    )
    return Cells(whole, labels)


def _means(labels: NDArray[np.intp], count: int, values: Array, weights: Array) -> Array:
    """Means of (N, k) values over cells, by mass; plain ones where there is none."""
    masses = np.bincount(labels, weights, count)
    share = np.divide(weights, masses[labels], out=np.zeros(len(labels)), where=weights > 0)
    empty = masses <= 0
    if empty.any():
        sizes = np.bincount(labels, minlength=count)
        share = np.where(empty[labels], 1.0 / sizes[labels], share)
    return np.column_stack([np.bincount(labels, share * column, count) for column in values.T])
