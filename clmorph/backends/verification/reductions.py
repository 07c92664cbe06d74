"""Checks of the reductions over rows: soft minima, maxima, near pairs, moments and draws."""

from collections.abc import Iterator

import numpy as np

from clmorph.backends.comparison import LARGEST_BOUND, UNIT, Finding
from clmorph.backends.records import Float64
from clmorph.backends.verification.clouds import BUDGET, CloudCase

#: The rounding error, in nats, that a bounded softmin over near pairs may have. Powers in float32
#: need less; in five dimensions exponents are then float32 between some tiles, and float64 between
#: others.
ENOUGH = 1e-4


def check_softmin(
    case: CloudCase, precise: bool = False, listed: bool = False
) -> Iterator[Finding]:
    """Compare soft minima; over near pairs, within the share that these leave out."""
    ours, epsilon = case.ours, case.epsilon
    near = case.near if listed else None
    got = case.operations.softmin(*ours, case.g, epsilon, precise, near)
    name = f"{'precise ' * precise}softmin{' over near pairs' * listed}{case.name}"
    yield Finding(name, _off(case, got, near), case.tolerance(precise), "nats")


def _off(case: CloudCase, got: Float64, near: object = None) -> float:
    """Return the largest error of soft minima, in nats, beyond what near pairs leave out."""
    missing = (got - case.softmin) / case.epsilon
    if near is None:
        return float(np.abs(missing).max())
    # np.max keeps NaN, unlike max.
    return float(np.max([0.0, (missing - case.near.skipped).max(), -missing.min()]))


def check_row_maxima(case: CloudCase) -> Iterator[Finding]:
    """Compare the largest exponent of every row."""
    got = case.operations.row_maxima(*case.ours, case.g, case.epsilon)
    want = case.exact.row_maxima(*case.theirs, case.g, case.epsilon)
    error = float(np.abs(got - want).max())
    yield Finding(f"row_maxima{case.name}", error, case.tolerance(), "nats")


def check_bounded_softmin(
    case: CloudCase, listed: bool = False, enough: float = 0.0
) -> Iterator[Finding]:
    """Check that soft minima are within the error bound that comes with them."""
    near = case.near if listed else None
    got, bound = case.operations.bounded_softmin(*case.ours, case.g, case.epsilon, near, enough)
    _, exact_bound = case.exact.bounded_softmin(*case.theirs, case.g, case.epsilon)
    tolerance = min(bound, enough + LARGEST_BOUND) + exact_bound
    name = f"bounded_softmin{' over near pairs' * listed}{case.name}"
    yield Finding(name, _off(case, got, near), tolerance, "nats")


def check_near_pairs(case: CloudCase) -> Iterator[Finding]:
    """Check that near pairs leave out no more than they report, and that little is reported."""
    near = case.near
    over_near = case.operations.softmin(*case.ours, case.g, case.epsilon, False, near)
    errors = (
        near.skipped.max() - 1.5 * BUDGET,
        _off(case, near.softmin, near),
        _off(case, over_near, near),
    )
    error = float(np.max(errors))
    yield Finding(f"near_pairs{case.name}", error, case.tolerance(), "nats")


def check_projection(
    case: CloudCase, precise: bool = False, listed: bool = False
) -> Iterator[Finding]:
    """Compare soft minima and the mean of each row's destinations, which one pass computes."""
    near = case.near if listed else None
    softmin, mean = case.operations.barycentric_projection(
        *case.ours, case.g, case.epsilon, precise, near
    )
    name = f"{'precise ' * precise}barycentric_projection{' over near pairs' * listed}{case.name}"
    yield Finding(f"{name}, softmin", _off(case, softmin, near), case.tolerance(precise), "nats")
    tolerance, size = _moments_tolerance(case, precise, listed)
    error = float(np.abs(mean - case.moments[0]).max() / (2 * size))
    yield Finding(f"{name}, mean", error, tolerance, "of the clouds' size")


def _moments_tolerance(case: CloudCase, precise: bool, listed: bool) -> tuple[float, float]:
    """Return the tolerated error of moments relative to the clouds' size, and this size."""
    columns = case.columns[0]
    size = float(np.ptp(np.concatenate((case.rows[0], columns)), axis=0).max())
    # Errors of an exponent cancel in part, because moments are divided by the row's sum.
    tolerance = UNIT * (32 + 4 * len(columns) ** 0.5) + (0 if precise else case.tolerance())
    return tolerance + 1.5 * BUDGET * listed, size


def check_plan_moments(
    case: CloudCase, precise: bool = False, listed: bool = False
) -> Iterator[Finding]:
    """Compare mean and covariance of each row's destinations."""
    near, softmin = None, case.softmin
    if listed:
        near = case.near
        softmin = case.operations.softmin(*case.ours, case.g, case.epsilon, precise, near)
    got = case.operations.plan_moments(*case.ours, case.g, softmin, case.epsilon, precise, near)
    want = case.moments
    tolerance, size = _moments_tolerance(case, precise, listed)
    kind = f"{'precise ' * precise}plan_moments{' over near pairs' * listed}{case.name}"
    scales = 2 * size, 8 * size**2
    for name, mine, exact, scale in zip(("mean", "covariance"), got, want, scales, strict=True):
        error = float(np.abs(mine - exact).max() / scale)
        yield Finding(f"{kind}, {name}", error, tolerance, "of the clouds' size")


def check_draws(
    case: CloudCase, precise: bool = False, listed: bool = False, draws: int = 200
) -> Iterator[Finding]:
    """Check that equally spaced thresholds draw each column in proportion to its share.

    To within one draw they do, in any order of the columns. The error is what is beyond that.
    """
    n, m = len(case.rows[1]), len(case.columns[1])
    thresholds = np.tile((np.arange(draws) + 0.5) / draws, (n, 1))
    near, softmin = None, case.softmin
    if listed:
        near = case.near
        softmin = case.operations.softmin(*case.ours, case.g, case.epsilon, precise, near)
    columns = case.operations.sample_plan_rows(
        *case.ours, case.g, softmin, case.epsilon, thresholds, precise, near
    )
    name = f"{'precise ' * precise}sample_plan_rows{' over near pairs' * listed}{case.name}"
    lost = case.tolerance(precise) + 1.5 * BUDGET * listed
    tolerance = draws * (UNIT * (32 + 4 * m**0.5) + 1e-5 + 2 * lost)
    if not (columns.min() >= 0 and columns.max() < m):
        yield Finding(name, np.inf, tolerance, "draws more than one")
        return
    # With the rows' masses as 1, so that shares of rows without mass count too.
    rows = case.exact.upload(case.rows[0], np.ones(n))
    plan = case.exact.plan_rows(
        rows, case.theirs[1], case.softmin, case.g, case.epsilon, np.full(n, -np.inf),
        np.full(m, np.inf),
    )  # fmt: skip
    shares = np.zeros((n, m))
    shares[np.repeat(np.arange(n), np.diff(plan.indptr)), plan.indices] = plan.mass
    counts = np.array([np.bincount(row, minlength=m) for row in columns])
    error = max(0.0, float(np.abs(counts - draws * shares).max()) - 1.0)
    yield Finding(name, error, tolerance, "draws more than one")


def check_offsets(case: CloudCase) -> Iterator[Finding]:
    """Compare soft minima of costs with terms of the rows and of the columns."""
    rng = np.random.default_rng(2)
    added = rng.normal(size=len(case.rows[1])), rng.normal(size=len(case.columns[1]))
    softmins = []
    for backend in (case.operations, case.exact):
        rows = backend.upload(*case.rows, added[0])
        columns = backend.upload(*case.columns, added[1])
        softmins.append(backend.softmin(rows, columns, case.g + added[1], case.epsilon))
    error = float(np.abs(softmins[0] - softmins[1]).max() / case.epsilon)
    yield Finding(f"softmin with offsets{case.name}", error, case.tolerance(), "nats")
