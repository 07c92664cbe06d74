"""Find the pairs of tiles that matter, and leave out the rest with a proof of what it holds."""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.opencl.clouds import WIDTH_OF_GROUPS, Cloud, Tiles, unsort
from clmorph.opencl.knobs import LARGEST_SHARE, SENTINEL
from clmorph.opencl.reductions import LOG2_E, Reductions
from clmorph.opencl.tile_pairs import (
    TileBounds,
    TilePairs,
    column_bounds,
    half_sides,
    row_bounds,
    tile_bounds,
)
from clmorph.operations import Float64, NearPairs

#: Entries of a block of bounds: small enough for a core's cache.
BLOCK_BOUNDS = 1 << 17
#: Bounds of pairs of tiles from which on groups of tiles are bounded first.
WIDE_FROM = 1 << 24
#: Pairs of tiles that are measured at once.
CHUNK_PAIRS = 1 << 20
#: Shares at which a list may be cut, as parts of the budget.
CUTS = 8.0 ** -np.arange(7)
#: Half of the budget is for what is never looked at.
UNSEEN = 0.5
#: Tiles with small terms only are looked for first as long as no more than this share is left.
WORTHWHILE = 0.5
#: What float32 may take off a measured share, as a factor.
MARGIN = 1.05


class _Candidates(NamedTuple):
    """Column tiles of some row tiles, and the share that all others can have there."""

    part: range
    pairs: TilePairs
    unseen: Float64  #: (row tiles of the part,)


class NearReductions(Reductions):
    """What finds lists of tiles."""

    def near_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that matter for the rows' sums.

        Bounds over pairs of tiles exclude most; the rest is summed, once, and tiles whose largest
        share in any of their rows turns out to be small are left out as well.
        """
        k, tile, n = LOG2_E / epsilon, self._knobs.tile, len(rows)
        values = (potential[columns.order] - columns.offsets) * k + columns.log2_weights
        guess = -k * (softmin[rows.order] - rows.offsets)
        values = np.maximum(values, SENTINEL)
        heights, tops = self._column_heights(columns, potential, k)
        found, skipped = np.empty(rows.stride), np.empty(len(rows.centers))
        kept: list[TilePairs] = []
        clouds = rows, columns, heights, tops, k, guess
        worthwhile = True
        for part, pairs, unseen in candidates(
            rows, columns, guess, values, k, 0.5 * UNSEEN * budget
        ):
            if worthwhile:
                before = len(pairs.tiles)
                pairs, more = self._without_small(*clouds, pairs, part, 0.5 * UNSEEN * budget)
                unseen = unseen + more
                worthwhile = len(pairs.tiles) <= WORTHWHILE * before
            section = slice(part.start * tile, part.stop * tile)
            sums, shares = self._measured(*clouds, pairs, part)
            found[section] = sums
            # By how much the guess was above the sum, in the worst row of each tile.
            off = np.full((2, len(sums)), [[-np.inf], [np.inf]])
            off[:, : n - section.start] = guess[section] - sums[: n - section.start]
            above, below = off.reshape(2, len(part), tile)
            factor = MARGIN * np.exp2(np.clip(above.max(axis=1), -900.0, 600.0))
            starts = pairs.starts[part.start : part.stop + 1]
            shares *= np.repeat(factor, np.diff(starts))
            # Where the guess was far below the sum of some row, shares were not told apart.
            shares[np.repeat(below.min(axis=1) < -LARGEST_SHARE, np.diff(starts))] = 1.0
            keep, left = _keep(starts, shares, (1 - UNSEEN) * budget)
            left += factor * unseen
            with np.errstate(divide="ignore"):
                left = np.where(left < 1.0, left / np.maximum(1.0 - left, 0.0), np.inf)
            skipped[part.start : part.stop] = left
            lengths = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
            kept.append(TilePairs(lengths, pairs.tiles[keep], pairs.distances[keep]))
        lengths, tiles, distances = (np.concatenate(arrays) for arrays in zip(*kept, strict=True))
        starts = np.concatenate(([0], np.cumsum(lengths)))
        return NearPairs(
            TilePairs(starts, tiles, distances),
            unsort(rows, -found[:n] / k + rows.offsets),
            unsort(rows, np.repeat(skipped, tile)[:n]),
            len(tiles) * tile**2,
            int(lengths.max()) * tile,
            _largest_cost(rows, columns, lengths, tiles, distances),
        )

    def _measured(
        self,
        rows: Cloud,
        columns: Cloud,
        heights: cl.Buffer,
        tops: Float64,
        k: float,
        guess: Float64,
        pairs: TilePairs,
        part: range,
    ) -> tuple[Float64, Float64]:
        """Log2 of the sums of a part's rows, and each pair's largest share, by the guess."""
        kernel = self._row_kernels(rows, False, True)["measure_tiles"]
        tile, groups = self._knobs.tile, self._groups_of_a_tile
        tops_of_rows = np.zeros(len(rows.centers))
        sums, shares = np.empty(len(part) * tile), np.empty(len(pairs.tiles))
        for launch in self._row_parts(rows, columns, pairs=pairs, within=part):
            constants, bases = self._bases(rows, tops, tops_of_rows, k, guess, pairs, launch)
            first, last = pairs.starts[launch.start], pairs.starts[launch.stop]
            out = [np.empty(len(constants), np.float32) for _ in range(2)]
            out.append(np.empty(groups * int(last - first), np.float32))
            buffers = [self._work.empty(values.nbytes) for values in out]
            self._launch_rows(
                kernel, rows, columns, heights, tops, tops_of_rows, k, launch, bases, *buffers,
                pairs=pairs,
            )  # fmt: skip
            for values, buffer in zip(out, buffers, strict=True):
                cl.enqueue_copy(self._work.queue, values, buffer)
            own = (launch.start - part.start) * tile
            with np.errstate(divide="ignore"):
                logarithms = out[0] + np.log2(out[1].astype(float))
            sums[own : own + len(constants)] = logarithms + constants
            shares[first:last] = out[2].reshape(groups, -1).max(axis=0)
        return sums, shares

    def _without_small(
        self,
        rows: Cloud,
        columns: Cloud,
        heights: cl.Buffer,
        tops: Float64,
        k: float,
        guess: Float64,
        pairs: TilePairs,
        part: range,
        budget: float,
    ) -> tuple[TilePairs, Float64]:
        """Leave out tiles with small terms only; return the others and the share of these."""
        kernel = self._row_kernels(rows, False, True)["largest_shares"]
        tile, groups = self._knobs.tile, self._groups_of_a_tile
        tops_of_rows = np.zeros(len(rows.centers))
        shares = np.empty(len(pairs.tiles))
        for launch in self._row_parts(rows, columns, pairs=pairs, within=part):
            _, bases = self._bases(rows, tops, tops_of_rows, k, guess, pairs, launch)
            first, last = pairs.starts[launch.start], pairs.starts[launch.stop]
            out = np.empty((groups, int(last - first)), np.float32)
            buffer = self._work.empty(out.nbytes)
            self._launch_rows(
                kernel, rows, columns, heights, tops, tops_of_rows, k, launch, bases, buffer,
                pairs=pairs,
            )  # fmt: skip
            cl.enqueue_copy(self._work.queue, out, buffer)
            shares[first:last] = out.max(axis=0)
        shares = MARGIN * tile * np.exp2(np.minimum(shares, LARGEST_SHARE))
        starts = pairs.starts[part.start : part.stop + 1]
        keep, left = _keep(starts, shares, budget)
        lengths = np.zeros(len(rows.centers), np.int64)
        lengths[part.start : part.stop] = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
        starts = np.concatenate(([0], np.cumsum(lengths)))
        return TilePairs(starts, pairs.tiles[keep], pairs.distances[keep]), left

    @property
    def _groups_of_a_tile(self) -> int:
        return self._knobs.tile // (self._knobs.group * self._knobs.width)

    def _bases(
        self,
        rows: Cloud,
        tops: Float64,
        tops_of_rows: Float64,
        k: float,
        guess: Float64,
        pairs: TilePairs,
        launch: range,
    ) -> tuple[Float64, cl.Buffer]:
        """Set the tops of some row tiles; return constants of their rows, and bases of shares."""
        tile, n = self._knobs.tile, len(rows)
        starts, _, levels = pairs.levels(launch, tops, k)
        tops_of_rows[launch.start : launch.stop] = np.maximum.reduceat(levels, starts[:-1])
        section = slice(launch.start * tile, min(n, launch.stop * tile))
        constants = np.repeat(tops_of_rows[launch.start : launch.stop], tile)
        constants[: section.stop - section.start] -= k * (
            rows.own_costs[section] - rows.offsets[section]
        )
        bases = np.full(len(constants), SENTINEL)
        bases[: section.stop - section.start] = -guess[section]
        return constants, self._work.buffer(np.maximum(bases + constants, SENTINEL))


def candidates(
    rows: Cloud,
    columns: Cloud,
    of_rows: Float64,
    of_columns: Float64,
    k: float,
    budget: float,
) -> Iterator[_Candidates]:
    """Yield pairs of tiles in parts of the row tiles, without such as bounds exclude.

    Parameters
    ----------
    rows, columns : Cloud
    of_rows, of_columns : arrays
        Values of the sorted points, as `row_bounds` and `column_bounds` take them.
    k : float
    budget : float
        What those may hold that are left out, as a share of any row.
    """
    n_rows, n_columns = len(rows.centers), len(columns.centers)
    sides = row_bounds(rows, of_rows, k), column_bounds(columns, of_columns, k)
    wide = None
    if n_rows * n_columns >= WIDE_FROM:
        wide = row_bounds(rows.wide, of_rows, k), column_bounds(columns.wide, of_columns, k)
    # All tiles under this together stay within a quarter of the budget, whatever their number;
    # so do all groups of tiles.
    hopeless = np.float32(np.log2(0.25 * budget / n_columns))
    first, count = 0, 0
    lengths: list[NDArray[np.int64]] = []
    tiles: list[NDArray[np.uint32]] = []
    shares: list[NDArray[np.float32]] = []
    wides = [] if wide is None else [wide]
    limit = float(hopeless) + np.log2(n_columns / -(-n_columns // WIDTH_OF_GROUPS))
    for section, numbers in _blocks(n_rows, n_columns, wides, k, limit):
        bounds = tile_bounds(sides[0], section, sides[1], k, numbers)
        # No row is without: its best tile has its largest bound.
        above = bounds >= np.minimum(bounds.max(axis=1), hopeless)[:, None]
        places = np.flatnonzero(above)
        lengths.append(np.count_nonzero(above, axis=1))
        tiles.append(_numbered(places, above.shape[1], numbers))
        shares.append(np.exp2(np.minimum(bounds.ravel()[places], np.float32(60.0))))
        count += len(places)
        if count >= CHUNK_PAIRS or section.stop == n_rows:
            part = range(first, section.stop)
            starts = np.concatenate(([0], np.cumsum(np.concatenate(lengths))))
            keep, unseen = _keep(starts, np.concatenate(shares), 0.5 * budget)
            each = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
            pairs = _tile_pairs(rows, columns, part, each, np.concatenate(tiles)[keep])
            yield _Candidates(part, pairs, unseen + 0.5 * budget)
            first, count, lengths, tiles, shares = section.stop, 0, [], [], []


def possible_pairs(
    rows: Cloud,
    columns: Cloud,
    values: list[tuple[Float64, Float64]],
    k: float,
) -> Iterator[tuple[range, TilePairs]]:
    """Yield pairs of tiles that any of some bounds leaves above 0, in parts of the row tiles.

    Parameters
    ----------
    rows, columns : Cloud
    values : list of (rows', columns') arrays
        As `row_bounds` and `column_bounds` (of the largest term) take them.
    k : float
    """

    def bounds_of(one: Tiles, other: Tiles) -> list[tuple[TileBounds, TileBounds]]:
        return [(row_bounds(one, r, k), column_bounds(other, c, k, True)) for r, c in values]

    n_rows, n_columns = len(rows.centers), len(columns.centers)
    sides = bounds_of(rows, columns)
    wides = bounds_of(rows.wide, columns.wide) if n_rows * n_columns >= WIDE_FROM else []
    first, count = 0, 0
    lengths: list[NDArray[np.int64]] = []
    tiles: list[NDArray[np.uint32]] = []
    for section, numbers in _blocks(n_rows, n_columns, wides, k, 0.0):
        bounds = [tile_bounds(one, section, other, k, numbers) for one, other in sides]
        highest = functools.reduce(np.maximum, bounds)
        # Reductions want at least one column tile for each row tile.
        above = highest >= np.minimum(highest.max(axis=1), 0.0)[:, None]
        lengths.append(np.count_nonzero(above, axis=1))
        tiles.append(_numbered(np.flatnonzero(above), above.shape[1], numbers))
        count += len(tiles[-1])
        if count >= CHUNK_PAIRS or section.stop == n_rows:
            part = range(first, section.stop)
            yield (
                part,
                _tile_pairs(rows, columns, part, np.concatenate(lengths), np.concatenate(tiles)),
            )
            first, count, lengths, tiles = section.stop, 0, [], []


def _blocks(
    n_rows: int,
    n_columns: int,
    wides: list[tuple[TileBounds, TileBounds]],
    k: float,
    limit: float,
) -> Iterator[tuple[slice, NDArray[np.int64] | None]]:
    """Yield row tiles, and the numbers of the column tiles to bound there; None for all.

    With bounds of groups of tiles those groups are left out that stay under a limit.
    """
    if not wides:
        step = max(1, BLOCK_BOUNDS // n_columns)
        for begin in range(0, n_rows, step):
            yield slice(begin, min(begin + step, n_rows)), None
        return
    members = np.arange(WIDTH_OF_GROUPS)
    n_groups = len(wides[0][0].centers)
    step = max(1, BLOCK_BOUNDS // len(wides[0][1].centers))
    for begin in range(0, n_groups, step):
        section = slice(begin, min(begin + step, n_groups))
        bounds = [tile_bounds(one, section, other, k) for one, other in wides]
        highest = functools.reduce(np.maximum, bounds)
        above = highest >= np.minimum(highest.max(axis=1), np.float32(limit))[:, None]
        for group, kept in enumerate(above, begin):
            numbers = (WIDTH_OF_GROUPS * np.flatnonzero(kept)[:, None] + members).ravel()
            first = WIDTH_OF_GROUPS * group
            yield (
                slice(first, min(first + WIDTH_OF_GROUPS, n_rows)),
                numbers[: np.searchsorted(numbers, n_columns)],
            )


def _numbered(
    places: NDArray[np.int64], width: int, numbers: NDArray[np.int64] | None
) -> NDArray[np.uint32]:
    """Return the column tiles at places of a block of bounds."""
    tiles = places % width
    return (tiles if numbers is None else numbers[tiles]).astype(np.uint32)


def joined_pairs(rows: Cloud, columns: Cloud, one: TilePairs, other: TilePairs) -> TilePairs:
    """Return the pairs of tiles in a list of the rows, or in one of the columns."""
    own = np.repeat(np.arange(len(rows.centers)), np.diff(one.starts)) * len(columns.centers)
    others = np.repeat(np.arange(len(columns.centers)), np.diff(other.starts))
    keys = np.union1d(own + one.tiles, other.tiles * np.int64(len(columns.centers)) + others)
    lengths = np.bincount(keys // len(columns.centers), minlength=len(rows.centers))
    tiles = (keys % len(columns.centers)).astype(np.uint32)
    return _tile_pairs(rows, columns, range(len(rows.centers)), lengths, tiles)


def _tile_pairs(
    rows: Cloud,
    columns: Cloud,
    part: range,
    lengths: NDArray[np.int64],
    tiles: NDArray[np.uint32],
) -> TilePairs:
    """Return the pairs of some row tiles; the others have none."""
    each = np.zeros(len(rows.centers), np.int64)
    each[part.start : part.stop] = lengths
    owner = np.repeat(np.arange(len(each)), each)
    distances = np.zeros(len(tiles))
    for d in range(rows.centers.shape[1]):
        distances += 0.5 * (rows.centers[owner, d] - columns.centers[tiles, d]) ** 2
    return TilePairs(np.concatenate(([0], np.cumsum(each))), tiles, distances)


def _keep(
    starts: NDArray[np.int64], shares: NDArray[Any], budget: float
) -> tuple[NDArray[np.bool_], Float64]:
    """Choose which shares to keep so that those left out add to no more than the budget.

    Parameters
    ----------
    starts : (k + 1,) array
        Where each row's shares begin; none is without.
    shares : (n,) array
    budget : float

    Returns
    -------
    keep : (n,) array of bool
        Each row's largest always is.
    left : (k,) array
        Sum of those left out.
    """
    lengths = np.diff(starts)
    largest = np.maximum.reduceat(shares, starts[:-1])
    cut, left = np.zeros(len(lengths)), np.zeros(len(lengths))
    for candidate in budget * CUTS[::-1]:
        limit = np.minimum(candidate, largest)
        below = np.where(shares < np.repeat(limit, lengths), shares, 0)
        sums = np.add.reduceat(below, starts[:-1], dtype=float)
        fits = sums <= budget
        cut[fits], left[fits] = limit[fits], sums[fits]
    return shares >= np.repeat(cut, lengths), left


def _largest_cost(
    rows: Cloud,
    columns: Cloud,
    lengths: NDArray[np.int64],
    tiles: NDArray[np.uint32],
    distances: Float64,
) -> float:
    """Return a bound of the cost of all pairs of points in pairs of tiles."""
    radii = [
        np.sqrt(np.sum(half_sides(tiles).astype(float) ** 2, axis=1)) for tiles in (rows, columns)
    ]
    farthest = np.sqrt(2 * distances) + np.repeat(radii[0], lengths) + radii[1][tiles]
    return 0.5 * float(farthest.max()) ** 2
