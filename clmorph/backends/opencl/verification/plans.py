"""Checks of the kept pairs of a plan, and of the sums over stored pairs."""

import numpy as np

from clmorph.backends.opencl.build.variants import KERNELS, Variant
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.verification.bench import (
    BLURS,
    BUDGET,
    LEFT_OUT,
    LONG_ROW,
    Bench,
    Clouds,
    Findings,
    check,
)
from clmorph.backends.opencl.verification.findings import largest
from clmorph.backends.records import PlanTerms

#: The share of the largest entry of a row, or column, above which pairs are kept.
SHARE = 1e-4


@check("plan_rows.cl")
def kept_pairs(bench: Bench, variant: Variant) -> Findings:
    """Compare counts, columns and masses of kept pairs, by thresholds of rows and of columns."""
    with bench.forced("plan_row_reductions", "always_listed", variant.listed):
        for case in bench.clouds(variant.dimension, variant.listed):
            # At smaller blurs thresholds of columns are rounded by more than precise exponents.
            if case.epsilon > BLURS[-1] ** 2:
                m, log_plan = case.shape[1], case.log_plan
                by_row, by_column = (
                    # Rows and columns without mass keep nothing.
                    np.where(np.isfinite(most), most + np.log(SHARE), np.inf)
                    for most in (log_plan.max(axis=1), log_plan.max(axis=0))
                )
                none = np.full(len(by_row), np.inf)
                # Thresholds of columns at about half of them.
                half = np.where(np.arange(m) % 2, by_column, np.inf)
                yield from _kept(case, variant.precise, (by_row, np.full(m, np.inf)), "")
                yield from _kept(case, variant.precise, (none, half), ", by column")


def _kept(case: Clouds, precise: bool, limits: tuple[np.ndarray, ...], detail: str) -> Findings:
    """Compare pairs above their thresholds."""
    (n, m), log_plan, tolerance = case.shape, case.log_plan, 2 * case.tolerance(precise)
    limit = np.minimum(limits[0][:, None], limits[1])
    plan = PlanTerms(*case.ours, case.softmin, case.g, case.epsilon, *limits)
    counts = case.operations.count_plan_rows(plan, precise)
    low, high = ((log_plan > limit + off).sum(axis=1) for off in (tolerance, -tolerance))
    wrong = np.count_nonzero((counts < low) | (counts > high))
    yield case.finding(
        "count of plan_rows", float(wrong), 0.0, "rows", precise=precise, detail=detail
    )
    if wrong:
        return  # the pairs would be written beyond the space that is counted for them
    kept = case.operations.plan_rows(plan, precise, counts)
    row, inside = np.repeat(np.arange(n), np.diff(kept.indptr)), kept.indices < m
    error = np.inf
    if np.all(inside & (kept.indices >= 0)) and len(np.unique(row * m + kept.indices)) == len(row):
        found = np.full((n, m), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            found[row, kept.indices] = np.log(kept.mass)
            both, own = found - log_plan, ~np.isnan(found)
            # Of pairs that are kept by NumPy only, and by the backend only.
            alone = np.where(own, limit - log_plan, log_plan - limit)
        alone = np.where((log_plan > limit) != own, alone, 0.0)
        error = max(largest(both[own]), largest(alone))
    yield case.finding("plan_rows", error, tolerance, precise=precise, detail=detail)


@check("sliced_ellpack.cl", *KERNELS["sliced_ellpack.cl"], *KERNELS["plan_rows.cl"],
       *KERNELS["near_field.cl"])  # fmt: skip
def stored_sums(bench: Bench, variant: Variant) -> Findings:
    """Compare sums over stored pairs: over all pairs, and over near ones above a threshold."""
    columns = LONG_ROW
    if constants := getattr(bench.operations, "constants", None):
        # Where loops end early, the pairs of longer rows are not stored.
        columns = min(columns, loop_limits.stored_pairs(constants))
    tiles, long, *lifted = bench.clouds(columns=columns)
    for case in (tiles, long, *lifted[1:2]):
        yield from _stored(case)
    for case in lifted[1:2]:
        yield from _stored(case, listed=True)


def _stored(case: Clouds, listed: bool = False) -> Findings:
    """Compare sums over stored pairs at potentials that have changed."""
    rng, (n, m) = np.random.default_rng(3), case.shape
    # With lists, changes are small: what the lists leave out must not grow into a large share.
    most = 1.0 if listed else 5.0
    changes = [np.clip(rng.normal(size=size), -most, most) for size in (m, n)]
    tolerance, lists = 2 * case.tolerance(), (None, None)
    if listed:
        back = case.exact.softmin(*case.theirs[::-1], case.softmin, case.epsilon)
        own = *case.ours[::-1], case.softmin, back, case.epsilon, BUDGET
        lists = case.near, case.operations.near_pairs(*own)
        tolerance += LEFT_OUT * np.exp(2 * most)
    sums = []
    for backend, clouds, near in (
        (case.operations, case.ours, lists), (case.exact, case.theirs, (None, None))
    ):  # fmt: skip
        limits = np.full(n, -1e3), np.full(m, -1e3)
        plan = PlanTerms(*clouds, case.softmin, case.g, case.epsilon, *limits)
        pairs = backend.store_pairs(plan, n * m, near)
        assert pairs is not None, "the pairs were not stored"
        sums.append([backend.sum_stored(pairs, changes[side], bool(side)) for side in range(2)])
    for name, got, want in zip(("rows", "columns"), *sums, strict=True):
        # Pairs of columns that lie far from all rows may be below the threshold, or not be near.
        counts = want > (-20.0 if listed else -900.0)
        error = largest(got[counts] - want[counts])
        yield case.finding("sum_stored", error, tolerance, listed=listed, detail=f", {name}")
