"""Clusters of nearby points of a measure, which form a coarser measure."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.boxes import boxes_of_runs
from clmorph._shared.typing import Array
from clmorph.measures.points import AnyMeasure, WeightedPoints

#: Bound of the integer keys into which the coordinates of cubes are packed.
_LARGEST_KEY = 1 << 62
#: Up to this many possible cubes for each point, a table of them is formed.
_TABLE_SHARE = 8


class Clusters(NamedTuple):
    """A coarser measure, and the index of the cluster to which each point belongs."""

    #: The masses of the clusters at their centers of mass. The spread of points inside a cluster is
    #: not added to the cost. Mass is free to choose where in a cluster it goes, and where the plan
    #: is as wide as the blur this balances the spread to the second order.
    measure: WeightedPoints
    #: Index of the cluster of each point: (N,) array.
    labels: NDArray[np.intp]

    def restrict(self, values: Array, weights: Array) -> Array:
        """Return the mean of values (N,) over each cluster, by mass (multigrid's restriction)."""
        return means_over(self.labels, len(self.measure), weights)(values[:, None])[:, 0]


def make_clusters(measure: AnyMeasure, side: float) -> Clusters:
    """Join the points of a measure that lie in the same cube of a grid, whose side is `side`.

    Every cluster has a small diameter, and sparse points each keep their own cluster. The leaves of
    a tree with equal numbers of points do not have this property.
    """
    return join_points(measure, *label_cubes(measure.points, side))


def label_cubes(points: Array, side: float) -> tuple[NDArray[np.intp], int]:
    """Return the index of the cube of each point, among the cubes with points, and their number."""
    corner = np.floor((points - boxes_of_runs(points)[0]) / side).astype(np.int64)
    labels, size = np.zeros(len(points), np.int64), 1
    for column in corner.T:
        extent = int(column.max()) + 1
        if size * extent > _LARGEST_KEY:
            labels, size = _consecutive(labels, size)
        labels, size = labels * extent + column, size * extent
    return _consecutive(labels, size)


def join_points(measure: AnyMeasure, labels: NDArray[np.intp], count: int) -> Clusters:
    """Return the points of a measure joined into clusters by their labels below `count`."""
    offsets = np.zeros(len(labels)) if measure.offsets is None else measure.offsets
    mean = means_over(labels, count, measure.weights)
    means = mean(np.column_stack((measure.points, offsets)))
    masses = np.bincount(labels, measure.weights, count).astype(float)
    whole = WeightedPoints(
        means[:, :-1], masses, None if measure.offsets is None else means[:, -1].copy()
    )
    return Clusters(whole, labels)


def _consecutive(labels: NDArray[np.int64], size: int) -> tuple[NDArray[np.intp], int]:
    """Return labels below `size` as consecutive ones in the same order, and their number."""
    if size <= _TABLE_SHARE * len(labels):  # a table takes less time than a sort
        present = np.bincount(labels, minlength=size) > 0
        return (np.cumsum(present) - 1)[labels], int(present.sum())
    kept, labels = np.unique(labels, return_inverse=True)
    return labels, len(kept)


def means_over(labels: NDArray[np.intp], count: int, weights: Array) -> Callable[[Array], Array]:
    """Return the means of (N, k) values over clusters, weighted by mass if a cluster has mass."""
    masses = np.bincount(labels, weights, count)
    share = np.divide(weights, masses[labels], out=np.zeros(len(labels)), where=weights > 0)
    empty = masses <= 0
    if empty.any():
        sizes = np.bincount(labels, minlength=count)
        share = np.where(empty[labels], 1.0 / sizes[labels], share)
    return lambda values: np.column_stack(
        [np.bincount(labels, share * column, count) for column in values.T]
    )
