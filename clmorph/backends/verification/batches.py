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


def check_batch_iteration(operations: Operations) -> Iterator[Finding]:
    """Compare iterations of a batch, one problem of which stops, with those of each one alone.

    `check_iteration` compares the latter with their definitions. Sums over shares of columns may
    be added in another order.
    """
    pairs = [[clustered(5, n, 7 * k + side) for side, n in enumerate(SIZES[k])] for k in range(4)]
    masses = [np.concatenate([pair[side][1] for pair in pairs]) for side in range(2)]
    batches = [_upload(operations, [pair[side] for pair in pairs]) for side in range(2)]
    rates = 1.0 / (20 * EPSILON), 0.0
    many = operations.start_batch_iteration(batches[0], batches[1], (masses[0], masses[1]), rates)
    if many is None:
        return
    rng = np.random.default_rng(1)
    potentials = [EPSILON * rng.normal(size=m) for _, m in SIZES[:4]]
    many.set_potential(np.concatenate(potentials), EPSILON, False)
    singles = []
    for (rows, columns), g in zip(pairs, potentials, strict=True):
        clouds = operations.upload(*rows), operations.upload(*columns)
        single = operations.start_iteration(*clouds, (rows[1], columns[1]), rates)
        assert single is not None, "the problem of a batch has no iteration of its own"
        single.set_potential(g, EPSILON, False)
        singles.append(single)
    here = np.arange(4)
    for number in range(4):
        begun, place, count = number > 0, max(number - 1, 0), number
        each = np.full(len(here), begun), np.full(len(here), place), np.full(len(here), count)
        found = many.iterate(*each, np.full(len(here), 32.0))
        f, g, t_columns = many.potentials()
        wanted = [singles[k].iterate(begun, place, count, 32.0) for k in here]
        parts = zip(*(singles[k].potentials() for k in here), strict=True)
        off = max(
            float(np.abs(got - np.concatenate(want)).max())
            for got, want in zip((f, g, t_columns), parts, strict=True)
        )
        off = max(
            off / EPSILON,
            *(abs(np.subtract(getattr(found, name), [getattr(one, name) for one in wanted])).max()
              for name in ("residual", "mass")),
        )  # fmt: skip
        yield Finding(f"start_batch_iteration, step {number}", float(off), 1e-4, "nats")
        taken_back = number == 2 and here == 1
        back = np.broadcast_to(taken_back, here.shape)
        many.go_back(back)
        many.go_on(found.extrapolated & ~back, ~back)
        for k, one, is_back in zip(here, wanted, back, strict=True):
            if is_back:
                singles[k].go_back()
            else:
                singles[k].go_on(one.extrapolated)
        if number == 1:
            many.keep(np.array([0, 1, 3]))
            here = here[[0, 1, 3]]


def _upload(operations: Operations, clouds: list[Cloud]) -> Any:
    """Upload a batch of clouds."""
    points, weights = (np.concatenate(each) for each in zip(*clouds, strict=True))
    counts = np.array([len(own) for _, own in clouds])
    return operations.upload_batch(points, weights, counts)
