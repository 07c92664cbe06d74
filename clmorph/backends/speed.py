"""How many times faster than a processor a device sums pairs of points."""

import math

#: Pairs of points that a processor sums in a second.
USUAL_RATE = 5e9


def speed_factor(on_processor: bool, pairs_per_second: float) -> int:
    """Return how many times faster than a processor a device sums, in steps: 1, 8 or 64.

    The steps are wide, so that a repeated measurement of the device rarely changes the result.
    """
    if on_processor or pairs_per_second <= USUAL_RATE:
        return 1
    return int(8 ** min(2, round(math.log(pairs_per_second / USUAL_RATE, 8))))
