"""Clouds on the device and the row reductions of ``cl_kernels/rows.cl``."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.errors import DeviceError
from clmorph.opencl import program
from clmorph.opencl.knobs import SENTINEL, Knobs
from clmorph.opencl.launches import LaunchBudget, Workspace
from clmorph.operations import MAX_POINTS, Float64, PlanRows
from clmorph.tiles import tile_order

LOG2_E = float(np.log2(np.e))

#: Kept pairs that one launch may write (12 bytes each on the device).
FILL_PAIRS = 1 << 24


@dataclass(frozen=True)
class Cloud:
    """A cloud on the device, sorted into tiles and padded to whole ones.

    Attributes
    ----------
    order : (N,) array
        Where each sorted point stood in the caller's arrays.
    centers : (tiles, D) array
        Tile centers; exact in float32.
    log2_weights : (N,) array
        Sorted; SENTINEL for zero mass.
    half_squares : (N,) array
        Sorted; half the squared distance of each point to its tile's center.
    stride : int
        N padded to whole tiles.
    offsets_buffer : (2, D, stride) float32
        Points less their tile's center, and what that rounds off.
    centers_buffer : (tiles, D) float32
    """

    order: NDArray[np.intp]
    centers: Float64
    log2_weights: Float64
    half_squares: Float64
    stride: int
    offsets_buffer: cl.Buffer
    centers_buffer: cl.Buffer

    def __len__(self) -> int:
        return len(self.order)


class Reductions:
    """The transport half of `OpenCLOperations`."""

    def __init__(self, work: Workspace, knobs: Knobs) -> None:
        self._work, self._knobs = work, knobs
        self._budget = LaunchBudget()
        self._kernels: dict[tuple[int, bool], dict[str, cl.Kernel]] = {}

    def upload(self, points: Float64, weights: Float64) -> Cloud:
        """Take a weighted cloud."""
        points = np.asarray(points, float)
        tile = self._knobs.tile
        n, dimension = points.shape
        if n > MAX_POINTS:
            raise DeviceError(f"{n} points are too many: expected at most 2^24; reduce the image")
        order = tile_order(points, tile)
        n_tiles = -(-n // tile)
        padded = np.pad(points[order], ((0, n_tiles * tile - n), (0, 0)), mode="edge")
        tiles = padded.reshape(n_tiles, tile, dimension)
        centers = 0.5 * (tiles.min(axis=1) + tiles.max(axis=1))
        # Rounded first, so that the device's copy is exact and offsets absorb the rounding.
        centers = centers.astype(np.float32).astype(float)
        offsets = (tiles - centers[:, None]).reshape(-1, dimension)
        with np.errstate(divide="ignore"):
            log2_weights = np.log2(np.asarray(weights, float)[order])
        return Cloud(
            order=order,
            centers=centers,
            log2_weights=np.maximum(log2_weights, SENTINEL),
            half_squares=0.5 * np.sum(offsets[:n] ** 2, axis=1),
            stride=n_tiles * tile,
            offsets_buffer=self._work.buffer(_split(offsets.T)),
            centers_buffer=self._work.buffer(centers),
        )

    def softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
    ) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)."""
        log2_maxima, sums = self._log_sum_exp(rows, columns, potential, epsilon, precise)
        return _unsort(rows, -epsilon / LOG2_E * (log2_maxima + np.log2(sums)))

    def row_maxima(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        log2_maxima, _ = self._log_sum_exp(rows, columns, potential, epsilon, False)
        return _unsort(rows, log2_maxima / LOG2_E)

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
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold: count, then fill."""
        kernels = self._row_kernels(rows, precise)
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, g, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k)
        n, tile = len(rows), self._knobs.tile
        # log2 pi_ij = e_ij + bases_i; a row without mass keeps nothing.
        bases = np.repeat(tops_of_rows, tile)[:n] - k * rows.half_squares
        bases += f[rows.order] * k + rows.log2_weights
        bases[rows.log2_weights <= SENTINEL] = SENTINEL
        shared = (
            self._work.buffer(_split(_pad(bases, rows.stride, SENTINEL))),
            self._work.buffer(
                _pad(_log2_threshold(row_thresholds)[rows.order], rows.stride, -SENTINEL)
            ),
            self._work.buffer(
                _pad(_log2_threshold(column_thresholds)[columns.order], columns.stride, -SENTINEL)
            ),
        )

        counts = np.empty(rows.stride, np.int32)
        for part in self._row_parts(rows, columns):
            out = self._work.empty(len(part) * tile * 4)
            self._launch_rows(
                kernels["count_plan_rows"], rows, columns, heights, tops, tops_of_rows, k, part,
                *shared, out, precise=precise,
            )  # fmt: skip
            cl.enqueue_copy(self._work.queue, counts[part.start * tile : part.stop * tile], out)

        indices, mass = [], []
        for part in self._row_parts(rows, columns, counts):
            in_part = slice(part.start * tile, part.stop * tile)
            ends = np.cumsum(counts[in_part], dtype=np.int64)
            kept = int(ends[-1])
            column_buffer, mass_buffer = self._work.empty(4 * kept), self._work.empty(4 * kept)
            self._launch_rows(
                kernels["fill_plan_rows"], rows, columns, heights, tops, tops_of_rows, k, part,
                *shared, self._work.buffer(ends - counts[in_part], np.uint32),
                column_buffer, mass_buffer, precise=precise,
            )  # fmt: skip
            found = np.empty(kept, np.int32)
            log2_masses = np.empty(kept, np.float32)
            if kept:
                cl.enqueue_copy(self._work.queue, found, column_buffer)
                cl.enqueue_copy(self._work.queue, log2_masses, mass_buffer)
            indices.append(columns.order[found].astype(np.int32))
            mass.append(np.exp2(log2_masses.astype(float)))
        return _unsort_rows(
            rows, len(columns), counts[:n], np.concatenate(indices), np.concatenate(mass)
        )

    def _log_sum_exp(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float, precise: bool
    ) -> tuple[Float64, Float64]:
        """Log2 maximum (all constants of the row added) and sum of every sorted row."""
        kernel = self._row_kernels(rows, precise)["log_sum_exp"]
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, potential, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k)
        shares = self._column_shares(rows, columns)
        per_share = -(-len(columns.centers) // shares)
        tile = self._knobs.tile
        maxima, sums = np.empty(rows.stride), np.empty(rows.stride)
        for part in self._row_parts(rows, columns):
            n_rows = len(part) * tile
            out = np.empty((2, shares, n_rows), np.float32)
            buffers = self._work.empty(out.nbytes // 2), self._work.empty(out.nbytes // 2)
            self._launch_rows(
                kernel, rows, columns, heights, tops, tops_of_rows, k, part,
                np.uint32(n_rows), np.uint32(per_share), *buffers, shares=shares, precise=precise,
            )  # fmt: skip
            for values, buffer in zip(out, buffers, strict=True):
                cl.enqueue_copy(self._work.queue, values, buffer)
            section = slice(part.start * tile, part.stop * tile)
            if shares == 1:
                maxima[section], sums[section] = out[0, 0], out[1, 0]
                continue
            m = out[0].max(axis=0).astype(float)
            maxima[section] = m
            sums[section] = np.sum(out[1] * np.exp2(out[0] - m), axis=0)
        n = len(rows)
        offsets = np.repeat(tops_of_rows, tile)[:n] - k * rows.half_squares
        return maxima[:n] + offsets, sums[:n]

    def _column_heights(
        self, columns: Cloud, potential: Float64, k: float
    ) -> tuple[cl.Buffer, Float64]:
        """Split k g + log2 b into the largest of each tile (float64) and the rest (device)."""
        values = _pad(
            potential[columns.order] * k + columns.log2_weights, columns.stride, SENTINEL
        ).reshape(-1, self._knobs.tile)
        values[values < 0.5 * SENTINEL] = SENTINEL
        tops = values.max(axis=1)
        heights = np.where(values == SENTINEL, SENTINEL, values - tops[:, None])
        return self._work.buffer(_split(heights)), tops

    def _row_tops(self, rows: Cloud, columns: Cloud, tops: Float64, k: float) -> Float64:
        """Largest level of each row tile: what its rows are measured from."""
        result = np.empty(len(rows.centers))
        step = max(1, (1 << 22) // len(tops))
        for first in range(0, len(result), step):
            block = slice(first, first + step)
            result[block] = _levels(rows.centers[block], columns.centers, tops, k).max(axis=1)
        return result

    def _column_shares(self, rows: Cloud, columns: Cloud) -> int:
        """Work-groups along the columns: more than one where the rows alone are too few."""
        if self._knobs.width > 1:
            return 1
        groups = max(1, rows.stride // self._knobs.group)
        wanted = -(-8 * self._work.context.devices[0].max_compute_units // groups)
        return max(1, min(wanted, len(columns.centers), 64))

    def _row_parts(
        self, rows: Cloud, columns: Cloud, counts: NDArray[np.int32] | None = None
    ) -> Iterator[range]:
        """Split the row tiles so that no launch runs long, nor writes too much."""
        n_tiles = len(rows.centers)
        kept = None
        if counts is not None:
            kept = counts.reshape(n_tiles, -1).sum(axis=1, dtype=np.int64).cumsum()
        first = 0
        while first < n_tiles:
            tiles = self._budget.pairs() // (self._knobs.tile * columns.stride)
            stop = min(n_tiles, first + max(1, int(tiles)))
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
    ) -> None:
        """Run a kernel of ``rows.cl`` over some row tiles and wait for it."""
        section = slice(part.start, part.stop)
        levels = _levels(rows.centers[section], columns.centers, tops, k)
        levels -= tops_of_rows[section, None]
        levels = np.maximum(levels, SENTINEL)
        if precise:
            levels = np.swapaxes(_split(levels), 0, 1)
        n_rows = len(part) * self._knobs.tile
        with self._budget.measure(n_rows * columns.stride):
            self._work.launch(
                kernel, (n_rows // self._knobs.width, shares), (self._knobs.group, 1),
                np.uint32(part.start * self._knobs.tile), np.uint32(rows.stride),
                np.uint32(columns.stride), np.uint32(len(columns.centers)), *_split(np.asarray(k)),
                rows.offsets_buffer, rows.centers_buffer, columns.offsets_buffer,
                columns.centers_buffer, heights, self._work.buffer(levels),
                *arguments,
            )  # fmt: skip

    def _row_kernels(self, rows: Cloud, precise: bool) -> dict[str, cl.Kernel]:
        key = rows.centers.shape[1], precise
        if key not in self._kernels:
            constants = self._knobs.rows_constants(*key)
            built = program.build(self._work.context, "rows.cl", constants)
            names = ("log_sum_exp", "count_plan_rows", "fill_plan_rows")
            self._kernels[key] = {name: cl.Kernel(built, name) for name in names}
        return self._kernels[key]


def _levels(row_centers: Float64, column_centers: Float64, tops: Float64, k: float) -> Float64:
    """Log2-kernel between tile centers with the columns' largest heights: (rows, columns)."""
    result = np.empty((len(row_centers), len(column_centers)))
    result[:] = tops
    for d in range(row_centers.shape[1]):
        result -= 0.5 * k * (row_centers[:, d, None] - column_centers[:, d]) ** 2
    return result


def _split(values: Float64) -> NDArray[np.float32]:
    """Return (2, ...) float32: the nearest, and what it rounds off."""
    high = values.astype(np.float32)
    return np.stack((high, (values - high).astype(np.float32)))


def _pad(values: Float64, length: int, filler: float) -> Float64:
    return np.concatenate((values, np.full(length - len(values), filler)))


def _log2_threshold(values: Float64) -> Float64:
    """Convert nats to base 2, and infinities to what float32 arithmetic survives."""
    return np.clip(np.asarray(values, float) * LOG2_E, 0.25 * SENTINEL, -SENTINEL)


def _unsort(cloud: Cloud, values: Float64) -> Float64:
    result = np.empty_like(values)
    result[cloud.order] = values
    return result


def _unsort_rows(
    rows: Cloud,
    n_columns: int,
    counts: NDArray[np.int32],
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
