"""Checks of the kept pairs of a plan, and of the sums over stored pairs."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.comparison import Finding
from clmorph.backends.records import NearPairs
from clmorph.backends.verification.clouds import BUDGET, CloudCase

#: The share of the largest entry of a row, or column, above which pairs are kept.
SHARE = 1e-4


def check_plan_rows(case: CloudCase, precise: bool = False) -> Iterator[Finding]:
    """Compare counts, columns and masses of kept pairs, by thresholds of rows and of columns.

    The error is that of log pi_ij of pairs that both keep; of a pair that only one keeps, the
    distance of its log pi_ij from the threshold. Where rows are searched by lists of tiles, so
    are those of both plans.
    """
    n, m = len(case.rows[1]), len(case.columns[1])
    log_plan = case.log_plan
    by_row, by_column = (
        # Rows and columns without mass keep nothing.
        np.where(np.isfinite(largest), largest + np.log(SHARE), np.inf)
        for largest in (log_plan.max(axis=1), log_plan.max(axis=0))
    )
    tolerance = 2 * case.tolerance(precise)
    kind = f"{'precise ' * precise}plan_rows{case.name}"
    for name, limits in (
        ("", (by_row, np.full(m, np.inf))),
        # Thresholds of columns at about half of them.
        (", by column", (np.full(n, np.inf), np.where(np.arange(m) % 2, by_column, np.inf))),
    ):
        limit = np.minimum(limits[0][:, None], limits[1])
        rows, columns = case.ours
        ours = rows, columns, case.f, case.g, case.epsilon, limits[0], limits[1], precise
        counts = case.operations.count_plan_rows(*ours)
        most = (log_plan > limit - tolerance).sum(axis=1)
        least = (log_plan > limit + tolerance).sum(axis=1)
        wrong = np.count_nonzero((counts < least) | (counts > most))
        yield Finding(f"count of {kind}{name}", float(wrong), 0.0, "rows")
        if wrong:
            return  # the pairs would be written beyond the space that is counted for them
        kept = case.operations.plan_rows(*ours, counts)
        found = np.full((n, m), np.nan)
        inside = (kept.indices >= 0) & (kept.indices < m)
        row = _rows(kept.indptr)
        with np.errstate(divide="ignore", invalid="ignore"):
            found[row[inside], kept.indices[inside]] = np.log(kept.mass[inside])
            off = np.where(np.isnan(found), log_plan - limit, np.abs(found - log_plan))
        # A pair that was not kept is off by what its log pi_ij is above the threshold.
        error = float(np.nan_to_num(off, nan=np.inf, neginf=-np.inf).max(initial=0.0))
        if not inside.all() or len(np.unique(row * m + kept.indices)) < len(row):
            error = np.inf
        extra = np.where(np.isnan(found), 0.0, limit - log_plan)
        error = max(error, float(extra.max(initial=0.0)))
        yield Finding(f"{kind}{name}", error, tolerance, "nats")


def _rows(indptr: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the row of each pair."""
    return np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))


def check_stored(case: CloudCase, listed: bool = False) -> Iterator[Finding]:
    """Compare sums over stored pairs at potentials that have changed.

    Without lists all pairs are stored; with lists, those above a threshold that are near.
    """
    rng = np.random.default_rng(3)
    n, m = len(case.rows[1]), len(case.columns[1])
    # With lists, changes are small: what the lists leave out must not grow into a large share.
    largest = 1.0 if listed else 5.0
    changes = [np.clip(rng.normal(size=size), -largest, largest) for size in (m, n)]
    tolerance = 2 * case.tolerance()
    lists: tuple[NearPairs | None, NearPairs | None] = (None, None)
    if listed:
        rows, columns = case.ours
        back = case.exact.softmin(case.theirs[1], case.theirs[0], case.f, case.epsilon)
        near = case.operations.near_pairs(columns, rows, case.f, back, case.epsilon, BUDGET)
        lists = case.near, near
        tolerance += 1.5 * BUDGET * np.exp(2 * largest)
    stored = []
    for backend, clouds, near_lists in (
        (case.operations, case.ours, lists),
        (case.exact, case.theirs, (None, None)),
    ):
        rows, columns = clouds
        pairs = backend.store_pairs(
            rows, columns, case.f, case.g, case.epsilon, np.full(n, -1e3), np.full(m, -1e3),
            n * m, near_lists,
        )  # fmt: skip
        assert pairs is not None, "the pairs were not stored"
        stored.append((backend, pairs))
    for by_column, name in enumerate(("rows", "columns")):
        got, want = (
            backend.sum_stored(pairs, changes[by_column], bool(by_column))
            for backend, pairs in stored
        )
        # Pairs of columns that lie far from all rows may be below the threshold, or not be near.
        counts = want > (-20.0 if listed else -900.0)
        error = np.abs(got[counts] - want[counts])
        where = " over near pairs" * listed
        yield Finding(
            f"sum_stored{where}{case.name}, {name}",
            float(np.nan_to_num(error, nan=np.inf).max(initial=0.0)), tolerance, "nats",
        )  # fmt: skip
