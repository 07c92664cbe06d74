"""Compare a device with NumPy in every operation and in one whole morph."""

import platform
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.comparison import (
    LARGEST_BOUND,
    UNIT,
    Finding,
    splat_excess,
    splat_tolerance,
)
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.records import Float64
from clmorph.backends.rounding import rounding_error
from clmorph.backends.width_levels import WIDTH_LEVELS
from clmorph.measures.lift import lift
from clmorph.measures.measure import Measure
from clmorph.pipeline.morph import morph
from clmorph.transport._solver.problem import largest_cost

Cloud = tuple[NDArray[np.float64], NDArray[np.float64]]


def log_sum_exp_tolerance(
    operations: Operations, rows: Cloud, columns: Cloud, epsilon: float, precise: bool = False
) -> float:
    """Return the tolerated error, in nats, of a log-sum-exp of `operations`.

    Parameters
    ----------
    operations : Operations
    rows, columns : (points (N, D), weights (N,))
    epsilon : float
    precise : bool
    """
    largest = largest_cost(rows[0], columns[0]) / epsilon
    return rounding_error(operations, len(columns[1]), largest, precise)


def _picture(side: int, phase: float) -> NDArray[np.float64]:
    """Draw a smooth test picture."""
    y, x = np.mgrid[:side, :side] / side
    waves = [np.sin(5 * x + k * y + phase) * np.cos(3 * y - k * phase) for k in (1, 3, 6)]
    return 0.5 + 0.5 * np.stack(waves, axis=-1)


def _cloud(measure: Measure) -> Cloud:
    return measure.points, measure.weights


def check(operations: Operations) -> Iterator[Finding]:
    """Compare a backend with NumPy, one operation after the other.

    Parameters
    ----------
    operations : Operations

    Yields
    ------
    Finding
    """
    exact = NumPyOperations()
    source, target = lift(_picture(37, 0.2)), lift(_picture(31, 1.7))
    pair = _cloud(source), _cloud(target)
    ours = operations.upload(*pair[0]), operations.upload(*pair[1])
    theirs = exact.upload(*pair[0]), exact.upload(*pair[1])
    rng = np.random.default_rng(0)
    for blur in (1.0, 0.05, 0.003):
        epsilon = blur**2
        g = epsilon * rng.normal(size=len(target))
        for name, options in (("softmin", ()), ("softmin", (True,)), ("row_maxima", ())):
            tolerance = log_sum_exp_tolerance(operations, *pair, epsilon, *options)
            unit = epsilon if name == "softmin" else 1.0
            got = getattr(operations, name)(*ours, g, epsilon, *options)
            want = getattr(exact, name)(*theirs, g, epsilon)
            error = float(np.abs(got - want).max() / unit)
            kind = "precise " * len(options) + name
            yield Finding(f"{kind}, blur {blur:g}", error, tolerance, "nats")
        want = exact.softmin(*theirs, g, epsilon)
        got, bound = operations.bounded_softmin(*ours, g, epsilon)
        error = float(np.abs(got - want).max() / epsilon)
        bound = min(bound, LARGEST_BOUND) + exact.bounded_softmin(*theirs, g, epsilon)[1]
        yield Finding(f"bounded_softmin, blur {blur:g}", error, bound, "nats")
        yield _check_near(operations, ours, pair, g, want, blur)
    yield _check_plan(operations, exact, ours, theirs, pair)
    yield from _check_stored(operations, exact, ours, theirs, pair)
    yield from _check_rows(operations, exact, pair)
    yield from _check_splats(operations, exact)
    yield from _check_own_widths(operations, exact)
    yield _check_morph(operations)


def _check_near(
    operations: Operations,
    ours: tuple[Any, Any],
    pair: tuple[Cloud, Cloud],
    g: Float64,
    want: Float64,
    blur: float,
) -> Finding:
    """Check that near pairs leave out no more than the reported bound and the truncation."""
    epsilon, budget = blur**2, 1e-4
    near = operations.near_pairs(*ours, g, want, epsilon, budget)
    tolerance = log_sum_exp_tolerance(operations, *pair, epsilon)
    excess = [float(near.skipped.max() - 1.5 * budget)]
    for got in (near.softmin, operations.softmin(*ours, g, epsilon, False, near)):
        missing = (got - want) / epsilon
        excess += [float((missing - near.skipped).max()), float(-missing.min())]
    return Finding(f"near_pairs, blur {blur:g}", max(0.0, *excess), tolerance, "nats")


def _check_plan(
    operations: Operations,
    exact: Operations,
    ours: tuple[Any, Any],
    theirs: tuple[Any, Any],
    pair: tuple[Cloud, Cloud],
) -> Finding:
    epsilon, share = 0.0025, 1e-4
    f = exact.softmin(*theirs, np.zeros(len(pair[1][1])), epsilon)
    g = exact.softmin(theirs[1], theirs[0], f, epsilon)
    largest = exact.row_maxima(*theirs, g, epsilon) + f / epsilon + np.log(pair[0][1])
    thresholds = (largest + np.log(share), np.full(len(g), np.inf))
    plans = []
    for backend, clouds in ((operations, ours), (exact, theirs)):
        rows = backend.plan_rows(*clouds, f, g, epsilon, *thresholds)
        plan = np.zeros((len(f), len(g)))
        plan[np.repeat(np.arange(len(f)), np.diff(rows.indptr)), rows.indices] = rows.mass
        plans.append(plan)
    # One backend alone may keep a pair at the threshold, whose mass is `share` of the largest.
    error = float(np.max(np.abs(plans[0] - plans[1]) / np.exp(largest)[:, None]))
    tolerance = share + 2 * log_sum_exp_tolerance(operations, *pair, epsilon)
    return Finding("plan_rows", error, tolerance, "of a row's largest")


def _check_stored(
    operations: Operations,
    exact: Operations,
    ours: tuple[Any, Any],
    theirs: tuple[Any, Any],
    pair: tuple[Cloud, Cloud],
) -> Iterator[Finding]:
    """Check sums over stored pairs, with all pairs stored, at potentials that have changed."""
    rng, epsilon = np.random.default_rng(3), 0.0025
    sizes = len(pair[0][1]), len(pair[1][1])
    f = exact.softmin(*theirs, np.zeros(sizes[1]), epsilon)
    lowest = np.full(sizes[0], -1e3), np.full(sizes[1], -1e3)
    tolerance = 2 * log_sum_exp_tolerance(operations, *pair, epsilon)
    changes = rng.normal(size=sizes[1]), rng.normal(size=sizes[0])
    for by_column, name in enumerate(("rows", "columns")):
        sums = []
        for backend, clouds in ((operations, ours), (exact, theirs)):
            stored = backend.store_pairs(
                *clouds, f, np.zeros(sizes[1]), epsilon, *lowest, sizes[0] * sizes[1]
            )
            assert stored is not None
            sums.append(backend.sum_stored(stored, changes[by_column], bool(by_column)))
        error = float(np.abs(sums[0] - sums[1]).max())
        yield Finding(f"sum_stored, {name}", error, tolerance, "nats")


def _check_rows(
    operations: Operations, exact: Operations, pair: tuple[Cloud, Cloud]
) -> Iterator[Finding]:
    """Check moments of plan rows, draws from plan rows, and costs with offsets."""
    rng = np.random.default_rng(2)
    epsilon, m = 0.0025, len(pair[1][1])
    g = epsilon * rng.normal(size=m)
    added = rng.normal(size=len(pair[0][1])), rng.normal(size=m)
    softmins: list[Float64] = []
    for backend in (operations, exact):
        rows, columns = (
            backend.upload(*cloud, offsets) for cloud, offsets in zip(pair, added, strict=True)
        )
        softmins.append(backend.softmin(rows, columns, g + added[1], epsilon))
    tolerance = log_sum_exp_tolerance(operations, *pair, epsilon)
    error = float(np.abs(softmins[0] - softmins[1]).max() / epsilon)
    yield Finding("softmin with offsets", error, tolerance, "nats")

    clouds = [
        (backend.upload(*pair[0]), backend.upload(*pair[1])) for backend in (operations, exact)
    ]
    softmin = exact.softmin(*clouds[1], g, epsilon)
    moments = [
        backend.plan_moments(*both, g, softmin, epsilon, True)
        for backend, both in zip((operations, exact), clouds, strict=True)
    ]
    size = float(np.ptp(np.concatenate([cloud[0] for cloud in pair]), axis=0).max())
    tolerance = UNIT * (32 + 4 * m**0.5)
    for name, got, want, scale in zip(
        ("mean", "covariance"), *moments, (2 * size, 8 * size**2), strict=True
    ):
        error = float(np.abs(got - want).max() / scale)
        yield Finding(f"plan_moments, {name}", error, tolerance, "of the clouds' size")

    # Equally spaced thresholds draw every column in proportion to its share, to within one draw.
    few = pair[0][0][:4], pair[0][1][:4]
    own, theirs = operations.upload(*few), exact.upload(*few)
    draws = 2000
    thresholds = np.tile((np.arange(draws) + 0.5) / draws, (4, 1))
    softmin = exact.softmin(theirs, clouds[1][1], g, epsilon)
    columns = operations.sample_plan_rows(own, clouds[0][1], g, softmin, epsilon, thresholds, True)
    rows_of = exact.plan_rows(
        theirs, clouds[1][1], softmin, g, epsilon, np.full(4, -np.inf), np.full(m, np.inf)
    )
    shares = np.zeros((4, m))
    shares[np.repeat(np.arange(4), np.diff(rows_of.indptr)), rows_of.indices] = rows_of.mass
    shares /= few[1][:, None]
    counts = np.array([np.bincount(row, minlength=m) for row in columns])
    error = float(np.abs(counts - draws * shares).max())
    yield Finding("sample_plan_rows", error, 1.1, "draws")


def _check_splats(operations: Operations, exact: Operations) -> Iterator[Finding]:
    rng = np.random.default_rng(1)
    count, shape = 20_000, (61, 83)
    positions = rng.uniform(-2, 84, (count, 2)).astype(np.float32)
    colors = rng.random((count, 3)).astype(np.float32)
    weights = (10 ** rng.uniform(-10, 0, count)).astype(np.float32)
    backends = (operations, exact)
    ours, theirs = (backend.upload_splats(positions, colors, weights) for backend in backends)
    got, want = operations.bin_splats(ours, shape, 2), exact.bin_splats(theirs, shape, 2)
    wrong = np.count_nonzero(got.starts != want.starts) + np.count_nonzero(got.order != want.order)
    yield Finding("bin_splats", float(wrong), 0.0, "entries")
    for sigma in (0.0, 0.6, 5.0):
        sums = operations.splat(ours, shape, sigma, 4.5 * sigma)
        error = splat_excess(
            sums, exact, theirs, shape, sigma, 4.5 * sigma, splat_tolerance(count)
        )  # fmt: skip
        yield Finding(f"splat, sigma {sigma:g}", error, 1.0, "of the tolerance")


def _check_own_widths(operations: Operations, exact: Operations) -> Iterator[Finding]:
    """Check the operations from which "local" widths are computed."""
    rng = np.random.default_rng(3)
    count, shape, sigma = 4_000, (61, 83), 0.7
    positions = rng.uniform(-2, 84, (count, 2)).astype(np.float32)
    colors = rng.random((count, 3)).astype(np.float32)
    weights = rng.random(count).astype(np.float32)
    spacings = (2 ** rng.uniform(-3, 3, count)).astype(np.float32)
    distances = 2 ** rng.uniform(-3, 6, shape)
    ours, theirs = (
        backend.upload_splats(positions, colors, weights, spacings)
        for backend in (operations, exact)
    )
    relative = splat_tolerance(count)
    for name, got, want in zip(
        ("masses", "squares"), operations.deposit(ours, shape), exact.deposit(theirs, shape),
        strict=True,
    ):  # fmt: skip
        error = float(np.max(np.abs(got - want) / np.maximum(want, 1e-9)))
        yield Finding(f"deposit, {name}", error, relative, "of the sum")
    ours = operations.adapt_widths(ours, distances, sigma)
    theirs = exact.adapt_widths(theirs, distances, sigma)
    levels = operations.width_levels(ours)
    # Rounding decides the level of widths that lie on the border between two levels.
    wrong = np.count_nonzero(levels != exact.width_levels(theirs))
    yield Finding("adapt_widths", float(wrong), 1e-3 * count, "levels")
    scaled = weights.astype(float) / WIDTH_LEVELS.factor(levels) ** 2
    same = theirs._replace(width_levels=levels, weights=scaled)
    sums = operations.splat(ours, shape, sigma, 4.5 * sigma)
    error = splat_excess(sums, exact, same, shape, sigma, 4.5 * sigma, 2 * relative)
    yield Finding("splat, own widths", error, 1.0, "of the tolerance")


def _check_morph(operations: Operations) -> Finding:
    images = _picture(20, 0.4), _picture(24, 2.9)
    ours, theirs = (
        morph(*images, n_frames=3, backend=backend) for backend in (operations, NumPyOperations())
    )
    error = max(float(np.abs(a - b).max()) for a, b in zip(ours.frames, theirs.frames, strict=True))
    return Finding("morph", 255 * error, 1.0, "of 255")


def report(device: Any, findings: list[Finding], pairs_per_second: float) -> dict[str, Any]:
    """Collect the data about a device for a report, without personal data.

    Parameters
    ----------
    device : clmorph.backends.opencl.devices.find.Device
    findings : list of Finding
    pairs_per_second : float

    Returns
    -------
    dict
        A dictionary that JSON can represent.
    """
    from clmorph._shared.version import __version__

    return {
        "clmorph": __version__,
        "system": f"{platform.system()} {platform.machine()}",
        "device": device.record(),
        "pairs_per_second": pairs_per_second,
        "findings": [asdict(finding) | {"passed": finding.passed} for finding in findings],
    }
