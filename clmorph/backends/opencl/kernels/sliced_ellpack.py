"""Pairs of a plan in sliced ELLPACK, ``cl_kernels/sliced_ellpack.cl``, and sums over them.

The format is SELL-C-sigma: M. Kreutzer, G. Hager, G. Wellein, H. Fehske and A. R. Bishop, "A
unified sparse matrix data format for efficient general sparse matrix-vector multiplication on
modern processors with wide SIMD units", SIAM J. Sci. Comput. 36(5), C401-C423 (2014). Here C is
`BuildConstants.slice_rows` (``SLICE`` in the kernels) and sigma is `WINDOW`.
"""

from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SENTINEL, STORED_UNROLL
from clmorph.backends.opencl.build.sparse_half_step_slots import LARGEST_CHANGE
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.kernels.candidates import joined_pairs
from clmorph.backends.opencl.kernels.clouds import Cloud, unsort
from clmorph.backends.opencl.kernels.plan_rows import PlanRowReductions
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.records import Float64, NearPairs, PlanTerms, StoredPairs

#: Bytes of a pair, which is stored both by row and by column.
BYTES_PER_PAIR = 18
#: The format's sigma: the number of consecutive rows that are sorted by length together.
WINDOW = 1024


class Part(NamedTuple):
    """The pairs of some row tiles, in slices."""

    n_rows: int
    starts: cl.Buffer  #: (slices + 1,) uint32
    columns: cl.MemoryObject
    log2_masses: cl.MemoryObject
    #: The place of each row among the sorted points, in the order of the slices.
    places: cl.Buffer

    @property
    def arguments(self) -> tuple[Any, ...]:
        """The first arguments of the kernel."""
        return self.starts, self.columns, self.log2_masses, self.places


class Side(NamedTuple):
    """All stored pairs, row by row."""

    rows: Cloud
    columns: Cloud
    parts: list[Part]


class SlicedEllpack:
    """Stores the pairs of a plan, which `plan_rows` finds, and sums over them."""

    def __init__(self, loop: RowLoop, plan_rows: PlanRowReductions) -> None:
        self._work, self._constants, self._plan_rows = loop.work, loop.constants, plan_rows
        self._programs = loop.programs

    def store_pairs(
        self,
        plan: PlanTerms,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Store the pairs of a plan above a threshold twice: by row and by column."""
        # Or a ProgramError, before the pairs are counted.
        self._programs.kernel("sliced_ellpack.cl", "clear_stored")
        sides = []
        n_pairs, memory = 0, self._work.device.global_mem_size // 4
        most = min(max_pairs, memory // BYTES_PER_PAIR)
        rows, columns, f, g, epsilon, by_row, by_column, _ = plan
        back = PlanTerms(columns, rows, g, f, epsilon, by_column, by_row)
        for each, (own, other) in ((plan, near), (back, near[::-1])):
            if own is not None and other is not None:
                looked_at = joined_pairs(each.rows, each.columns, own.pairs, other.pairs)
                each = each._replace(looked_at=looked_at)
            counts = self._plan_rows.count(each, most=most)
            n_pairs = int(counts.sum())
            longest = counts.max(initial=0)
            if n_pairs > most or longest > loop_limits.stored_pairs(self._constants):
                return None
            sides.append(self._stored(each, counts))
        return StoredPairs((sides[0], sides[1]), n_pairs, (rows.order, columns.order))

    def _stored(self, plan: PlanTerms, counts: NDArray[np.int64]) -> Side:
        """Write the pairs of every row in slices; `counts` has the caller's order of rows."""
        rows, tile, side = plan.rows, self._constants.tile, self._constants.slice_rows
        ordered = np.zeros(rows.stride, np.int64)
        ordered[: len(rows)] = counts[rows.order]
        parts, clear = [], self._programs.kernel("sliced_ellpack.cl", "clear_stored")
        for part, launch in self._plan_rows.launches("fill_plan_rows", plan, counts=ordered):
            in_part = slice(part.start * tile, part.stop * tile)
            order = _by_length(ordered[in_part])
            longest = ordered[in_part][order].reshape(-1, side).max(axis=1)
            slots = -(-longest // STORED_UNROLL) * STORED_UNROLL
            starts = np.concatenate(([0], np.cumsum(side * slots)))
            first = np.empty(len(order), np.int64)
            first[order] = (starts[:-1, None] + np.arange(side)).ravel()
            size = max(1, int(starts[-1]))
            buffers = self._work.empty(4 * size), self._work.empty(4 * size)
            self._work.launch(clear, (size,), None, *buffers)
            launch(self._work.buffer(first, np.uint32), np.uint32(side), *buffers)
            made = [self._work.buffer(each, np.uint32) for each in (starts, in_part.start + order)]
            parts.append(Part(len(order), made[0], *buffers, made[1]))
        return Side(rows, plan.columns, parts)

    def sum_stored(
        self, stored: StoredPairs, changes: Float64, by_column: bool, ordered: bool = False
    ) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over the pairs of every row, or column."""
        side: Side = stored.pairs[by_column]
        rows, columns = side.rows, side.columns
        change_buffer, middle = self._changes(columns, changes, ordered)
        kernel = self._programs.kernel("sliced_ellpack.cl", "sum_stored")
        found = np.empty((2, rows.stride), np.float32)
        out = [self._work.empty(each.nbytes) for each in found]
        for number, part in enumerate(side.parts, 1):
            results = tuple(zip(found, out, strict=True)) if number == len(side.parts) else ()
            self._work.launch(
                kernel, (part.n_rows // self._constants.width,), None, *part.arguments,
                change_buffer, *out, results=results,
            )  # fmt: skip
        maxima, sums = found[:, : len(rows)]
        with np.errstate(divide="ignore"):
            result = np.log2(sums, dtype=float)
        result += maxima
        result += middle
        result /= LOG2_E
        np.copyto(result, -np.inf, where=maxima <= 0.4 * SENTINEL)
        return result if ordered else unsort(rows, result)

    def _changes(
        self, columns: Cloud, changes: Float64, ordered: bool
    ) -> tuple[cl.MemoryObject, float]:
        """Return a buffer of changes less their midrange, and the midrange, in powers of two."""
        limits = -LARGEST_CHANGE, LARGEST_CHANGE
        ends = np.clip(np.array([changes.min(), changes.max()]) * LOG2_E, *limits)
        middle = float(ends.mean())
        centered = changes * LOG2_E
        np.clip(centered, *limits, out=centered)
        centered -= middle
        values = np.zeros(columns.stride, np.float32)
        own = values[: len(columns)]
        if ordered:
            own[:] = centered
        else:
            np.take(centered.astype(np.float32), columns.order, out=own)
        buffer = self._work.empty(values.nbytes)
        cl.enqueue_copy(self._work.queue, buffer, values)
        return buffer, middle


def _by_length(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sort rows by length inside each window, so that the rows of a slice have similar lengths."""
    return np.lexsort((counts, np.arange(len(counts)) // WINDOW))
