"""Bounds of the rounding errors in the log-sum-exp of ``cl_kernels/log_sum_exp.cl``."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SENTINEL, BuildConstants
from clmorph.backends.opencl.kernels.clouds import Cloud, pad
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs
from clmorph.backends.records import Float64

#: Relative errors of an operation, and of a power of two, in pairs of float32.
PAIRS_ERRORS = 2.0**-45, 2.0**-31
#: Relative errors of float32: of an operation, and of a power of two (by a polynomial or built in).
FLOAT32_ERRORS = 2.0**-24, 2.0**-21
#: No power is less than this, see ``exp2_nonpositive`` of ``cl_kernels/common.cl``.
SMALLEST_POWER = 2.0**-124
#: The error bound holds if a row's maximum (log2) is at most the first number, because float32
#: rounds larger ones too coarsely. A sum is then larger than the second number.
LARGEST_MAXIMUM, SMALLEST_SUM = 2.0**28, 2.0**-70
#: Largest cost, in units of epsilon, at which every row is within these two numbers, by the width
#: of exponents (`BuildConstants.precise`): points are less than 20,000 blurs apart in float64.
#: Within one box, row maxima are at most log2(e) / 2 times the cost, and the references of powers
#: (``cl_kernels/sums.cl``) are less than 64 above them. With pairs of float32, whose terms are
#: larger than their sum, points are less than 5,000 blurs apart.
MAX_DEVICE_SPREAD = {2: 2e8, 1: 1.25e7}
#: Sums of powers are not smaller than this, as the largest power of a row is at least 1/2 but for
#: rounding: a sum has a bound before it is known.
USUAL_SUM = 0.25


def rounding_bound(
    constants: BuildConstants, dimension: int, costs: Any, spread: Any, largest: Any, n_tiles: Any
) -> Any:
    """Return a bound of a log-sum-exp in nats, with every rounding error at its largest.

    An exponent is a sum of products no larger than `size`, formed in 3 D + 6 operations from
    numbers that pairs of float32 hold to 2^-49. The constant of a row is at most `of_row` and is
    formed in float64. See ``cl_kernels/sums.cl`` for powers and additions. `costs` is k times the
    largest cost; `spread` and `largest` are the range of k g_j + log2 b_j over the columns with
    mass, and their largest absolute value, with the rows' offsets added.
    """
    operation, power = (2.0**-53, 2.0**-44) if constants.precise == 2 else PAIRS_ERRORS
    size, of_row = 8 * costs + 2 * spread, costs + largest
    exponents = size * ((3 * dimension + 6) * operation + 2.0**-47) + 2.0**-49 * of_row
    sums = power + (constants.tile + n_tiles) * operation + 2.0**-46
    return np.log(2) * exponents + sums


def float32_powers_bound(n_columns: int, smallest: float, n_added: int) -> float:
    """Return what float32 powers add to the bound of a log-sum-exp, in nats.

    The distances x_j <= 0 of exponents from their reference are rounded to float32. This changes
    the logarithm of the sum S = sum_j 2^x_j, which is at least `smallest`, by at most ln 2 times
    the relative error of float32 times sum_j w_j |x_j|, where w_j = 2^x_j / S. The latter sum is
    the entropy of w less log2 S. `n_added` powers are added in float32.
    """
    operation, power = FLOAT32_ERRORS
    distances = np.log2(n_columns) - min(0.0, np.log2(smallest)) + 1.0
    clipped = n_columns * SMALLEST_POWER / smallest
    added = np.log(2) * operation * distances + power + n_added * operation + clipped
    return float(1.01 * added)


class Float32Pairs:
    """Chooses the pairs of tiles between which exponents are exact enough in float32.

    An exponent is u . v + c, where u is a shift of a row, v and c are staged for a column. They are
    formed in float64 and rounded once to float32. If W bounds sum_d |u_d v_d| and S bounds |c|, the
    exponent is off by at most 2^-24 ((DIM + 4) W + 2 S): both factors, each product, DIM - 1 sums
    of products, c, and the last sum are rounded; see ``add_tile_in_float32`` in
    ``cl_kernels/sums.cl``.

    `values`, (M,), are k g_j + log2 b_j of the sorted columns, and exponents may be off by `limit`
    nats; `largest` is the largest bound of a chosen pair, in nats.
    """

    def __init__(
        self, rows: Cloud, columns: Cloud, pairs: TilePairs, values: Float64, k: float, limit: float
    ) -> None:
        self._rows, self._columns, self.pairs, self._k = rows, columns, pairs, k
        self._limit, self.largest = limit, 0.0
        tiles, tile, self._dimension = columns.shifts.shape
        padded = pad(values, tiles * tile, SENTINEL).reshape(tiles, tile)
        massive = padded > 0.5 * SENTINEL
        highest = np.where(massive, padded, -np.inf).max(axis=1)
        lowest = np.where(massive, padded, np.inf).min(axis=1)
        # Tiles without mass have levels so low that they are not chosen.
        self._spreads = np.where(massive.any(axis=1), highest - lowest, 0.0)

    def chosen(self, levels: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return whether each listed pair is chosen, by its level."""
        tiles = self.pairs.tiles
        # What overflows is not chosen.
        with np.errstate(over="ignore", invalid="ignore"):
            k, of_columns = np.float32(self._k), self._columns.radii.astype(np.float32)
            own = np.repeat(self._rows.radii.astype(np.float32), np.diff(self.pairs.starts))
            radii, spreads = of_columns[tiles], self._spreads.astype(np.float32)[tiles]
            apart = np.sqrt(self.pairs.distances.astype(np.float32) * np.float32(2))
            products = k * own * (radii + apart)
            rest = np.abs(levels) + spreads + k * radii * (apart + np.float32(0.5) * radii)
            bounds = np.float32(self._dimension + 4) * products + np.float32(2) * rest
            bounds *= np.float32(1.01 * np.log(2) * FLOAT32_ERRORS[0])
            chosen = bounds <= np.float32(self._limit)
        self.largest = max(self.largest, float(bounds[chosen].max(initial=0.0)))
        return chosen.astype(np.uint8)
