"""Find the columns that contribute to sums, and bound the share of all others."""

import functools
from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph._shared.boxes import boxes_of_runs
from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM
from clmorph.backends.opencl.devices.verdicts import probed
from clmorph.backends.opencl.kernels.candidates import candidates
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, unsort
from clmorph.backends.opencl.kernels.log_sum_exp import LogSumExp
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, Exponents, RowLoop
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs, row_bounds
from clmorph.backends.records import Float64, NearPairs

#: Share of the budget that is available for the tiles that bounds alone exclude.
UNSEEN = 0.5
#: Rounding errors of a measured share in float32: a factor, and an error in log2 for each unit of
#: the exponent's size.
MARGIN, EXPONENT_ERROR = 1.05, 2.0**-22


class ColumnBoxes(NamedTuple):
    """What ``mark_columns`` knows of boxes, `width` a tile; empty where it forms no bounds."""

    lows: cl.Buffer  #: (D, tiles * lanes) least coordinates, less the tile's center
    highs: cl.Buffer  #: (D, tiles * lanes) largest ones
    most: cl.Buffer  #: (tiles * lanes,) largest logit without its linear part
    slopes: cl.Buffer  #: (tiles, D) slopes of the linear part, in units of k
    sides: cl.Buffer  #: (tiles, D) half sides of the tiles


class NearField:
    """Finds the pairs that contribute to the rows' sums."""

    #: Of more than this many eighths of a tile's columns all are summed: chosen ones take longer.
    many_eighths: int

    def __init__(self, loop: RowLoop, log_sum_exp: LogSumExp) -> None:
        self._loop, self._log_sum_exp = loop, log_sum_exp
        self.many_eighths = probed(loop.work.device).many_eighths

    def near_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that contribute to the rows' sums: tiles by bounds, then columns."""
        k, tile, n = LOG2_E / epsilon, self._loop.constants.tile, len(rows)
        values = (potential[columns.order] - columns.offsets) * k + columns.log2_weights
        guess = -k * (softmin[rows.order] - rows.offsets)
        values = np.maximum(values, SENTINEL)
        # The level of each row tile is set by the pairs that bounds do not exclude.
        exponents = self._loop.unleveled_exponents(rows, columns, potential, epsilon, False)
        left, kept, masks = np.empty(len(rows.centers)), [], []
        farthest, farthest_kept = 0.0, 0.0
        bounds = row_bounds(rows, guess, k)
        slopes = self._loop.work.buffer(k * bounds.slopes)
        boxes = column_boxes(self._loop, columns, values, exponents.tile_max, k)
        limits = guess + k * (rows.own_costs - rows.offsets)
        for part, pairs, unseen in candidates(
            self._loop, rows, columns, bounds, guess, values, k, UNSEEN * budget
        ):
            starts = pairs.starts[part.start : part.stop + 1]
            lengths = np.diff(starts)
            # All columns of these tiles below it are together within the budget.
            threshold = (1 - UNSEEN) * budget / (tile * lengths)
            own = np.maximum.reduceat(pairs.distances, starts[:-1])
            radii = rows.radii[part.start : part.stop] + columns.radii.max()
            farthest = max(farthest, _largest_cost(own, radii))
            marks, marked = self._marked(
                exponents, pairs, part, limits, np.log2(threshold), slopes, boxes
            )
            of_groups = np.add.reduceat(marked, starts[:-1], axis=0, dtype=np.int64)
            _complete(marks, marked, of_groups, starts, pairs.distances, tile)
            keep = functools.reduce(np.maximum, marked.T) > 0
            places = np.flatnonzero(keep)
            below = tile * lengths - of_groups.min(axis=1)
            left[part.start : part.stop] = unseen + below * threshold
            tiles, distances = pairs.tiles[places], pairs.distances[places]
            lengths = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
            radii = np.repeat(rows.radii[part.start : part.stop], lengths) + columns.radii[tiles]
            farthest_kept = max(farthest_kept, _largest_cost(distances, radii))
            kept.append((lengths, tiles, distances, of_groups))
            masks.append((part, self._loop.work.buffer(marks.take(places, axis=0), np.uint64)))
        lengths, tiles, distances, counts = map(np.concatenate, zip(*kept, strict=True))
        rows_of_group = tile // counts.shape[1]
        # To stage a tile takes about as long as a column for each row of the tile.
        work = rows_of_group * counts.sum(axis=1) + tile * lengths
        listed = TilePairs(_starts(lengths), tiles, distances, masks, _starts(work))
        maxima, sums, offsets = self._log_sum_exp.of_sorted(
            rows, columns, potential, epsilon, False, listed
        )
        with np.errstate(over="ignore", divide="ignore"):
            found = maxima + offsets + np.log2(sums)
            off = guess - k * rows.offsets - found + EXPONENT_ERROR * k * farthest
            skipped = MARGIN * np.exp2(np.minimum(off, 1e4)) * np.repeat(left, tile)[:n]
        return NearPairs(
            listed,
            unsort(rows, -found / k),
            unsort(rows, skipped),
            int(rows_of_group * counts.sum()),
            int(counts.max()),
            farthest_kept,
        )

    def _marked(
        self, terms: Exponents, pairs: TilePairs, part: range, limits: Float64,
        log2_threshold: Float64, slopes: cl.Buffer, boxes: ColumnBoxes,
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint16]]:  # fmt: skip
        """Return masks and counts of the columns above each row tile's threshold (log2).

        `limits` are an estimate of log2 of the rows' sums less their levels, and `slopes`, (row
        tiles, D), k times those of `row_bounds`.
        """
        loop, tile = self._loop, self._loop.constants.tile
        kernel = loop.kernel("near_field.cl", "mark_columns", terms.rows, listed=True)
        exponents = loop.with_levels(terms, pairs, part)
        of_tiles = log2_threshold - exponents.row_level[part.start : part.stop]
        own = limits[part.start * tile : part.stop * tile]
        own = own + np.repeat(of_tiles, tile)[: len(own)]
        # No column counts for the rows of the padding.
        limits = np.clip(pad(own, len(part) * tile, -SENTINEL), SENTINEL, -SENTINEL)
        shape = len(pairs.tiles), tile // loop.constants.group_rows, -(-tile // 64)
        masks, counts = np.empty(shape, np.uint64), np.empty(shape[:2], np.uint16)
        found = tuple((each, loop.work.empty(each.nbytes)) for each in (counts, masks))
        for launch in loop.parts(kernel, exponents, within=part):
            own = limits[(launch.start - part.start) * tile : (launch.stop - part.start) * tile]
            loop.launch(
                kernel, exponents, launch, np.uint32(self.many_eighths), loop.work.buffer(own),
                slopes, *boxes, *(buffer for _, buffer in found),
                results=found if launch.stop == part.stop else (),
            )  # fmt: skip
        return masks, counts


def _complete(
    masks: NDArray[np.uint64],
    counts: NDArray[np.uint16],
    of_groups: NDArray[np.int64],
    starts: NDArray[np.int64],
    distances: Float64,
    tile: int,
) -> None:
    """Give groups of rows without any column all columns of the nearest tile."""
    for row_tile, group in np.argwhere(of_groups == 0):
        own = slice(starts[row_tile], starts[row_tile + 1])
        nearest = starts[row_tile] + int(np.argmin(distances[own]))
        masks[nearest, group] = (1 << min(tile, 64)) - 1
        counts[nearest, group] = of_groups[row_tile, group] = tile


def _largest_cost(distances: Float64, radii: Float64) -> float:
    """Return a bound of the costs between tiles, from half squared distances and sums of radii."""
    return 0.5 * float((np.sqrt(2 * distances) + radii).max()) ** 2


def _starts(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where consecutive items of these lengths begin, and where the last one ends."""
    return np.concatenate(([0], np.cumsum(lengths)))


def column_boxes(
    loop: RowLoop, columns: Cloud, values: Float64, tile_max: Float64, k: float
) -> ColumnBoxes:
    """Divide the columns of each tile into boxes, by their k g_j + log2 b_j and its largest."""
    work, constants = loop.work, loop.constants
    if not constants.bounds_first or columns.centers.shape[1] >= SLICED_FROM:
        return ColumnBoxes(*(work.empty(4) for _ in ColumnBoxes._fields))
    shifts = columns.shifts
    tiles, _, dimension = shifts.shape
    logits = pad(values, columns.stride, SENTINEL).reshape(tiles, -1)
    present = logits > 0.5 * SENTINEL
    slopes = columns.slopes(np.where(present, logits / k, 0.0), present)
    rest = logits - tile_max[:, None] - k * np.einsum("ntd,nd->nt", shifts, slopes)
    rest = np.where(present, rest, SENTINEL).reshape(tiles, constants.width, -1).max(axis=2)
    points = shifts.reshape(-1, dimension)
    lows, highs = boxes_of_runs(
        points, np.arange(0, len(points), constants.tile // constants.width)
    )
    return ColumnBoxes(
        work.buffer(lows.T), work.buffer(highs.T), work.buffer(rest), work.buffer(slopes),
        work.buffer(columns.half_sides),
    )  # fmt: skip
