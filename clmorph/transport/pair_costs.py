"""Costs of pairs of points to be assigned, and each point's cheapest pairs at some prices."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.cancellation import check_cancelled
from clmorph.measures.points import WeightedPoints

Indices = NDArray[np.intp]

#: Pairs whose costs are formed together.
CHUNK = 1 << 21
#: Largest number of coordinates with which trees are searched; with more, all pairs are formed.
TREE_DIMENSION = 8
#: Points of a leaf of a tree: in five dimensions large ones halve the time of a search.
LEAF = 64
#: Points that a tree is asked about at once, between which a search can be cancelled.
ASKED = 1 << 14


@dataclass(frozen=True)
class Costs:
    """The costs w_i |x_i - y_j|^2 / 2 of N rows and M >= N columns."""

    x: Array  #: (N, D)
    y: Array  #: (M, D)
    weights: Array | None = None  #: (N,) w, or None where all are 1

    @property
    def spare(self) -> int:
        """Number of columns that no row gets."""
        return len(self.y) - len(self.x)

    @property
    def scale(self) -> float:
        """The mean cost of all pairs."""
        rows = np.square(self.x - self.y.mean(axis=0)).sum(axis=1) + self.y.var(axis=0).sum()
        return float((rows if self.weights is None else rows * self.weights).mean() / 2)

    def of_pairs(self, rows: Indices, columns: Indices) -> Array:
        """Return the costs of pairs: (K,) array."""
        costs = np.square(self.x[rows] - self.y[columns]).sum(axis=1) / 2
        return costs if self.weights is None else costs * self.weights[rows]

    def cheapest(self, side: int, prices: Array, count: int, points: Indices) -> Indices:
        """Return (K, count) cheapest pairs of rows (side 0) or columns (1) at the other's prices.

        Points in one place get different ones of others in one place. The cheapest pair is exact to
        rounding if `count` is 1.
        """
        count = min(count, len(prices))
        if self.weights is None and self.x.shape[1] <= TREE_DIMENSION:
            return self._by_tree(side, prices, count, points)
        found = np.empty((len(points), count), np.intp)
        size = max(1, CHUNK // len(prices))
        for begin in range(0, len(points), size):
            check_cancelled()
            some = points[begin : begin + size]
            every = slice(None)
            costs = self._block(some, every) if side == 0 else self._block(every, some).T
            costs = costs - prices
            if count == 1:
                found[begin : begin + size] = costs.argmin(axis=1)[:, None]
            else:
                found[begin : begin + size] = np.argpartition(costs, count - 1)[:, :count]
        return found

    def _by_tree(self, side: int, prices: Array, count: int, points: Indices) -> Indices:
        """Find the nearest points of a tree whose last coordinate makes dear points far.

        |x - y|^2 / 2 - g is |(x, 0) - (y, h)|^2 / 2 - max g, with h^2 / 2 = max g - g.
        """
        from scipy.spatial import KDTree  # takes long to import

        own, other = (self.x, self.y)[:: -1 if side else 1]
        height = np.sqrt(2 * (prices.max() - prices))
        parts = [other, height[:, None]], [own[points], np.zeros((len(points), 1))]
        if count > 1:
            for part, label in zip(parts, (self._labels[1 - side], self._labels[side][points]),
                                   strict=True):  # fmt: skip
                part.append(label[:, None])
        tree = KDTree(np.hstack(parts[0]), leafsize=LEAF)
        asked = np.hstack(parts[1])
        found = np.empty((len(points), count), np.intp)
        for begin in range(0, len(points), ASKED):
            check_cancelled()
            _, near = tree.query(asked[begin : begin + ASKED], count, workers=-1)
            found[begin : begin + ASKED] = near.reshape(-1, count)
        return found

    @cached_property
    def _labels(self) -> tuple[Array, Array]:
        """Small numbers that differ between points in one place, (N,) and (M,)."""
        unit = 1e-4 * max(self.scale, np.finfo(float).tiny) ** 0.5
        return _ranks(self.x) * unit, _ranks(self.y) * unit

    def _block(self, rows: Any, columns: Any) -> Array:
        from scipy.spatial.distance import cdist  # takes long to import

        costs = cdist(self.x[rows], self.y[columns], "sqeuclidean")
        costs *= 0.5 if self.weights is None else self.weights[rows, None] / 2
        return costs

    def measures(self) -> tuple[WeightedPoints, WeightedPoints]:
        """Return points of equal masses with these costs; one point takes the columns left over.

        w |x - y|^2 / 2 is w |x|^2 / 2 - X . Y with X = (w x, -w) and Y = (y, |y|^2 / 2), and X = 0
        costs nothing.
        """
        n, m = len(self.x), len(self.y)
        masses = np.full(m, 1.0 / m)
        if self.weights is None and not self.spare:
            return WeightedPoints(self.x, masses), WeightedPoints(self.y, masses)
        origin = self.y.mean(axis=0)
        x, y = self.x - origin, self.y - origin
        w = np.ones(n) if self.weights is None else self.weights
        half = np.square(y).sum(axis=1) / 2
        # All rows that have a cost share the mean of the heights, which the offsets take.
        unit = max(np.sqrt(half.mean()), np.finfo(float).tiny)
        rows = np.column_stack((w[:, None] * x, -w * unit))
        columns = np.column_stack((y, half / unit))
        r = w * np.square(x).sum(axis=1) / 2 - np.square(rows).sum(axis=1) / 2
        s = -np.square(columns).sum(axis=1) / 2
        if self.spare:
            rows, r = np.vstack((rows, np.zeros(rows.shape[1]))), np.append(r, 0.0)
        own = np.append(masses[:n], self.spare / m) if self.spare else masses
        return WeightedPoints(rows, own, r), WeightedPoints(columns, masses, s)


def _ranks(points: Array) -> Array:
    """Return numbers in [0, 1) that are spaced evenly between points in one place: (N,) array."""
    _, place, counts = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    place = place.ravel()
    order = np.argsort(place, kind="stable")
    first = np.cumsum(counts) - counts
    ranks = np.empty(len(points))
    ranks[order] = (np.arange(len(points)) - np.repeat(first, counts)) / np.repeat(counts, counts)
    return ranks
