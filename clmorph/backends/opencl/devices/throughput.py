"""Measure the speed of a device: point pairs per second in the log-sum-exp."""

import time

import numpy as np

from clmorph.backends.interface import Operations

#: Seconds over which the best throughput is taken.
THROUGHPUT_SECONDS = 0.5


def throughput(operations: Operations, points: int = 4096) -> float:
    """Return the highest rate of a few runs of the log-sum-exp.

    Parameters
    ----------
    operations : Operations
    points : int
        Number of points of the cloud, whose rows and columns are the same points.

    Returns
    -------
    float
        Point pairs per second.
    """
    rng = np.random.default_rng(0)
    cloud = operations.upload(rng.random((points, 5)), np.full(points, 1 / points))
    potential = np.zeros(points)
    # Some drivers compile a kernel when it is first launched.
    operations.softmin(cloud, cloud, potential, 0.01)
    best, start = np.inf, time.perf_counter()
    # The time suffices for other threads, such as those of NumPy's BLAS, to become idle.
    while best == np.inf or time.perf_counter() - start < THROUGHPUT_SECONDS:
        began = time.perf_counter()
        operations.softmin(cloud, cloud, potential, 0.01)
        best = min(best, time.perf_counter() - began)
    return float(points * points / best)
