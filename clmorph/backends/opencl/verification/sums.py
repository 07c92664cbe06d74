"""Checks of the reductions over rows: soft minima, maxima, near pairs, moments and draws."""

import itertools
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from clmorph.backends.opencl.build.constants import SLICED_FROM
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.verification.batches import softmin_batches
from clmorph.backends.opencl.verification.bench import LEFT_OUT, Bench, Clouds, Findings, check
from clmorph.backends.opencl.verification.findings import LARGEST_BOUND, UNIT, largest

#: The rounding error, in nats, that a bounded softmin over near pairs may have. Powers in float32
#: need less; in five dimensions exponents are then float32 between some tiles, and float64 between
#: others.
ENOUGH = 1e-4
#: The unit of errors of places.
OF_SIZE = "of the clouds' size"


@check("log_sum_exp.cl")
def softmins(bench: Bench, variant: Variant) -> Findings:
    """Compare soft minima; over near pairs, within the share that these leave out."""
    if variant.listed and not variant.masked:
        yield from softmin_batches(bench, variant)  # the lists of batches have no masks
        return
    for case in bench.clouds(variant.dimension, variant.listed):
        if variant.bounded:
            yield from _bounded(case, variant)
            continue
        yield from _softmin(case, variant.precise, variant.listed)
        if not (variant.precise or variant.listed):
            yield from _row_maxima(case)
            yield from _offsets(case)


def _softmin(case: Clouds, precise: bool = False, listed: bool = False) -> Findings:
    near = case.near if listed else None
    got = case.operations.softmin(*case.ours, case.g, case.epsilon, precise, near)
    error, allowed = case.off(got, near), case.tolerance(precise)
    yield case.finding("softmin", error, allowed, precise=precise, listed=listed)


def _bounded(case: Clouds, variant: Variant) -> Findings:
    """Check that soft minima are within the error bound that comes with them."""
    near = case.near if variant.listed else None
    # Over near pairs powers are float32 if that is exact enough.
    enough = ENOUGH if variant.bounded == 2 else 0.0
    got, bound = case.operations.bounded_softmin(*case.ours, case.g, case.epsilon, near, enough)
    _, exact_bound = case.exact.bounded_softmin(*case.theirs, case.g, case.epsilon)
    allowed = min(bound, enough + LARGEST_BOUND) + exact_bound
    yield case.finding("bounded_softmin", case.off(got, near), allowed, listed=variant.listed)


def _row_maxima(case: Clouds) -> Findings:
    got = case.operations.row_maxima(*case.ours, case.g, case.epsilon)
    want = case.exact.row_maxima(*case.theirs, case.g, case.epsilon)
    # The errors of single exponents, unlike those of sums, do not cancel in part.
    share = 1.5 if case.rows[0].shape[1] >= SLICED_FROM else 1.0
    yield case.finding("row_maxima", largest(got - want), share * case.tolerance())


def _offsets(case: Clouds) -> Findings:
    """Compare soft minima of costs with terms of the rows and of the columns."""
    rng = np.random.default_rng(2)
    r, s = (rng.normal(size=size) for size in case.shape)
    got, want = (
        backend.softmin(
            backend.upload(*case.rows, r), backend.upload(*case.columns, s), case.g + s,
            case.epsilon,
        )
        for backend in (case.operations, case.exact)
    )  # fmt: skip
    error = largest(got - want) / case.epsilon
    yield case.finding("softmin with offsets", error, case.tolerance())


@check("tile_levels.cl", "tile_levels", "log_sum_exp")
def levels(bench: Bench, variant: Variant) -> Findings:
    """Compare soft minima, over all pairs and over near ones, whose levels the device forms."""
    with bench.forced("row_loop", "device_levels", 0):
        for listed, precise in itertools.product((False, True), repeat=2):
            for case in bench.clouds(listed=listed):
                yield from _softmin(case, precise, listed)


@check("near_field.cl", "log_sum_exp")
def near_pairs(bench: Bench, variant: Variant) -> Findings:
    """Check that near pairs leave out no more than they report, and that little is reported."""
    for case in bench.clouds(variant.dimension, listed=True):
        near = case.near
        over_near = case.operations.softmin(*case.ours, case.g, case.epsilon, False, near)
        errors = (
            near.skipped.max() - LEFT_OUT, case.off(near.softmin, near), case.off(over_near, near)
        )  # fmt: skip
        yield case.finding("near_pairs", float(np.max(errors)), case.tolerance())


@check("barycentric_projection.cl")
def projections(bench: Bench, variant: Variant) -> Findings:
    """Compare soft minima and the mean of each row's destinations, which one pass computes."""
    precise, listed = variant.precise, variant.listed
    for case in bench.clouds(variant.dimension, listed):
        near = case.near if listed else None
        softmin, mean = case.operations.barycentric_projection(
            *case.ours, case.g, case.epsilon, precise, near
        )
        off = largest(mean - case.mean) / (2 * case.size)
        for name, error, allowed, unit in (
            ("softmin", case.off(softmin, near), case.tolerance(precise), "nats"),
            ("mean", off, _of_moments(case, variant), OF_SIZE),
        ):
            yield case.finding(
                "barycentric_projection", error, allowed, unit, precise=precise, listed=listed,
                detail=f", {name}",
            )  # fmt: skip


@check("plan_shares.cl", "plan_moments")
def moments(bench: Bench, variant: Variant) -> Findings:
    """Compare mean and covariance of each row's destinations."""
    for case in bench.clouds(variant.dimension, variant.listed):
        near, softmin = _normalized(case, variant)
        got = case.operations.plan_moments(
            *case.ours, case.g, softmin, case.epsilon, variant.precise, near
        )
        scales = 2 * case.size, 8 * case.size**2
        for name, mine, exact, scale in zip(
            ("mean", "covariance"), got, case.moments, scales, strict=True
        ):
            yield case.finding(
                "plan_moments", largest(mine - exact) / scale, _of_moments(case, variant), OF_SIZE,
                precise=variant.precise, listed=variant.listed, detail=f", {name}",
            )  # fmt: skip


def _normalized(case: Clouds, variant: Variant) -> tuple[Any, Any]:
    """Return near pairs, and the soft minima over them; all pairs have NumPy's."""
    if not variant.listed:
        return None, case.softmin
    own = case.ours, case.g, case.epsilon, variant.precise, case.near
    return case.near, case.operations.softmin(*own[0], *own[1:])


def _of_moments(case: Clouds, variant: Variant) -> float:
    """Return the tolerated error of moments relative to the clouds' size."""
    # Errors of an exponent cancel in part, because moments are divided by the row's sum.
    of_sum = UNIT * (32 + 4 * case.shape[1] ** 0.5)
    return of_sum + (0 if variant.precise else case.tolerance()) + LEFT_OUT * variant.listed


@check("plan_shares.cl", "sample_plan_rows")
def draws(bench: Bench, variant: Variant) -> Findings:
    """Check that equally spaced thresholds draw each column in proportion to its share."""
    cases = replace(bench, pictures=None).clouds(variant.dimension, variant.listed)
    yield from _draws(cases, variant, 200)
    yield from _draws(cases[:1], variant, 3)
    if bench.pictures is not None:
        # Of a few rows so many draws are compared that a single column's share shows.
        (points, weights), columns = bench.pictures
        rows = points[:4], weights[:4]
        yield from _draws([Clouds(*bench.both, rows, columns, 0.0025)], variant, 2000)


def _draws(cases: Iterable[Clouds], variant: Variant, count: int) -> Findings:
    """Compare draws: to within one they do, in any order of the columns."""
    for case in cases:
        n, m = case.shape
        thresholds = np.tile((np.arange(count) + 0.5) / count, (n, 1))
        near, softmin = _normalized(case, variant)
        columns = case.operations.sample_plan_rows(
            *case.ours, case.g, softmin, case.epsilon, thresholds, variant.precise, near
        )
        lost = case.tolerance(variant.precise) + LEFT_OUT * variant.listed
        allowed, error = count * (UNIT * (32 + 4 * m**0.5) + 1e-5 + 2 * lost), np.inf
        if columns.min() >= 0 and columns.max() < m:
            drawn = np.array([np.bincount(row, minlength=m) for row in columns])
            error = max(0.0, largest(drawn - count * case.shares) - 1.0)
        yield case.finding(
            "sample_plan_rows", error, allowed, "draws more than one",
            precise=variant.precise, listed=variant.listed,
        )  # fmt: skip
