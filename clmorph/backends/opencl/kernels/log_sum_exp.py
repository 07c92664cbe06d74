"""The log-sum-exp of ``cl_kernels/log_sum_exp.cl``: soft minima and the rows' maxima."""

from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM
from clmorph.backends.opencl.kernels.batches import Batch, as_batch, pairs_of
from clmorph.backends.opencl.kernels.clouds import Cloud, unsort
from clmorph.backends.opencl.kernels.rounding_bounds import (
    LARGEST_MAXIMUM,
    SMALLEST_SUM,
    USUAL_SUM,
    Float32Pairs,
    float32_powers_bound,
    rounding_bound,
)
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs
from clmorph.backends.records import Float64, NearPairs


class LogSumExp:
    """Log-sum-exp over the columns of every row."""

    def __init__(self, loop: RowLoop) -> None:
        self._loop = loop

    def softmin(
        self,
        rows: Cloud | Batch,
        columns: Cloud | Batch,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)."""
        own, other = as_batch(rows), as_batch(columns)
        pairs = _pairs_between(rows, columns, near)
        found = self.of_sorted(own.cloud, other.cloud, potential, epsilon, precise, pairs)
        return own.in_order(_softmin(*found, epsilon))

    def bounded_softmin(
        self,
        rows: Cloud | Batch,
        columns: Cloud | Batch,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
        enough: float = 0.0,
    ) -> tuple[Float64, Any]:
        """Return T(g) with a proven bound of its rounding error, in nats."""
        constants, k, float32 = self._loop.constants, LOG2_E / epsilon, None
        own, other = as_batch(rows), as_batch(columns)
        pairs, cloud = _pairs_between(rows, columns, near), other.cloud
        few = cloud.centers.shape[1] < SLICED_FROM  # coordinates
        if near is not None and constants.precise == 2 and few:
            powers = float32_powers_bound(cloud.stride, USUAL_SUM, constants.unroll)
            if powers <= enough:
                values = (potential[cloud.order] - cloud.offsets) * k + cloud.log2_weights
                float32 = Float32Pairs(own.cloud, cloud, near.pairs, values, k, enough - powers)
        maxima, sums, offsets = self.of_sorted(
            own.cloud, cloud, potential, epsilon, True, pairs, True, float32
        )
        errors = self._error_bounds(own, other, potential, epsilon, maxima, sums)
        if float32 is not None and errors[0] < np.inf:
            errors += float32_powers_bound(cloud.stride, float(sums.min()), constants.unroll)
            errors += float32.largest
        softmin = own.in_order(_softmin(maxima, sums, offsets, epsilon))
        return softmin, errors if isinstance(rows, Batch) else float(errors[0])

    def _error_bounds(
        self, rows: Batch, columns: Batch, potential: Float64, epsilon: float, maxima: Float64,
        sums: Float64,
    ) -> Float64:  # fmt: skip
        """Return the bound of each problem in nats, infinite where numbers are too large."""
        k, size, cloud = LOG2_E / epsilon, self._loop.constants.tile, columns.cloud
        low = np.minimum(rows.boxes[:, 0], columns.boxes[:, 0])
        high = np.maximum(rows.boxes[:, 1], columns.boxes[:, 1])
        costs = 0.5 * k * np.sum((high - low) ** 2, axis=1)
        values = (potential[cloud.order] - cloud.offsets) * k + cloud.log2_weights
        massive, first_rows = cloud.log2_weights > 0.5 * SENTINEL, rows.first_tiles * size
        starts = columns.first_tiles * size
        highest = np.maximum.reduceat(np.where(massive, values, -np.inf), starts)
        lowest = np.minimum.reduceat(np.where(massive, values, np.inf), starts)
        added = np.maximum.reduceat(np.abs(rows.cloud.offsets), first_rows)
        errors = rounding_bound(
            self._loop.constants, cloud.centers.shape[1], costs, highest - lowest,
            np.maximum(np.abs(highest), np.abs(lowest)) + k * added, columns.tiles,
        )  # fmt: skip
        usable = np.maximum.reduceat(np.abs(maxima), first_rows) <= LARGEST_MAXIMUM
        usable &= np.minimum.reduceat(sums, first_rows) > SMALLEST_SUM
        return np.where(usable, errors, np.inf)

    def row_maxima(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        pairs = None if near is None else near.pairs
        maxima, _, offsets = self.of_sorted(rows, columns, potential, epsilon, False, pairs)
        return unsort(rows, (maxima + offsets) / LOG2_E)

    def of_sorted(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool,
        pairs: TilePairs | None = None,
        bounded: bool = False,
        float32: Float32Pairs | None = None,
    ) -> tuple[Float64, Float64, Float64]:
        """Return maximum, sum and offset (log2) of every row, with powers in `float32`."""
        loop, tile = self._loop, self._loop.constants.tile
        masked = pairs is not None and pairs.masks is not None
        kernel = loop.kernel(
            "log_sum_exp.cl", "log_sum_exp", rows, precise, pairs is not None,
            2 if float32 else int(bounded), masked,
        )  # fmt: skip
        if pairs is None:
            exponents = loop.dense_exponents(rows, columns, potential, epsilon, precise)
        else:
            exponents = loop.exponents(rows, columns, potential, epsilon, precise, pairs)
        in_float32 = []
        if float32 is not None:
            levels = np.empty(len(float32.pairs.tiles), np.float32)
            cl.enqueue_copy(loop.work.queue, levels, exponents.levels)
            in_float32 = [loop.work.buffer(float32.chosen(levels), np.uint8)]
        stacks = loop.constants.stacks(rows.centers.shape[1], precise)
        shares = loop.column_shares(rows, columns, pairs, stacks)
        maxima, sums = np.empty(rows.stride), np.empty(rows.stride)
        for part, masks in loop.masked_parts(kernel, exponents, shares):
            n_rows = len(part) * tile
            found = np.empty((shares, n_rows), np.float32)
            # The buffer holds the sums and the rounding errors of their nearest float32.
            planes = np.empty((2 if bounded else 1, shares, n_rows), np.float32)
            buffers = loop.work.empty(found.nbytes), loop.work.empty(planes.nbytes)
            loop.launch(
                kernel, exponents, part, *masks, *in_float32, np.uint32(n_rows), *buffers,
                shares=shares, results=tuple(zip((found, planes), buffers, strict=True)),
            )  # fmt: skip
            section = slice(part.start * tile, part.stop * tile)
            if shares == 1:
                maxima[section], sums[section] = found[0], planes[:, 0].sum(axis=0, dtype=float)
                continue
            of_shares = planes.astype(float).sum(axis=0)
            m = found.max(axis=0).astype(float)
            maxima[section] = m
            sums[section] = np.sum(of_shares * np.exp2(found - m), axis=0)
        n = len(rows)
        return maxima[:n], sums[:n], loop.row_offsets(exponents)


def _pairs_between(
    rows: Cloud | Batch, columns: Cloud | Batch, near: NearPairs | None
) -> TilePairs | None:
    """Return the pairs of tiles that are summed, None for all: each problem of many has its own."""
    if isinstance(rows, Batch) and isinstance(columns, Batch):
        return pairs_of(rows, columns)
    return None if near is None else near.pairs


def _softmin(maxima: Float64, sums: Float64, offsets: Float64, epsilon: float) -> Float64:
    # Overflow gives NaN if float32 cannot hold the numbers; the caller checks the results.
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(-epsilon / LOG2_E * (maxima + offsets + np.log2(sums)))
