"""Measure the speed of a device: point pairs per second in the log-sum-exp."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from clmorph.backends.interface import Operations

#: Seconds over which the best throughput is taken.
THROUGHPUT_SECONDS = 0.25
#: The number of points of the first, short measurement, and the largest one.
FEW_POINTS, MOST_POINTS = 256, 1 << 16
#: If one run would take more than this number of seconds, the short measurement is the result.
LONGEST_RUN = 5.0
#: Runs of fewer seconds do not fill a device, so that there are more points.
SHORTEST_RUN = 2e-3
#: A device's clock that shows a smaller share of the host's seconds does not run (Mesa's rusticl).
LEAST_SHARE = 1e-4


def throughput(operations: Operations, points: int = 4096, precise: bool = False) -> float:
    """Return the highest rate of a few runs of the log-sum-exp, in point pairs per second."""
    rate = short = _rate(operations, min(points, FEW_POINTS), 0.0, precise)
    if points * points > LONGEST_RUN * short:
        return short
    while points <= MOST_POINTS:
        rate = _rate(operations, points, THROUGHPUT_SECONDS, precise)
        if points * points >= SHORTEST_RUN * rate:
            break
        points *= 2
    return rate


def seconds_of(operations: Any, run: Callable[[], object]) -> float:
    """Return the seconds of a run, by the device's clock if that is profiled and runs."""
    work = getattr(operations, "work", None)
    before, began = getattr(work, "device_seconds", 0.0), time.perf_counter()
    run()
    elapsed = time.perf_counter() - began
    in_kernels = float(getattr(work, "device_seconds", 0.0) - before)
    return in_kernels if in_kernels > LEAST_SHARE * elapsed else elapsed


def _rate(operations: Operations, points: int, seconds: float, precise: bool = False) -> float:
    """Return the highest rate of at least one run, within some seconds."""
    rng = np.random.default_rng(0)
    cloud = operations.upload(rng.random((points, 5)), np.full(points, 1 / points))
    potential = np.zeros(points)

    def run() -> None:
        operations.softmin(cloud, cloud, potential, 0.01, precise)

    run()  # some drivers compile a kernel when it is first launched
    best, start = np.inf, time.perf_counter()
    # The time suffices for other threads, such as those of NumPy's BLAS, to become idle.
    while best == np.inf or time.perf_counter() - start < seconds:
        best = min(best, seconds_of(operations, run))
    return float(points * points / best)
