"""The log-sum-exp of ``cl_kernels/log_sum_exp.cl``: soft minima and the rows' maxima."""

from typing import Any

import numpy as np

from clmorph.backends.opencl.build.constants import PRECISE_UNROLL, SENTINEL, BuildConstants
from clmorph.backends.opencl.kernels.clouds import Cloud, unsort
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs
from clmorph.backends.records import Float64, NearPairs

#: Relative errors of an operation, and of a power of two, in pairs of float32.
PAIRS_ERRORS = 2.0**-45, 2.0**-31
#: Relative errors of float32: of an operation, and of a power of two (by a polynomial or built in).
FLOAT32_ERRORS = 2.0**-24, 2.0**-21
#: No power is less than this, see ``exp2_nonpositive`` of ``cl_kernels/common.cl``.
SMALLEST_POWER = 2.0**-124
#: The error bound holds if a row's maximum (log2) is at most the first number, because float32
#: rounds larger ones too coarsely. A sum is then larger than the second number.
LARGEST_MAXIMUM, SMALLEST_SUM = 2.0**28, 2.0**-70


class LogSumExp:
    """Log-sum-exp over the columns of every row.

    Parameters
    ----------
    loop : RowLoop
    """

    def __init__(self, loop: RowLoop) -> None:
        self._loop = loop

    def softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)."""
        maxima, sums, offsets = self._log_sum_exp(rows, columns, potential, epsilon, precise, near)
        # Overflow gives NaN if float32 cannot hold the numbers; the caller checks the results.
        with np.errstate(invalid="ignore"):
            return unsort(rows, -epsilon / LOG2_E * (maxima + offsets + np.log2(sums)))

    def bounded_softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> tuple[Float64, float]:
        """Return T(g) with a proven bound of its rounding error, in nats.

        Over near pairs powers are float32: their error is less than that of the pairs left out.
        """
        bounded = 1 if near is None else 2
        maxima, sums, offsets = self._log_sum_exp(
            rows, columns, potential, epsilon, True, near, bounded
        )
        error = np.inf
        smallest = float(sums.min())
        if np.abs(maxima).max() <= LARGEST_MAXIMUM and smallest > SMALLEST_SUM:
            error = self._error_bound(rows, columns, potential, epsilon)
            if min(bounded, self._loop.constants.precise) == 2:
                error += float32_powers_bound(columns.stride, smallest)
        with np.errstate(invalid="ignore", divide="ignore"):
            softmin = -epsilon / LOG2_E * (maxima + offsets + np.log2(sums))
        return unsort(rows, softmin), error

    def _error_bound(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float
    ) -> float:
        """Return the bound of `bounded_softmin` in nats."""
        k = LOG2_E / epsilon
        low = np.minimum(rows.box[0], columns.box[0])
        high = np.maximum(rows.box[1], columns.box[1])
        values = (potential[columns.order] - columns.offsets) * k + columns.log2_weights
        values = values[columns.log2_weights > 0.5 * SENTINEL]
        largest = float(np.abs(values).max()) + k * float(np.abs(rows.offsets).max())
        costs = 0.5 * k * float(np.sum((high - low) ** 2))
        return float(
            rounding_bound(
                self._loop.constants, columns.centers.shape[1], costs, float(np.ptp(values)),
                largest, len(columns.centers),
            )
        )  # fmt: skip

    def row_maxima(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        maxima, _, offsets = self._log_sum_exp(rows, columns, potential, epsilon, False, near)
        return unsort(rows, (maxima + offsets) / LOG2_E)

    def _log_sum_exp(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool,
        near: NearPairs | None = None,
        bounded: int = 0,
    ) -> tuple[Float64, Float64, Float64]:
        pairs = None if near is None else near.pairs
        return self.of_sorted(rows, columns, potential, epsilon, precise, pairs, bounded)

    def of_sorted(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool,
        pairs: TilePairs | None = None,
        bounded: int = 0,
    ) -> tuple[Float64, Float64, Float64]:
        """Return maximum, sum and offset of every sorted row.

        The row's log-sum-exp, to base 2, is maximum + offset + log2(sum).
        """
        loop, tile = self._loop, self._loop.constants.tile
        kernel = loop.kernel(
            "log_sum_exp.cl", "log_sum_exp", rows, precise, pairs is not None, bounded
        )
        exponents = loop.exponents(rows, columns, potential, epsilon, pairs, precise=precise)
        shares = loop.column_shares(rows, columns, pairs)
        maxima, sums = np.empty(rows.stride), np.empty(rows.stride)
        for part in loop.parts(kernel, rows, columns, pairs=pairs, shares=shares):
            n_rows = len(part) * tile
            found = np.empty((shares, n_rows), np.float32)
            # The buffer holds the sums and the rounding errors of their nearest float32.
            planes = np.empty((2 if bounded else 1, shares, n_rows), np.float32)
            buffers = loop.work.empty(found.nbytes), loop.work.empty(planes.nbytes)
            loop.launch(
                kernel, rows, columns, exponents, part, np.uint32(n_rows), *buffers,
                shares=shares, precise=precise, pairs=pairs,
                results=tuple(zip((found, planes), buffers, strict=True)),
            )  # fmt: skip
            section = slice(part.start * tile, part.stop * tile)
            if shares == 1 and not bounded:
                maxima[section], sums[section] = found[0], planes[0, 0]
                continue
            of_shares = planes.astype(float).sum(axis=0)
            m = found.max(axis=0).astype(float)
            maxima[section] = m
            sums[section] = np.sum(of_shares * np.exp2(found - m), axis=0)
        n = len(rows)
        return maxima[:n], sums[:n], loop.row_offsets(rows, exponents)


def rounding_bound(
    constants: BuildConstants,
    dimension: int,
    costs: Any,
    spread: Any,
    largest: Any,
    n_tiles: Any,
) -> Any:
    """Return a bound of a log-sum-exp in nats, with every rounding error at its largest.

    An exponent is a sum of products no larger than `size`, formed in 3 D + 6 operations from
    numbers that pairs of float32 hold to 2^-49. The constant of a row is at most `of_row`
    and is formed in float64. See ``cl_kernels/sums.cl`` for powers and additions.

    Parameters
    ----------
    constants : BuildConstants
    dimension : int
        Dimension of the points.
    costs : float, or an array of them
        k times the largest cost.
    spread, largest : float
        Range of k g_j + log2 b_j over the columns with mass, and their largest absolute value, with
        the rows' offsets added.
    n_tiles : int
        Number of column tiles.
    """
    operation, power = (2.0**-53, 2.0**-44) if constants.precise == 2 else PAIRS_ERRORS
    size, of_row = 8 * costs + 2 * spread, costs + largest
    exponents = size * ((3 * dimension + 6) * operation + 2.0**-47) + 2.0**-49 * of_row
    sums = power + (constants.tile + n_tiles) * operation + 2.0**-46
    return np.log(2) * exponents + sums


def float32_powers_bound(n_columns: int, smallest: float) -> float:
    """Return what float32 powers add to the bound of a log-sum-exp, in nats.

    The distances x_j <= 0 of exponents from their reference are rounded to float32. This changes
    the logarithm of the sum S = sum_j 2^x_j by at most ln 2 times the relative error of float32
    times sum_j w_j |x_j|, where w_j = 2^x_j / S. The latter sum is the entropy of w less log2 S.

    Parameters
    ----------
    n_columns : int
        Number of terms of a sum.
    smallest : float
        The smallest sum of a row.
    """
    operation, power = FLOAT32_ERRORS
    distances = np.log2(n_columns) - min(0.0, np.log2(smallest)) + 1.0
    clipped = n_columns * SMALLEST_POWER / smallest
    added = np.log(2) * operation * distances + power + PRECISE_UNROLL * operation + clipped
    return float(1.01 * added)
