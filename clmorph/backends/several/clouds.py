"""Clouds on several devices, each of which has all points as columns and some of them as rows."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.opencl.kernels.tiles import tile_order

#: Rows are divided in multiples of this number, so that the devices' tiles are full ones.
UNIT = 64


class Part(NamedTuple):
    """The rows of one device, which may all be without mass: rows of reductions need none."""

    member: int  #: number of the device
    rows: NDArray[np.intp]  #: (n,) indices of the points in the caller's arrays
    cloud: Any  #: the device's own handle


class Cloud(NamedTuple):
    """A cloud on several devices."""

    size: int  #: number of points
    whole: list[Any]  #: each device's handle of all points
    parts: list[Part]  #: parts of the devices that have rows, each row in one of them


def divide_rows(
    points: NDArray[np.float64], shares: Sequence[float]
) -> list[tuple[int, NDArray[np.intp]]]:
    """Divide points (N, D) among devices by their shares, so that the points of each are compact.

    The order is that of tiles on a device (`tile_order`), and each device gets a run of it. So
    tiles stay small, and near pairs are as few as on one device. The result has the indices of each
    device that has rows: a problem of a few tiles may leave some out.
    """
    count = len(points)
    ends = UNIT * np.rint(np.cumsum(shares) * (count / UNIT)).astype(np.int64)
    ends = np.minimum(ends, count)
    ends[-1] = count
    order = tile_order(points, UNIT)
    starts = np.concatenate(([0], ends[:-1]))
    return [
        (member, order[start:end])
        for member, (start, end) in enumerate(zip(starts, ends, strict=True))
        if start < end
    ]
