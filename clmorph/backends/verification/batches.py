"""Checks of soft minima between the clouds of many problems at once."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from clmorph.backends.comparison import LARGEST_BOUND, Finding
from clmorph.backends.interface import Operations
from clmorph.backends.verification.clouds import Cloud, clustered, log_sum_exp_tolerance

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
    """Compare soft minima of a batch, and of a part of it, with those of single problems."""
    pairs = [
        (clustered(dimension, n, 3 * number), clustered(dimension, m, 3 * number + 1))
        for number, (n, m) in enumerate(SIZES)
    ]
    rng = np.random.default_rng(0)
    potentials = [EPSILON * rng.normal(size=m) for _, m in SIZES]
    want, errors = [], []
    for (rows, columns), g in zip(pairs, potentials, strict=True):
        clouds = exact.upload(*rows), exact.upload(*columns)
        softmin, error = exact.bounded_softmin(*clouds, g, EPSILON)
        want.append(softmin)
        errors.append(error)
    whole = tuple(_upload(operations, [pair[side] for pair in pairs]) for side in range(2))
    part = tuple(operations.take_batch(batch, TAKEN) for batch in whole)
    for own, numbers in ((whole, np.arange(len(pairs))), (part, TAKEN)):
        g = np.concatenate([potentials[number] for number in numbers])
        if bounded:
            got, bounds = operations.bounded_softmin_batch(own[0], own[1], g, EPSILON)
            bounds = np.minimum(bounds, LARGEST_BOUND)
        else:
            got = operations.softmin_batch(own[0], own[1], g, EPSILON, precise)
            bounds = np.array(
                [
                    log_sum_exp_tolerance(operations, *pairs[number], EPSILON, precise)
                    for number in numbers
                ]
            )
        ends = np.cumsum([len(want[number]) for number in numbers])
        share = 0.0
        for found, number, bound in zip(np.split(got, ends[:-1]), numbers, bounds, strict=True):
            error = float(np.abs(found - want[number]).max()) / EPSILON
            share = max(share, error / (float(bound) + errors[number]))
        kind = "bounded_" * bounded + "precise " * (precise and not bounded)
        name = f"{kind}softmin_batch of {len(numbers)} problems, {dimension}D"
        yield Finding(name, share, 1.0, "of the tolerance")


def _upload(operations: Operations, clouds: list[Cloud]) -> Any:
    """Upload a batch of clouds."""
    points, weights = (np.concatenate(each) for each in zip(*clouds, strict=True))
    counts = np.array([len(own) for _, own in clouds])
    return operations.upload_batch(points, weights, counts)
