"""Order points into compact tiles (a k-d tree's leaves).

Tiles make differences inside them small, which is what lets float32 hold the exponents
of the transport kernel, and bound what a whole tile can contribute.
"""

import numpy as np
from numpy.typing import NDArray


def tile_order(points: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    """Sort points so that each run of `size` consecutive ones is compact.

    Segments are halved along their longest side, at a multiple of `size` so that only
    the last tile can be partly filled.

    Parameters
    ----------
    points : (N, D) array
    size : int
        Points of one tile.

    Returns
    -------
    (N,) array of int
        Permutation; ties keep their order, so equal input gives equal output.
    """
    order = np.arange(len(points), dtype=np.intp)
    bounds = np.array([0, len(points)])
    while True:
        counts = np.diff(bounds)
        tiles = -(-counts // size)
        if tiles.max(initial=0) <= 1:
            return order
        starts = bounds[:-1]
        sorted_points = points[order]
        low = np.minimum.reduceat(sorted_points, starts, axis=0)
        high = np.maximum.reduceat(sorted_points, starts, axis=0)
        axis = np.argmax(high - low, axis=1)
        segment = np.repeat(np.arange(len(counts)), counts)
        key = sorted_points[np.arange(len(points)), axis[segment]]
        order = order[np.lexsort((key, segment))]
        middle = starts + size * ((tiles + 1) // 2)
        bounds = np.unique(np.concatenate((bounds, middle[tiles > 1])))
