"""Sums over grids, one axis after the other, in NumPy."""

from collections.abc import Sequence

import numpy as np

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.records import Float64

#: Terms of a block of lines, so that memory stays bounded (32 MB of float64).
BLOCK_TERMS = 1 << 22


def grid_log_sum_exp(exponents: Float64, axes: Sequence[tuple[Float64, Float64]]) -> Float64:
    """Return log sum_j exp(e_j - |x_i - y_j|^2); see `clmorph.backends.interface.Operations`."""
    values = exponents
    # The last axis becomes the first one each time, so that all come back to their places.
    for x, y in reversed(axes):
        costs = (x[:, None] - y) ** 2
        lines = values.reshape(-1, len(y))
        found = np.empty((len(x), len(lines)))
        step = max(1, BLOCK_TERMS // costs.size)
        for first in range(0, len(lines), step):
            check_cancelled()
            part = slice(first, first + step)
            terms = lines[part, None, :] - costs
            largest = np.maximum(terms.max(axis=2), np.finfo(float).min)
            terms -= largest[..., None]
            with np.errstate(divide="ignore"):
                found[:, part] = (np.log(np.exp(terms, out=terms).sum(axis=2)) + largest).T
        values = found.reshape(len(x), *values.shape[:-1])
    return values
