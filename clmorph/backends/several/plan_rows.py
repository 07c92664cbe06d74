"""Join the plan rows of several devices."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.records import PlanRows

#: The number of pairs that are moved at a time, so that their indices take little memory.
MOVED_PAIRS = 1 << 22


def joined_rows(count: int, parts: Sequence[tuple[NDArray[np.intp], PlanRows]]) -> PlanRows:
    """Return plan rows in the caller's order.

    Parameters
    ----------
    count : int
        Number of rows.
    parts : sequence of (rows, pairs)
        The numbers of some rows, and their pairs; each row is in one part.
    """
    lengths = np.zeros(count, np.int64)
    for rows, pairs in parts:
        lengths[rows] = np.diff(pairs.indptr)
    indptr = np.concatenate(([0], np.cumsum(lengths)))
    indices = np.empty(indptr[-1], np.int32)
    mass = np.empty(indptr[-1])
    for rows, pairs in parts:
        first = 0
        while first < len(rows):
            end = int(np.searchsorted(pairs.indptr, pairs.indptr[first] + MOVED_PAIRS, "right"))
            block = slice(first, min(len(rows), max(first + 1, end - 1)))
            own = slice(pairs.indptr[block.start], pairs.indptr[block.stop])
            moves = indptr[rows[block]] - pairs.indptr[block]
            places = np.repeat(moves, lengths[rows[block]]) + np.arange(own.start, own.stop)
            indices[places], mass[places] = pairs.indices[own], pairs.mass[own]
            first = block.stop
    return PlanRows(indptr, indices, mass)
