"""What has no clouds, in NumPy: sums over grids, nearest seeds, colors after tables."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.records import Float32, Float64

#: Terms of a block of lines of a grid, so that memory stays bounded (32 MB of float64).
BLOCK_TERMS = 1 << 22
#: Numbers of colors, and of pixels whose seeds are looked for, that are worked on at once.
COLORS, PIXELS = 1 << 16, 1 << 17


def grid_log_sum_exp(exponents: Float64, axes: Sequence[tuple[Float64, Float64]]) -> Float64:
    """Return log sum_j exp(e_j - |x_i - y_j|^2); see `clmorph.backends.interface.Operations`."""
    values = exponents
    # The last axis becomes the first one each time, so that all come back to their places.
    for x, y in reversed(axes):
        costs = (x[:, None] - y) ** 2
        lines = values.reshape(-1, len(y))
        found = np.empty((len(x), len(lines)))
        step = max(1, BLOCK_TERMS // costs.size)
        for first in range(0, len(lines), step):
            check_cancelled()
            part = slice(first, first + step)
            terms = lines[part, None, :] - costs
            largest = np.maximum(terms.max(axis=2), np.finfo(float).min)
            terms -= largest[..., None]
            with np.errstate(divide="ignore"):
                found[:, part] = (np.log(np.exp(terms, out=terms).sum(axis=2)) + largest).T
        values = found.reshape(len(x), *values.shape[:-1])
    return values


def apply_table(table: Float32, colors: Float32) -> Float32:
    """Return colors (N, 3) after a table; see `clmorph.backends.interface.Operations`."""
    last = len(table) - 1
    found = np.empty(colors.shape, np.float32)
    for first in range(0, len(colors), COLORS):
        check_cancelled()
        part = slice(first, first + COLORS)
        places = np.clip(colors[part].astype(float), 0.0, 1.0) * last
        corner = np.minimum(places.astype(np.int64), last - 1)
        rest = places - corner
        # From corner to corner along the axis of the largest rest, then of the next one.
        order = np.argsort(-rest, axis=1, kind="stable")
        ways = np.take_along_axis(rest, order, axis=1)
        weights = -np.diff(ways, axis=1, prepend=1.0, append=0.0)
        total = np.zeros(places.shape)
        rows = np.arange(len(places))
        for step in range(4):
            total += weights[:, step, None] * table[tuple(corner.T)]
            if step < 3:
                corner[rows, order[:, step]] += 1
        found[part] = total
    return found


def nearest_seeds(seeds: Float32, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Return the nearest seed of each pixel; see `clmorph.backends.interface.Operations`."""
    from scipy.spatial import KDTree

    # Of seeds in the same place the first one counts.
    joined = np.ascontiguousarray(seeds, float).view(complex).ravel()
    places, first = np.unique(joined, return_index=True)
    seeds = places[:, None].view(float)
    tree = KDTree(seeds)
    nearest = np.empty(shape[0] * shape[1], np.int32)
    for begin in range(0, len(nearest), PIXELS):
        check_cancelled()
        open_ = np.arange(begin, min(begin + PIXELS, len(nearest)))
        ways = 1
        # Where the last of the nearest seeds is as near as the first one, there may be more.
        while len(open_):
            ways = min(2 * ways, len(seeds))
            pixels = np.stack(np.divmod(open_, shape[1])[::-1], axis=1).astype(float)
            distances, near = map(np.asarray, tree.query(pixels, np.arange(1, ways + 1)))
            squares = np.square(pixels[:, None] - seeds[near]).sum(axis=2)
            equal = squares == squares.min(axis=1, keepdims=True)
            nearest[open_] = np.where(equal, first[near], len(joined)).min(axis=1)
            open_ = open_[(distances[:, -1] <= distances[:, 0]) & (ways < len(seeds))]
    return nearest.reshape(shape)
