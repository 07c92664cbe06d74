"""The shares of the work that devices get, by records of their speed in the user's cache folder.

A share decides which device sums which rows, and so how results are rounded. Therefore the speed of
a device is measured once and kept, and results repeat to the bit as long as the records stay.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.devices.cache import cache_folder, load_record, save_record
from clmorph.backends.opencl.devices.speed import ENTRY, FOLDER
from clmorph.backends.opencl.devices.throughput import throughput


def recorded_shares(members: Sequence[Operations]) -> list[float]:
    """Return the share of each device, in proportion to its recorded speed; the sum is 1.

    A device without a record is measured, which takes about a second. Where no record can be kept,
    all shares are equal.
    """
    speeds = [_recorded_speed(member) for member in members]
    if not all(speeds):
        return [1.0 / len(members)] * len(members)
    return [speed / sum(speeds) for speed in speeds]


def _recorded_speed(member: Operations) -> float:
    """Return point pairs per second by the record of a device; 0 if none can be kept."""
    name = f"{FOLDER}/{member.record_key}"
    speed = _positive(load_record(name).get(ENTRY))
    if not speed and cache_folder() is not None:
        save_record(name, {ENTRY: member.pairs_per_second or throughput(member)})
        # The record counts, also where another process has written it in the meantime.
        speed = _positive(load_record(name).get(ENTRY))
    return speed


def _positive(value: object) -> float:
    return value if isinstance(value, float) and math.isfinite(value) and value > 0 else 0.0


def frame_turns(shares: Sequence[float], count: int) -> NDArray[np.int64]:
    """Return the device of each frame, (count,): each has its share, to within a frame or two."""
    turns = np.empty(count, np.int64)
    owed = np.zeros(len(shares))
    for number in range(count):
        owed += shares
        turns[number] = np.argmax(owed)
        owed[turns[number]] -= 1.0
    return turns
