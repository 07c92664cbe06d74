"""Checks of soft minima between the clouds of many problems at once."""

from collections.abc import Iterator

import numpy as np

from clmorph.backends.comparison import LARGEST_BOUND, Finding
from clmorph.backends.interface import Operations
from clmorph.backends.verification.clouds import clustered, log_sum_exp_tolerance

#: Numbers of points of the rows and the columns of each problem: single points, whole tiles and
#: parts of them, and several tiles.
SIZES = (1, 5), (64, 64), (130, 1), (7, 200), (65, 128), (16, 17)
#: The problems that are taken out of the batch.
TAKEN = np.array([1, 3, 4])
EPSILON = 0.004


def check_softmin_batch(
    operations: Operations,
    exact: Operations,
    dimension: int = 5,
    precise: bool = False,
    bounded: bool = False,
) -> Iterator[Finding]:
    """Compare soft minima of a batch, and of a part of it, with those of single problems.

    Parameters
    ----------
    operations, exact : Operations
    dimension : int
    precise, bounded : bool
        Which soft minima.
    """
    pairs = [
        (clustered(dimension, n, 3 * number), clustered(dimension, m, 3 * number + 1))
        for number, (n, m) in enumerate(SIZES)
    ]
    batches = []
    for side in range(2):
        clouds = [pair[side] for pair in pairs]
        counts = np.array([len(weights) for _, weights in clouds])
        batches.append(
            operations.upload_batch(*map(np.concatenate, zip(*clouds, strict=True)), counts)
        )
    rng = np.random.default_rng(0)
    potentials = [EPSILON * rng.normal(size=m) for _, m in SIZES]
    want, errors = [], []
    for pair, g in zip(pairs, potentials, strict=True):
        clouds = [exact.upload(*cloud) for cloud in pair]
        softmin, error = exact.bounded_softmin(*clouds, g, EPSILON)
        want.append(softmin)
        errors.append(error)
    for numbers in (np.arange(len(pairs)), TAKEN):
        own = batches
        if len(numbers) < len(pairs):
            own = [operations.take_batch(batch, numbers) for batch in batches]
        g = np.concatenate([potentials[number] for number in numbers])
        if bounded:
            got, bounds = operations.bounded_softmin_batch(*own, g, EPSILON)
        else:
            got = operations.softmin_batch(*own, g, EPSILON, precise)
            bounds = [log_sum_exp_tolerance(operations, *pairs[number], EPSILON, precise)
                      for number in numbers]  # fmt: skip
        ends = np.cumsum([len(want[number]) for number in numbers])
        share = 0.0
        for part, number, bound in zip(np.split(got, ends[:-1]), numbers, bounds, strict=True):
            error = float(np.abs(part - want[number]).max()) / EPSILON
            share = max(share, error / (min(float(bound), LARGEST_BOUND * bounded or np.inf)
                                        + errors[number]))  # fmt: skip
        kind = "bounded_" * bounded + "softmin_batch"
        name = f"{'precise ' * precise}{kind} of {len(numbers)} problems, {dimension}D"
        yield Finding(name, share, 1.0, "of the tolerance")
