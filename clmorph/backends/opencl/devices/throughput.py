"""How fast a device is: point pairs per second through the log-sum-exp."""

import time

import numpy as np

from clmorph.backends.interface import Operations

#: Seconds over which the best throughput is taken.
THROUGHPUT_SECONDS = 0.5


def throughput(operations: Operations, points: int = 4096) -> float:
    """Return the best rate of a few log-sum-exps.

    Parameters
    ----------
    operations : Operations
    points : int
        Points of the cloud, which is summed over itself.

    Returns
    -------
    float
        Point pairs per second.
    """
    rng = np.random.default_rng(0)
    cloud = operations.upload(rng.random((points, 5)), np.full(points, 1 / points))
    potential = np.zeros(points)
    best, start = np.inf, time.perf_counter()
    # Long enough for other threads, such as those of NumPy's BLAS, to come to rest.
    while best == np.inf or time.perf_counter() - start < THROUGHPUT_SECONDS:
        began = time.perf_counter()
        operations.softmin(cloud, cloud, potential, 0.01)
        best = min(best, time.perf_counter() - began)
    return float(points * points / best)
