"""The row reductions of ``cl_kernels/rows.cl``."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import Float64, NearPairs
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import SENTINEL, Knobs
from clmorph.backends.opencl.kernels.clouds import Cloud, make_cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs

LOG2_E = float(np.log2(np.e))

#: Errors of pairs of float32: of an operation, and of a power of two.
PAIRS_ERRORS = 2.0**-45, 2.0**-31
#: A larger maximum (log2) is rounded so far, in float32, that no bound holds; up to there the
#: largest power is not smaller than this.
LARGEST_MAXIMUM, SMALLEST_SUM = 2.0**28, 2.0**-70

#: Kept pairs that one launch may write (12 bytes each on the device): a first touch of memory
#: takes longer than what is written there.
FILL_PAIRS = 1 << 22


class Reductions:
    """Log-sum-exp over the columns of every row, and what every such reduction needs."""

    def __init__(self, work: Workspace, knobs: Knobs) -> None:
        self._work, self._knobs = work, knobs
        self._budgets: dict[int, LaunchBudget] = {}
        self._kernels: dict[tuple[int, bool, bool, bool], dict[str, cl.Kernel]] = {}
        self._stored_kernels: dict[str, cl.Kernel] = {}

    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Cloud:
        """Take a weighted cloud."""
        return make_cloud(self._work, self._knobs.tile, points, weights, offsets)

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
        maxima, sums, constants = self._log_sum_exp(
            rows, columns, potential, epsilon, precise, near
        )
        # Of points that float32 cannot hold apart nothing is left; the caller looks at results.
        with np.errstate(invalid="ignore"):
            return unsort(rows, -epsilon / LOG2_E * (maxima + constants + np.log2(sums)))

    def bounded_softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> tuple[Float64, float]:
        """Return T(g), far more exact than float32, and a bound of its error in nats."""
        maxima, sums, constants = self._log_sum_exp(
            rows, columns, potential, epsilon, True, near, bounded=True
        )
        error = self._error_bound(rows, columns, potential, epsilon)
        if not (np.abs(maxima).max() <= LARGEST_MAXIMUM and sums.min() > SMALLEST_SUM):
            error = np.inf
        with np.errstate(invalid="ignore", divide="ignore"):
            softmin = -epsilon / LOG2_E * (maxima + constants + np.log2(sums))
        return unsort(rows, softmin), error

    def _error_bound(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float
    ) -> float:
        """By how many nats `bounded_softmin` may be off: every rounding at its worst.

        An exponent adds up products that are no larger than `size`, of numbers that pairs of
        float32 hold to 2^-49, in 3 D + 6 operations. What is the same for a whole row is at most
        `constants` large, in float64. See ``cl_kernels/sums.cl`` for powers and additions.
        """
        k, n_tiles, dimension = LOG2_E / epsilon, len(columns.centers), columns.centers.shape[1]
        operation, power = (2.0**-53, 2.0**-44) if self._knobs.precise == 2 else PAIRS_ERRORS
        low = np.minimum(rows.box[0], columns.box[0])
        high = np.maximum(rows.box[1], columns.box[1])
        costs = 0.5 * k * float(np.sum((high - low) ** 2))
        values = (potential[columns.order] - columns.offsets) * k + columns.log2_weights
        values = values[columns.log2_weights > 0.5 * SENTINEL]
        size = 8 * costs + 2 * float(np.ptp(values))
        constants = costs + float(np.abs(values).max()) + k * float(np.abs(rows.offsets).max())
        exponents = size * ((3 * dimension + 6) * operation + 2.0**-47) + 2.0**-49 * constants
        sums = power + (self._knobs.tile + n_tiles) * operation + 2.0**-46
        return float(np.log(2) * exponents + sums)

    def row_maxima(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        maxima, _, constants = self._log_sum_exp(rows, columns, potential, epsilon, False, near)
        return unsort(rows, (maxima + constants) / LOG2_E)

    def _log_sum_exp(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool,
        near: NearPairs | None = None,
        bounded: bool = False,
    ) -> tuple[Float64, Float64, Float64]:
        """Log2 maximum, sum and what to add to the first, of every sorted row."""
        pairs = None if near is None else near.pairs
        kernel = self._row_kernels(rows, precise, pairs is not None, bounded)["log_sum_exp"]
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, potential, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k, pairs)
        shares = self._column_shares(rows, columns)
        tile = self._knobs.tile
        maxima, sums = np.empty(rows.stride), np.empty(rows.stride)
        for part in self._row_parts(kernel, rows, columns, pairs=pairs):
            n_rows = len(part) * tile
            found = np.empty((shares, n_rows), np.float32)
            # The sums, and what their nearest float32 rounds off.
            planes = np.empty((1 + bounded, shares, n_rows), np.float32)
            buffers = self._work.empty(found.nbytes), self._work.empty(planes.nbytes)
            self._launch_rows(
                kernel, rows, columns, heights, tops, tops_of_rows, k, part,
                np.uint32(n_rows), *buffers, shares=shares, precise=precise, pairs=pairs,
            )  # fmt: skip
            for values, buffer in zip((found, planes), buffers, strict=True):
                cl.enqueue_copy(self._work.queue, values, buffer)
            section = slice(part.start * tile, part.stop * tile)
            of_shares = planes.astype(float).sum(axis=0)
            m = found.max(axis=0).astype(float)
            maxima[section] = m
            sums[section] = np.sum(of_shares * np.exp2(found - m), axis=0)
        n = len(rows)
        constants = np.repeat(tops_of_rows, tile)[:n] - k * rows.own_costs
        return maxima[:n], sums[:n], constants

    def _column_heights(
        self, columns: Cloud, potential: Float64, k: float
    ) -> tuple[cl.Buffer, Float64]:
        """Split k g + log2 b into the largest of each tile (float64) and the rest (device)."""
        values = pad(
            (potential[columns.order] - columns.offsets) * k + columns.log2_weights,
            columns.stride,
            SENTINEL,
        ).reshape(-1, self._knobs.tile)
        values[values < 0.5 * SENTINEL] = SENTINEL
        tops = values.max(axis=1)
        heights = np.where(values == SENTINEL, SENTINEL, values - tops[:, None])
        return self._work.buffer(split(heights)), tops

    def _row_tops(
        self,
        rows: Cloud,
        columns: Cloud,
        tops: Float64,
        k: float,
        pairs: TilePairs | None = None,
        within: range | None = None,
    ) -> Float64:
        """Largest level of each row tile: what its rows are measured from."""
        result = np.zeros(len(rows.centers))
        within = within or range(len(result))
        each = len(tops) if pairs is None else -(-len(pairs.tiles) // len(within))
        step = max(1, (1 << 22) // max(1, each))
        for first in range(within.start, within.stop, step):
            block = range(first, min(first + step, within.stop))
            section = slice(block.start, block.stop)
            if pairs is None:
                levels = _levels(rows.centers[section], columns.centers, tops, k)
                result[section] = levels.max(axis=1)
            else:
                starts, _, levels = pairs.levels(block, tops, k)
                result[section] = np.maximum.reduceat(levels, starts[:-1])
        return result

    def _column_shares(self, rows: Cloud, columns: Cloud) -> int:
        """Work-groups along the columns: more than one where the rows alone are too few."""
        if self._knobs.width > 1:
            return 1
        groups = max(1, rows.stride // self._knobs.group)
        wanted = -(-8 * self._work.context.devices[0].max_compute_units // groups)
        return max(1, min(wanted, len(columns.centers), 64))

    def _budget(self, kernel: cl.Kernel) -> LaunchBudget:
        """Return how much a launch of this kernel may do: some take many times as long a pair."""
        return self._budgets.setdefault(kernel.int_ptr, LaunchBudget())

    def _row_parts(
        self,
        kernel: cl.Kernel,
        rows: Cloud,
        columns: Cloud,
        counts: NDArray[np.int64] | None = None,
        pairs: TilePairs | None = None,
        within: range | None = None,
    ) -> Iterator[range]:
        """Split the row tiles so that no launch runs long, nor writes too much."""
        n_tiles, tile = len(rows.centers), self._knobs.tile
        first, end = (0, n_tiles) if within is None else (within.start, within.stop)
        kept = None
        if counts is not None:
            kept = counts.reshape(n_tiles, -1).sum(axis=1, dtype=np.int64).cumsum()
        while first < end:
            budget = self._budget(kernel).pairs()
            if pairs is None:
                stop = first + max(1, int(budget // (tile * columns.stride)))
            else:
                last = pairs.starts[first] + budget // tile**2
                stop = int(np.searchsorted(pairs.starts, last, side="right")) - 1
            stop = min(end, max(stop, first + 1))
            if kept is not None:
                before = kept[first - 1] if first else 0
                stop = min(stop, int(np.searchsorted(kept, before + FILL_PAIRS, side="right")))
                stop = max(stop, first + 1)
            yield range(first, stop)
            first = stop

    def _launch_rows(
        self,
        kernel: cl.Kernel,
        rows: Cloud,
        columns: Cloud,
        heights: cl.Buffer,
        tops: Float64,
        tops_of_rows: Float64,
        k: float,
        part: range,
        *arguments: Any,
        shares: int = 1,
        precise: bool = False,
        pairs: TilePairs | None = None,
    ) -> None:
        """Run a kernel of ``rows.cl`` over some row tiles and wait for it."""
        section = slice(part.start, part.stop)
        n_rows = len(part) * self._knobs.tile
        lists: tuple[Any, ...] = ()
        if pairs is None:
            levels = _levels(rows.centers[section], columns.centers, tops, k)
            levels -= tops_of_rows[section, None]
            work = n_rows * columns.stride
        else:
            starts, listed, levels = pairs.levels(part, tops, k)
            levels -= np.repeat(tops_of_rows[section], np.diff(starts))
            work = self._knobs.tile**2 * len(listed)
            lists = (
                np.uint32(len(listed)), self._work.buffer(starts, np.uint32),
                self._work.buffer(listed, np.uint32),
            )  # fmt: skip
        levels = np.maximum(levels, SENTINEL)
        planes: NDArray[Any] = levels
        if precise:
            planes = split(levels) if lists else np.swapaxes(split(levels), 0, 1)
        with self._budget(kernel).measure(work):
            self._work.launch(
                kernel, (n_rows // self._knobs.width, shares), (self._knobs.group, 1),
                np.uint32(part.start * self._knobs.tile), np.uint32(rows.stride),
                np.uint32(columns.stride), np.uint32(len(columns.centers)), *split(np.asarray(k)),
                rows.offsets_buffer, rows.centers_buffer, columns.offsets_buffer,
                columns.centers_buffer, heights, self._work.buffer(planes), *lists,
                *arguments,
            )  # fmt: skip

    def _row_kernels(
        self, rows: Cloud, precise: bool, listed: bool = False, bounded: bool = False
    ) -> dict[str, cl.Kernel]:
        key = rows.centers.shape[1], precise, listed, bounded
        if key not in self._kernels:
            constants = self._knobs.rows_constants(*key)
            built = program.build(self._work.context, "rows.cl", constants)
            names = [
                "log_sum_exp", "count_plan_rows", "fill_plan_rows", "plan_moments",
                "sample_plan_rows",
            ]  # fmt: skip
            if listed:
                names += ["largest_shares", "measure_tiles"]
            if bounded:
                names = ["log_sum_exp"]
            self._kernels[key] = {name: program.kernel(built, name) for name in names}
        return self._kernels[key]


def _levels(row_centers: Float64, column_centers: Float64, tops: Float64, k: float) -> Float64:
    """Log2-kernel between tile centers with the columns' largest heights: (rows, columns)."""
    result = np.empty((len(row_centers), len(column_centers)))
    result[:] = tops
    for d in range(row_centers.shape[1]):
        result -= 0.5 * k * (row_centers[:, d, None] - column_centers[:, d]) ** 2
    return result
