"""Compute exponents and plans of two clouds, in one dense block of rows after the other."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.numpy.handles import Cloud
from clmorph.backends.records import Float64, NearPairs, PlanTerms

#: Entries of a dense block of rows, so that memory stays bounded (128 MB of float64).
BLOCK_ENTRIES = 1 << 24


def costs(x: Float64, y: Float64) -> Float64:
    """Return |x_i - y_j|^2 / 2 (paper, Eq. 1, with the factor 1/2)."""
    costs = np.zeros((len(x), len(y)))
    for d in range(x.shape[1]):
        costs += 0.5 * (x[:, d, None] - y[:, d]) ** 2
    return costs


def exponent_blocks(
    rows: Cloud, columns: Cloud, potential: Float64, epsilon: float, near: NearPairs | None = None
) -> Iterator[tuple[slice, Float64]]:
    """Yield (g_j - C_ij) / epsilon + log b_j for blocks of rows."""
    step = max(1, BLOCK_ENTRIES // max(1, len(columns.points)))
    for first in range(0, len(rows.points), step):
        check_cancelled()
        block = slice(first, first + step)
        exponents = -costs(rows.points[block], columns.points)
        exponents += potential - columns.offsets
        exponents -= rows.offsets[block, None]
        exponents /= epsilon
        exponents += columns.log_weights
        if near is not None:
            exponents[~near.pairs[block]] = -np.inf
        yield block, exponents


def plan_blocks(plan: PlanTerms) -> Iterator[tuple[slice, Float64, NDArray[np.bool_]]]:
    """Yield log pi_ij and the mask of kept pairs, for blocks of rows."""
    rows, columns, f, g, epsilon, row_thresholds, column_thresholds, _ = plan
    for block, exponents in exponent_blocks(rows, columns, g, epsilon):
        log_plan = exponents + (f[block] / epsilon + rows.log_weights[block])[:, None]
        keep = log_plan > np.minimum(row_thresholds[block][:, None], column_thresholds)
        yield block, log_plan, keep & (log_plan > -np.inf)
