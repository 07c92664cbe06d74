"""Measure the speed of a device: point pairs per second in the log-sum-exp."""

import time

import numpy as np

from clmorph.backends.interface import Operations

#: Seconds over which the best throughput is taken.
THROUGHPUT_SECONDS = 0.25
#: The number of points of the first, short measurement.
FEW_POINTS = 256
#: If one run would take more than this number of seconds, the short measurement is the result.
LONGEST_RUN = 5.0


def throughput(operations: Operations, points: int = 4096) -> float:
    """Return the highest rate of a few runs of the log-sum-exp, in point pairs per second.

    On a very slow device, such as a simulator, there are fewer points.
    """
    short = _rate(operations, min(points, FEW_POINTS), 0.0)
    if points * points > LONGEST_RUN * short:
        return short
    return _rate(operations, points, THROUGHPUT_SECONDS)


def _rate(operations: Operations, points: int, seconds: float) -> float:
    """Return the highest rate of at least one run, within some seconds."""
    rng = np.random.default_rng(0)
    cloud = operations.upload(rng.random((points, 5)), np.full(points, 1 / points))
    potential = np.zeros(points)
    # Some drivers compile a kernel when it is first launched.
    operations.softmin(cloud, cloud, potential, 0.01)
    best, start = np.inf, time.perf_counter()
    # The time suffices for other threads, such as those of NumPy's BLAS, to become idle.
    while best == np.inf or time.perf_counter() - start < seconds:
        began = time.perf_counter()
        operations.softmin(cloud, cloud, potential, 0.01)
        best = min(best, time.perf_counter() - began)
    return float(points * points / best)
