"""Measure from how many chosen columns on it is faster to sum a whole tile."""

import numpy as np

from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.throughput import FEW_POINTS, seconds_of
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs, center_costs
from clmorph.backends.records import NearPairs

#: Points of the timed sums, if all their pairs take fewer seconds than the longest run.
POINTS, LONGEST_RUN = 8192, 0.1
#: Sums of each kind, of which the fastest counts.
RUNS = 5


def many_eighths(operations: OpenCLOperations, rate: float) -> int:
    """Return from how many eighths of its columns on a whole tile is summed faster, by `rate`."""
    points = POINTS if rate * LONGEST_RUN > POINTS**2 else FEW_POINTS
    few, more, whole = (_chosen_seconds(operations, points, eighths) for eighths in (1, 5, 8))
    each = (more - few) / 4
    return int(np.clip(1 + (whole - few) / each, 1, 8)) if each > 0 else 8


def _chosen_seconds(operations: OpenCLOperations, points: int, eighths: int) -> float:
    """Return the seconds of sums over so many eighths of the columns of each tile."""
    tile, rng = operations.constants.tile, np.random.default_rng(0)
    cloud = operations.upload(rng.random((points, 5)), np.full(points, 1 / points))
    n = len(cloud.centers)
    chosen = rng.random((n * n, tile // operations.constants.group_rows, tile)).argsort(axis=-1)
    bits = np.packbits(8 * chosen < eighths * tile, axis=-1, bitorder="little")
    bits = np.pad(bits, ((0, 0), (0, 0), (0, -bits.shape[-1] % 8)))
    masks = operations.work.buffer(bits.view(np.uint64), np.uint64)
    starts = n * np.arange(n + 1)
    pairs = TilePairs(
        starts, np.tile(np.arange(n, dtype=np.uint32), n),
        center_costs(cloud.centers[:, None], cloud.centers).ravel(), [(range(n), masks)],
        starts * tile**2,
    )  # fmt: skip
    near = NearPairs(pairs, np.zeros(points), np.zeros(points), points**2, points, 0.0)

    def run() -> None:
        operations.softmin(cloud, cloud, np.zeros(points), 0.01, False, near)

    run()
    return min(seconds_of(operations, run) for _ in range(RUNS))
