"""Batches of clouds for `NumPyOperations`: lists of clouds, which are handled one by one."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.numpy.handles import Cloud
from clmorph.backends.records import Float64


class Batch(NamedTuple):
    """The clouds of many problems."""

    clouds: list[Cloud]


def divide(cloud: Cloud, counts: NDArray[np.int64]) -> Batch:
    """Return the clouds whose points stand in one cloud, one after the other."""
    ends = np.cumsum(counts)
    return Batch(
        [
            Cloud(*(values[end - count : end] for values in cloud))
            for end, count in zip(ends, counts, strict=True)
        ]
    )


def for_each(
    function: Callable[[Cloud, Cloud, Float64], Float64],
    rows: Batch,
    columns: Batch,
    potential: Float64,
) -> list[Float64]:
    """Return a function of each problem: of its two clouds, and its part of the potential."""
    ends = np.cumsum([len(cloud.points) for cloud in columns.clouds])
    parts = np.split(potential, ends[:-1])
    return [
        function(row, column, part)
        for row, column, part in zip(rows.clouds, columns.clouds, parts, strict=True)
    ]
