"""Checks of soft minima and of iterations between the clouds of many problems at once."""

from typing import Any

import numpy as np

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.bench import Bench, Clouds, Findings, clustered
from clmorph.backends.opencl.verification.findings import LARGEST_BOUND, Finding, largest
from clmorph.backends.records import IMAGE, PARITY, START, control_of, next_source

#: Numbers of points of the rows and the columns of each problem: single points, whole tiles and
#: parts of them, and several tiles.
SIZES = (1, 5), (64, 64), (130, 1), (7, 200), (65, 128), (16, 17)
#: The problems that are taken out of the batch.
TAKEN = np.array([1, 3, 4])
EPSILON = 0.004


def _problems(bench: Bench, dimension: int) -> list[Clouds]:
    return [
        Clouds(
            *bench.both, clustered(dimension, n, 3 * k), clustered(dimension, m, 3 * k + 1), EPSILON
        )
        for k, (n, m) in enumerate(SIZES)
    ]


def _upload(operations: Operations, problems: list[Clouds]) -> list[Any]:
    """Upload the batches of rows and of columns."""
    batches = []
    for clouds in ([case.rows for case in problems], [case.columns for case in problems]):
        points, weights = (np.concatenate(each) for each in zip(*clouds, strict=True))
        counts = np.array([len(own) for _, own in clouds])
        batches.append(operations.upload_batch(points, weights, counts))
    return batches


def softmin_batches(bench: Bench, variant: Variant) -> Findings:
    """Compare soft minima of a batch, and of a part of it, with those of single problems."""
    operations, problems = bench.operations, _problems(bench, variant.dimension)
    whole = _upload(operations, problems)
    part = [operations.take_batch(batch, TAKEN) for batch in whole]
    for batch, numbers in ((whole, range(len(problems))), (part, TAKEN)):
        own = [problems[number] for number in numbers]
        g = np.concatenate([case.g for case in own])
        if variant.bounded:
            got, bounds = operations.bounded_softmin(*batch, g, EPSILON)
            bounds = np.minimum(bounds, LARGEST_BOUND)
        else:
            got = operations.softmin(*batch, g, EPSILON, variant.precise)
            bounds = np.array([case.tolerance(variant.precise) for case in own])
        share = 0.0
        for case, found, bound in zip(
            own, np.split(got, np.cumsum([case.shape[0] for case in own])[:-1]), bounds, strict=True
        ):
            _, exact_bound = case.exact.bounded_softmin(*case.theirs, case.g, EPSILON)
            with np.errstate(over="ignore"):
                share = float(np.maximum(share, case.off(found) / (bound + exact_bound)))
        kind = "bounded_" if variant.bounded else "precise " * variant.precise
        yield Finding(f"{kind}softmin of {len(own)} problems, {variant.dimension}D", share)


def batch_iterations(bench: Bench) -> Findings:
    """Compare iterations of a batch, one problem of which stops, with each one's own."""
    # `iterations.iterate` compares those alone with their definitions.
    operations, problems = bench.operations, _problems(bench, 5)[:4]
    rates = 1.0 / (20 * EPSILON), 0.0
    masses = tuple(
        np.concatenate(own)
        for own in zip(*((case.rows[1], case.columns[1]) for case in problems), strict=True)
    )
    many = operations.start_iteration(*_upload(operations, problems), masses, rates)
    if many is None:
        return
    many.set_potential(np.concatenate([case.g for case in problems]), EPSILON, False)
    singles = []
    for case in problems:
        own = operations.start_iteration(*case.ours, (case.rows[1], case.columns[1]), rates)
        assert own is not None, "the problem of a batch has no iteration of its own"
        own.set_potential(case.g, EPSILON, False)
        singles.append(own)
    here, sources = np.arange(4), np.full(4, START)
    for number in range(4):
        controls = control_of(sources[here], number > 0, max(number - 1, 0), number)
        found = many.iterate(controls, np.full(len(here), 32.0))
        wanted = [
            singles[k].iterate(int(control), 32.0)
            for k, control in zip(here, controls, strict=True)
        ]
        f, images, t_columns = many.potentials()
        ends = [np.cumsum(sizes) for sizes in zip(*SIZES[:4], strict=True)]
        parts = [
            np.split(each, ends[side], -1) for side, each in ((0, f), (1, images), (1, t_columns))
        ]
        errors = [
            largest(parts[part][k] - got) / EPSILON
            for k in here
            for part, got in enumerate(singles[k].potentials())
        ]
        errors += [
            largest(getattr(found, name) - np.array([getattr(one, name) for one in wanted]))
            for name in ("residual", "mass")
        ]
        yield Finding(f"start_iteration of a batch, step {number}", max(errors), 1e-4, "nats")
        back = (here == 1) & (number == 2)
        sources[here] = np.where(
            back, IMAGE | controls & PARITY, next_source(controls, found.extrapolated)
        )
        if number == 1:
            here = np.array([0, 1, 3])
            many.keep(here)
