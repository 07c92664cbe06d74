"""Pairs of a plan kept in the device's memory, and sums over them."""

from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import Float64, NearPairs, StoredPairs
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import SENTINEL, STORED_UNROLL
from clmorph.backends.opencl.kernels.candidates import joined_pairs
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, unsort
from clmorph.backends.opencl.kernels.log_sum_exp import LOG2_E
from clmorph.backends.opencl.kernels.plan_rows import PlanReductions
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs

#: What a pair takes, on both sides together.
BYTES_PER_PAIR = 18
#: Rows that are brought into order of their length together.
WINDOW = 1024
#: Changes of potentials are cut here, in powers of 2: far beyond where a sum is worth anything.
LARGEST_CHANGE = 1e4


class _Part(NamedTuple):
    """Pairs of some row tiles, as ``stored.cl`` wants them."""

    rows: NDArray[np.int64]  #: numbers of the sorted rows, in the slices' order
    starts: cl.Buffer
    columns: cl.MemoryObject
    log2_masses: cl.MemoryObject


class _Side(NamedTuple):
    """Pairs by row."""

    rows: Cloud
    columns: Cloud
    parts: list[_Part]


class StoredReductions(PlanReductions):
    """What keeps pairs."""

    def store_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Keep the pairs of a plan above a threshold: once by row, once by column."""
        sides = []
        n_pairs = 0
        for arguments, (own, other) in (
            ((rows, columns, f, g, epsilon, row_thresholds, column_thresholds), near),
            ((columns, rows, g, f, epsilon, column_thresholds, row_thresholds), near[::-1]),
        ):
            looked_at = None
            if own is not None and other is not None:
                looked_at = joined_pairs(arguments[0], arguments[1], own.pairs, other.pairs)
            counts = self.count_plan_rows(*arguments, looked_at=looked_at)
            n_pairs = int(counts.sum())
            if (
                n_pairs > max_pairs
                or BYTES_PER_PAIR * n_pairs > self._work.context.devices[0].global_mem_size // 4
            ):
                return None
            sides.append(self._stored(*arguments, counts, looked_at))
        return StoredPairs((sides[0], sides[1]), n_pairs)

    def _stored(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        counts: NDArray[np.int64],
        looked_at: TilePairs | None,
    ) -> _Side:
        tile, side = self._knobs.tile, self._knobs.stored_slice
        ordered = np.zeros(rows.stride, np.int64)
        ordered[: len(rows)] = counts[rows.order]
        thresholds = row_thresholds, column_thresholds
        parts = []
        for within, pairs in self._plan_pairs(rows, columns, f, g, epsilon, *thresholds, looked_at):
            levels = self._plan_levels(rows, columns, f, g, epsilon, within, pairs)
            shared = self._plan_buffers(rows, columns, levels, *thresholds)
            kernel = self._row_kernels(rows, False, pairs is not None)["fill_plan_rows"]
            for part in self._row_parts(kernel, rows, columns, ordered, pairs, within):
                section = slice(part.start * tile, part.stop * tile)
                order = _by_length(ordered[section])
                longest = ordered[section][order].reshape(-1, side).max(axis=1)
                places = -(-longest // STORED_UNROLL) * STORED_UNROLL
                starts = np.concatenate(([0], np.cumsum(side * places)))
                first = np.empty(len(order), np.int64)
                first[order] = (starts[:-1, None] + np.arange(side)).ravel()
                size = max(1, int(starts[-1]))
                column_buffer, mass_buffer = self._work.empty(4 * size), self._work.empty(4 * size)
                self._work.launch(
                    self._stored_kernel("clear_stored"), (size,), None, column_buffer, mass_buffer
                )
                self._launch_rows(
                    kernel, rows, columns, *levels[:4], part, *shared,
                    self._work.buffer(first, np.uint32), np.uint32(side), column_buffer,
                    mass_buffer, pairs=pairs,
                )  # fmt: skip
                starts_buffer = self._work.buffer(starts, np.uint32)
                parts.append(
                    _Part(section.start + order, starts_buffer, column_buffer, mass_buffer)
                )
        return _Side(rows, columns, parts)

    def sum_stored(self, stored: StoredPairs, changes: Float64, by_column: bool) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over the pairs of every row, or column."""
        side: _Side = stored.pairs[by_column]
        rows, columns = side.rows, side.columns
        ordered = np.clip(changes[columns.order] * LOG2_E, -LARGEST_CHANGE, LARGEST_CHANGE)
        # In the middle, so that float32 rounds the least.
        middle = 0.5 * float(ordered.min() + ordered.max())
        change_buffer = self._work.buffer(pad(ordered - middle, columns.stride, 0.0))
        kernel = self._stored_kernel("sum_stored")
        found = np.empty((2, rows.stride), np.float32)
        for part in side.parts:
            n_rows = len(part.rows)
            out = self._work.empty(4 * n_rows), self._work.empty(4 * n_rows)
            self._work.launch(
                kernel, (n_rows // self._knobs.width,), None, part.starts, part.columns,
                part.log2_masses, change_buffer, *out,
            )  # fmt: skip
            own = np.empty(n_rows, np.float32)
            for values, buffer in zip(found, out, strict=True):
                cl.enqueue_copy(self._work.queue, own, buffer)
                values[part.rows] = own
        maxima, sums = found[:, : len(rows)].astype(float)
        with np.errstate(divide="ignore"):
            logarithms = np.where(
                maxima > 0.4 * SENTINEL, (maxima + np.log2(sums) + middle) / LOG2_E, -np.inf
            )
        return unsort(rows, logarithms)

    def _stored_kernel(self, name: str) -> cl.Kernel:
        if not self._stored_kernels:
            constants = self._knobs.stored_constants()
            built = program.build(self._work.context, "stored.cl", constants)
            self._stored_kernels = {
                name: program.kernel(built, name) for name in ("clear_stored", "sum_stored")
            }
        return self._stored_kernels[name]


def _by_length(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Order rows so that slices hold rows of like length, but near ones still."""
    return np.lexsort((counts, np.arange(len(counts)) // WINDOW))
