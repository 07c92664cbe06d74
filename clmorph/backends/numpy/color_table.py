"""Colors after a table in three dimensions, in NumPy."""

import numpy as np

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.records import Float32

#: Number of colors that are worked on at once.
CHUNK = 1 << 16


def apply_table(table: Float32, colors: Float32) -> Float32:
    """Return colors (N, 3) after a table; see `clmorph.backends.interface.Operations`."""
    last = len(table) - 1
    found = np.empty(colors.shape, np.float32)
    for first in range(0, len(colors), CHUNK):
        check_cancelled()
        part = slice(first, first + CHUNK)
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
