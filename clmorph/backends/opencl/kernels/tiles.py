"""Order points into compact tiles (a k-d tree's leaves).

Tiles make differences inside them small, which is what lets float32 hold the exponents
of the transport kernel, and bound what a whole tile can contribute.
"""

import numpy as np
from numpy.typing import NDArray

#: Bits of a sorting key: where in its segment a point lies, and which point it is.
PLACE_BITS, POINT_BITS = 20, 24


def tile_order(points: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    """Sort points so that each run of `size` consecutive ones is compact.

    Segments are halved along their longest side, at a multiple of `size` so that only
    the last tile can be partly filled.

    Parameters
    ----------
    points : (N, D) array
        Of at most 2^24 points.
    size : int
        Points of one tile.

    Returns
    -------
    (N,) array of int
        Permutation; ties keep their order, so equal input gives equal output.
    """
    count = len(points)
    everyone = np.arange(count)
    order, columns = everyone, points.T.copy()
    bounds = np.array([0, count])
    while True:
        counts = np.diff(bounds)
        tiles = -(-counts // size)
        if tiles.max(initial=0) <= 1:
            return order.astype(np.intp)
        starts = bounds[:-1]
        low = np.minimum.reduceat(columns, starts, axis=1)
        sides = np.maximum.reduceat(columns, starts, axis=1) - low
        axis = np.argmax(sides, axis=0)
        number = np.arange(len(counts))
        side = sides[axis, number]
        scale = np.zeros(len(counts))
        np.divide(2**PLACE_BITS - 1, side, out=scale, where=side > 1e-290)
        places = columns.ravel().take(np.repeat(axis * count, counts) + everyone)
        places -= np.repeat(low[axis, number], counts)
        places *= np.repeat(scale, counts)
        # One integer to sort by: segment, place in it, and the point itself, so that none tie.
        keys = np.repeat(number << PLACE_BITS, counts)
        keys += places.astype(np.int64)
        keys <<= POINT_BITS
        keys += everyone
        keys.sort()
        keys &= 2**POINT_BITS - 1
        order, columns = order[keys], columns.take(keys, axis=1)
        middle = starts + size * ((tiles + 1) // 2)
        bounds = np.unique(np.concatenate((bounds, middle[tiles > 1])))
