"""How much more a device sums in the time in which a processor sums a softmin."""

import math

#: Pairs of points that a processor sums in a second.
USUAL_RATE = 5e9


def speed_factor(on_processor: bool, pairs_per_second: float) -> int:
    """Return 1, or 8 or 64 for devices that are so many times faster than a processor.

    The steps are wide, so that a repeated measurement of the device rarely changes it.
    """
    if on_processor or pairs_per_second <= USUAL_RATE:
        return 1
    return int(8 ** min(2, round(math.log(pairs_per_second / USUAL_RATE, 8))))
