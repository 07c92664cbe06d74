"""Reductions over the rows of a plan: pairs above a threshold, moments, draws."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import Float64, NearPairs, PlanRows
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.kernels.candidates import possible_pairs
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.log_sum_exp import LOG2_E
from clmorph.backends.opencl.kernels.near_field import NearReductions
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs

#: Thresholds of draws stay below row sums that rounding made a little less than 1.
LARGEST_THRESHOLD = 1.0 - 1e-5
#: From so many pairs on rows of plans are sought by lists of tiles.
LISTED_FROM = 1 << 27


class PlanReductions(NearReductions):
    """The transport half of `OpenCLOperations`."""

    def count_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
        looked_at: TilePairs | None = None,
    ) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps, of those that are looked at."""
        arguments = rows, columns, f, g, epsilon, row_thresholds, column_thresholds
        counts = np.empty(rows.stride, np.int32)
        tile = self._knobs.tile
        for within, pairs in self._plan_pairs(*arguments, looked_at):
            levels = self._plan_levels(rows, columns, f, g, epsilon, within, pairs)
            shared = self._plan_buffers(rows, columns, levels, row_thresholds, column_thresholds)
            kernel = self._row_kernels(rows, precise, pairs is not None)["count_plan_rows"]
            for part in self._row_parts(kernel, rows, columns, pairs=pairs, within=within):
                out = self._work.empty(len(part) * tile * 4)
                self._launch_rows(
                    kernel, rows, columns, *levels[:4], part, *shared, out,
                    precise=precise, pairs=pairs,
                )  # fmt: skip
                cl.enqueue_copy(self._work.queue, counts[part.start * tile : part.stop * tile], out)
        return unsort(rows, counts[: len(rows)].astype(np.int64))

    def plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
        counts: NDArray[np.int64] | None = None,
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold, each row at its own place."""
        arguments = (rows, columns, f, g, epsilon, row_thresholds, column_thresholds, precise)
        if counts is None:
            counts = self.count_plan_rows(*arguments)
        n, tile = len(rows), self._knobs.tile
        sorted_counts = np.zeros(rows.stride, np.int64)
        sorted_counts[:n] = counts[rows.order]
        indices, mass = [], []
        for within, pairs in self._plan_pairs(*arguments[:-1]):
            levels = self._plan_levels(rows, columns, f, g, epsilon, within, pairs)
            shared = self._plan_buffers(rows, columns, levels, row_thresholds, column_thresholds)
            kernel = self._row_kernels(rows, precise, pairs is not None)["fill_plan_rows"]
            for part in self._row_parts(kernel, rows, columns, sorted_counts, pairs, within):
                in_part = sorted_counts[part.start * tile : part.stop * tile]
                ends = np.cumsum(in_part)
                kept = int(ends[-1])
                column_buffer, mass_buffer = self._work.empty(4 * kept), self._work.empty(4 * kept)
                self._launch_rows(
                    kernel, rows, columns, *levels[:4], part, *shared,
                    self._work.buffer(ends - in_part, np.uint32), np.uint32(1), column_buffer,
                    mass_buffer, precise=precise, pairs=pairs,
                )  # fmt: skip
                found = np.empty(kept, np.int32)
                log2_masses = np.empty(kept, np.float32)
                if kept:
                    cl.enqueue_copy(self._work.queue, found, column_buffer)
                    cl.enqueue_copy(self._work.queue, log2_masses, mass_buffer)
                indices.append(columns.order[found].astype(np.int32))
                mass.append(np.exp2(log2_masses.astype(float)))
        return _unsort_rows(
            rows, len(columns), sorted_counts[:n], np.concatenate(indices), np.concatenate(mass)
        )

    def plan_moments(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return mean and covariance of each row's destinations."""
        pairs = None if near is None else near.pairs
        kernel = self._row_kernels(rows, precise, pairs is not None)["plan_moments"]
        tile = self._knobs.tile
        *levels, base = self._conditional_levels(rows, columns, g, softmin, epsilon, pairs)
        dimension, n = rows.centers.shape[1], len(rows)
        moments = np.empty((1 + dimension + dimension * (dimension + 1) // 2, rows.stride))
        for part in self._row_parts(kernel, rows, columns, pairs=pairs):
            out = np.empty((len(moments), len(part) * tile), np.float32)
            buffer = self._work.empty(out.nbytes)
            self._launch_rows(
                kernel, rows, columns, *levels, part, np.uint32(out.shape[1]),
                base, buffer, precise=precise, pairs=pairs,
            )  # fmt: skip
            cl.enqueue_copy(self._work.queue, out, buffer)
            moments[:, part.start * tile : part.stop * tile] = out
        moments = moments[1:, :n] / moments[0, :n]
        k = LOG2_E / epsilon
        mean, covariance = np.empty((n, dimension)), np.empty((n, dimension, dimension))
        first, number = np.empty((dimension, n)), 0
        for d in range(dimension):
            first[d] = moments[number]
            mean[:, d] = np.repeat(rows.centers[:, d], tile)[:n] + first[d] / k
            for e in range(d + 1):
                second = moments[number + 1 + e] - first[d] * first[e]
                covariance[:, d, e] = covariance[:, e, d] = second / k**2
            number += d + 2
        return unsort(rows, mean), unsort(rows, covariance)

    def sample_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        thresholds: Float64,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> NDArray[np.int32]:
        """Return columns drawn from each plan row."""
        pairs = None if near is None else near.pairs
        kernel = self._row_kernels(rows, precise, pairs is not None)["sample_plan_rows"]
        tile = self._knobs.tile
        *levels, base = self._conditional_levels(rows, columns, g, softmin, epsilon, pairs)
        n, n_draws = thresholds.shape
        ordered = np.zeros((rows.stride, n_draws), np.float32)
        ordered[:n] = np.minimum(thresholds[rows.order], LARGEST_THRESHOLD)
        draws = np.empty((rows.stride, n_draws), np.int32)
        for part in self._row_parts(kernel, rows, columns, pairs=pairs):
            section = slice(part.start * tile, part.stop * tile)
            draws[section] = -1
            buffer = self._work.buffer(draws[section], np.int32)
            self._launch_rows(
                kernel, rows, columns, *levels, part, np.uint32(n_draws),
                base, self._work.buffer(ordered[section]), buffer, precise=precise, pairs=pairs,
            )  # fmt: skip
            cl.enqueue_copy(self._work.queue, draws[section], buffer)
        # Row sums that rounding keeps from the last thresholds: as the draw before them.
        for number in range(1, n_draws):
            missing = draws[:n, number] < 0
            draws[:n][missing, number] = draws[:n][missing, number - 1]
        return unsort(rows, columns.order[np.maximum(draws[:n], 0)].astype(np.int32))

    def _conditional_levels(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        pairs: TilePairs | None,
    ) -> tuple[cl.Buffer, Float64, Float64, float, cl.Buffer]:
        """Columns' heights and tops, rows' tops, k, and what makes log2 of pi_ij / r_i of e_ij."""
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, g, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k, pairs)
        bases = np.repeat(tops_of_rows, self._knobs.tile)[: len(rows)] - k * rows.own_costs
        bases += k * softmin[rows.order]
        base = self._work.buffer(split(pad(bases, rows.stride, SENTINEL)))
        return heights, tops, tops_of_rows, k, base

    def _plan_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        looked_at: TilePairs | None = None,
    ) -> Iterator[tuple[range, TilePairs | None]]:
        """Yield parts of the row tiles, and the pairs of tiles that can hold a kept pair there.

        What bounds exclude holds no pair above a threshold, so nothing is lost.
        """
        if looked_at is not None:
            yield range(len(rows.centers)), looked_at
            return
        thresholds = _log2_threshold(row_thresholds), _log2_threshold(column_thresholds)
        everything = min(float(values.min()) for values in thresholds) <= 0.2 * SENTINEL
        if rows.stride * columns.stride < LISTED_FROM or everything:
            yield range(len(rows.centers)), None
            return
        k = LOG2_E / epsilon
        bases = k * (f[rows.order] - rows.offsets) + rows.log2_weights
        bases[rows.log2_weights <= SENTINEL] = SENTINEL
        values = (g[columns.order] - columns.offsets) * k + columns.log2_weights
        by_row = thresholds[0][rows.order] - bases
        by_column = values - thresholds[1][columns.order]
        # log2 pi_ij is above the threshold of its row, or above that of its column.
        sides = [
            (np.minimum(over, -SENTINEL), np.maximum(under, SENTINEL))
            for over, under in ((by_row, values), (-bases, by_column))
        ]
        yield from possible_pairs(rows, columns, sides, k)

    def _plan_levels(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        within: range,
        pairs: TilePairs | None,
    ) -> tuple[cl.Buffer, Float64, Float64, float, Float64]:
        """Columns' heights and tops, rows' tops, k, and what makes log2 pi_ij of e_ij."""
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, g, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k, pairs, within)
        # log2 pi_ij = e_ij + bases_i; a row without mass keeps nothing.
        bases = np.repeat(tops_of_rows, self._knobs.tile)[: len(rows)] - k * rows.own_costs
        bases += f[rows.order] * k + rows.log2_weights
        bases[rows.log2_weights <= SENTINEL] = SENTINEL
        return heights, tops, tops_of_rows, k, bases

    def _plan_buffers(
        self,
        rows: Cloud,
        columns: Cloud,
        levels: tuple[Any, ...],
        row_thresholds: Float64,
        column_thresholds: Float64,
    ) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        """Bases and thresholds, as both kernels want them."""
        by_row = _log2_threshold(row_thresholds)[rows.order]
        by_column = _log2_threshold(column_thresholds)[columns.order]
        return (
            self._work.buffer(split(pad(levels[4], rows.stride, SENTINEL))),
            self._work.buffer(pad(by_row, rows.stride, -SENTINEL)),
            self._work.buffer(pad(by_column, columns.stride, -SENTINEL)),
        )


def _log2_threshold(values: Float64) -> Float64:
    """Convert nats to base 2, and infinities to what float32 arithmetic survives."""
    return np.clip(np.asarray(values, float) * LOG2_E, 0.25 * SENTINEL, -SENTINEL)


def _unsort_rows(
    rows: Cloud,
    n_columns: int,
    counts: NDArray[np.int64],
    indices: NDArray[np.int32],
    mass: Float64,
) -> PlanRows:
    """Bring plan rows, and the columns inside each, back to the caller's order."""
    from scipy.sparse import csr_array

    indptr = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
    plan = csr_array((mass, indices, indptr), shape=(len(rows), n_columns))
    inverse = np.empty_like(rows.order)
    inverse[rows.order] = np.arange(len(rows))
    plan = plan[inverse]
    plan.sort_indices()
    return PlanRows(plan.indptr.astype(np.int64), plan.indices.astype(np.int32), plan.data)
