"""The nearest of many seeds for each pixel, in NumPy."""

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.records import Float32

#: Number of pixels whose seeds are looked for at once.
CHUNK = 1 << 17


def nearest_seeds(seeds: Float32, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Return the nearest seed of each pixel; see `clmorph.backends.interface.Operations`."""
    from scipy.spatial import KDTree

    # Of seeds in the same place the first one counts.
    joined = np.ascontiguousarray(seeds, float).view(complex).ravel()
    places, first = np.unique(joined, return_index=True)
    seeds = places[:, None].view(float)
    tree = KDTree(seeds)
    nearest = np.empty(shape[0] * shape[1], np.int32)
    for begin in range(0, len(nearest), CHUNK):
        check_cancelled()
        open_ = np.arange(begin, min(begin + CHUNK, len(nearest)))
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
