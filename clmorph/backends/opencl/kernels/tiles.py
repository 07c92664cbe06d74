"""Order points into compact tiles, a k-d tree's leaves, in which float32 differences suffice."""

import numpy as np
from numpy.typing import NDArray

#: Bits of a sorting key: the position of a point in its segment, and the index of the point.
PLACE_BITS, POINT_BITS = 20, 24


def tile_order(
    points: NDArray[np.float64],
    size: int,
    counts: NDArray[np.int64] | None = None,
    part: int | None = None,
) -> NDArray[np.intp]:
    """Return the order, (N,), of tiles of `size` points and parts of `part`, cloud by cloud."""
    # Segments are halved along their longest side, at a multiple of `size` so that only the last
    # tile can be partly filled. Ties keep their order. There are at most 2^24 points, 2^18 clouds.
    count = len(points)
    everyone = np.arange(count)
    order, columns = everyone, points.T.copy()
    bounds = np.array([0, count]) if counts is None else np.append(0, np.cumsum(counts))
    firsts = bounds[:-1]
    while True:
        counts = np.diff(bounds)
        unit = size if part is None else np.where(counts > size, size, part)
        units = -(-counts // unit)
        if units.max(initial=0) <= 1:
            return order.astype(np.intp)
        starts = bounds[:-1]
        low = np.minimum.reduceat(columns, starts, axis=1)
        sides = np.maximum.reduceat(columns, starts, axis=1) - low
        axis = np.argmax(sides, axis=0)
        number = np.arange(len(counts))
        side = sides[axis, number]
        scale = np.zeros(len(counts))
        np.divide(2**PLACE_BITS - 1, side, out=scale, where=side > 1e-290)
        # A cloud that is done keeps its order, which is then that of this cloud alone.
        if len(firsts) > 1:
            segments = np.searchsorted(starts, firsts)
            left = np.maximum.reduceat(units, segments) > 1
            scale *= np.repeat(left, np.diff(np.append(segments, len(starts))))
        places = columns.ravel().take(np.repeat(axis * count, counts) + everyone)
        places -= np.repeat(low[axis, number], counts)
        places *= np.repeat(scale, counts)
        # Each key is one integer of segment, position in it, and index, so that keys are distinct.
        keys = np.repeat(number << PLACE_BITS, counts)
        keys += places.astype(np.int64)
        keys <<= POINT_BITS
        keys += everyone
        keys.sort()
        keys &= 2**POINT_BITS - 1
        order, columns = order[keys], columns.take(keys, axis=1)
        middle = starts + unit * ((units + 1) // 2)
        # All are distinct, and a stable sort of two ascending runs merges them.
        bounds = np.sort(np.concatenate((bounds, middle[units > 1])), kind="stable")
