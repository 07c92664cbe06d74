"""The pairs of a plan above a threshold, by ``cl_kernels/plan_rows.cl``."""

import functools
from collections.abc import Callable, Iterator

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.kernels.candidates import possible_pairs
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs
from clmorph.backends.records import Float64, PlanRows, PlanTerms

#: The number of pairs of points from which rows of plans are searched by lists of tiles.
LISTED_FROM = 1 << 27


class PlanRowReductions:
    """Counts and writes the kept pairs of a plan."""

    def __init__(self, loop: RowLoop) -> None:
        self._loop = loop
        #: Whether rows are searched by lists of tiles however few they are.
        self.always_listed = False

    def count_plan_rows(self, plan: PlanTerms, precise: bool = False) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps."""
        return self.count(plan, precise)

    def count(
        self, plan: PlanTerms, precise: bool = False, most: float = np.inf
    ) -> NDArray[np.int64]:
        """Return how many pairs of each row are kept, (N,), or of some if above `most` in all."""
        rows, tile = plan.rows, self._loop.constants.tile
        counts, total = np.zeros(rows.stride, np.int32), 0
        for part, launch in self.launches("count_plan_rows", plan, precise):
            out = self._loop.work.empty(len(part) * tile * 4)
            launch(out)
            found = counts[part.start * tile : part.stop * tile]
            cl.enqueue_copy(self._loop.work.queue, found, out)
            total += int(found.sum(dtype=np.int64))
            if total > most:
                break
        return unsort(rows, counts[: len(rows)].astype(np.int64))

    def plan_rows(
        self, plan: PlanTerms, precise: bool = False, counts: NDArray[np.int64] | None = None
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold, in the caller's order."""
        rows, columns = plan.rows, plan.columns
        if counts is None:
            counts = self.count(plan, precise)
        n, tile, work = len(rows), self._loop.constants.tile, self._loop.work
        sorted_counts = np.zeros(rows.stride, np.int64)
        sorted_counts[:n] = counts[rows.order]
        indices, mass = [], []
        for part, launch in self.launches("fill_plan_rows", plan, precise, sorted_counts):
            in_part = sorted_counts[part.start * tile : part.stop * tile]
            ends = np.cumsum(in_part)
            kept = int(ends[-1])
            buffers = work.empty(4 * kept), work.empty(4 * kept)
            launch(work.buffer(ends - in_part, np.uint32), np.uint32(1), *buffers)
            found = np.empty(kept, np.int32)
            log2_masses = np.empty(kept, np.float32)
            if kept:
                cl.enqueue_copy(work.queue, found, buffers[0])
                cl.enqueue_copy(work.queue, log2_masses, buffers[1])
            indices.append(columns.order[found].astype(np.int32))
            mass.append(np.exp2(log2_masses.astype(float)))
        return _unsort_rows(
            rows, len(columns), sorted_counts[:n], np.concatenate(indices), np.concatenate(mass)
        )

    def launches(
        self,
        name: str,
        plan: PlanTerms,
        precise: bool = False,
        counts: NDArray[np.int64] | None = None,
    ) -> Iterator[tuple[range, Callable[..., None]]]:
        """Yield row tiles, and what launches a kernel there; it writes the sorted rows' counts."""
        rows, columns, loop = plan.rows, plan.columns, self._loop
        by_row = _log2_threshold(plan.row_thresholds)[rows.order]
        by_column = _log2_threshold(plan.column_thresholds)[columns.order]
        thresholds = (
            loop.work.buffer(pad(by_row, rows.stride, -SENTINEL)),
            loop.work.buffer(pad(by_column, columns.stride, -SENTINEL)),
        )
        for within, pairs in self._possible_pairs(plan):
            exponents = loop.exponents(rows, columns, plan.g, plan.epsilon, precise, pairs, within)
            # log2 pi_ij = e_ij + offsets_i; a row without mass keeps no pair.
            offsets = loop.row_offsets(exponents)
            offsets += plan.f[rows.order] * exponents.k + rows.log2_weights
            offsets[rows.log2_weights <= SENTINEL] = SENTINEL
            own = loop.work.buffer(split(pad(offsets, rows.stride, SENTINEL)))
            kernel = loop.kernel("plan_rows.cl", name, rows, precise, pairs is not None)
            for part in loop.parts(kernel, exponents, counts, within):
                yield (
                    part,
                    functools.partial(loop.launch, kernel, exponents, part, own, *thresholds),
                )

    def _possible_pairs(self, plan: PlanTerms) -> Iterator[tuple[range, TilePairs | None]]:
        """Yield row tiles, and all pairs of tiles that bounds do not exclude there."""
        rows, columns, f, g, epsilon, row_thresholds, column_thresholds, looked_at = plan
        if looked_at is not None:
            yield range(len(rows.centers)), looked_at
            return
        thresholds = _log2_threshold(row_thresholds), _log2_threshold(column_thresholds)
        everything = min(float(values.min()) for values in thresholds) <= 0.2 * SENTINEL
        few = rows.stride * columns.stride < LISTED_FROM and not self.always_listed
        if few or everything:
            yield range(len(rows.centers)), None
            return
        k = LOG2_E / epsilon
        logits = (g[columns.order] - columns.offsets) * k + columns.log2_weights
        offsets = k * (f[rows.order] - rows.offsets) + rows.log2_weights
        offsets[rows.log2_weights <= SENTINEL] = SENTINEL
        by_row = thresholds[0][rows.order] - offsets
        by_column = logits - thresholds[1][columns.order]
        # log2 pi_ij is above the threshold of its row, or above that of its column.
        sides = [
            (np.minimum(over, -SENTINEL), np.maximum(under, SENTINEL))
            for over, under in ((by_row, logits), (-offsets, by_column))
        ]
        yield from possible_pairs(self._loop, rows, columns, sides, k)


def _log2_threshold(values: Float64) -> Float64:
    """Convert nats to base 2, and infinities to numbers that are finite in float32 arithmetic."""
    return np.clip(np.asarray(values, float) * LOG2_E, 0.25 * SENTINEL, -SENTINEL)


def _unsort_rows(
    rows: Cloud,
    n_columns: int,
    counts: NDArray[np.int64],
    indices: NDArray[np.int32],
    mass: Float64,
) -> PlanRows:
    """Return plan rows, and the columns inside each row, in the caller's order."""
    from scipy.sparse import csr_array

    indptr = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
    plan = csr_array((mass, indices, indptr), shape=(len(rows), n_columns))
    inverse = np.empty_like(rows.order)
    inverse[rows.order] = np.arange(len(rows))
    plan = plan[inverse]
    plan.sort_indices()
    return PlanRows(plan.indptr.astype(np.int64), plan.indices.astype(np.int32), plan.data)
