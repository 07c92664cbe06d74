"""Find pairs of tiles that bounds do not exclude, and choose which of them to keep."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.threads import in_order
from clmorph.backends.opencl.kernels.clouds import WIDTH_OF_GROUPS, Cloud, Tiles
from clmorph.backends.opencl.kernels.row_loop import RowLoop
from clmorph.backends.opencl.kernels.tile_bounds import (
    BoundTiles,
    TileLists,
    all_tiles,
    tile_bounds,
)
from clmorph.backends.opencl.kernels.tile_pairs import (
    TileBounds,
    TilePairs,
    column_bounds,
    row_bounds,
)
from clmorph.backends.records import Float64

#: The number of pairs of tiles from which groups of tiles are bounded first.
WIDE_FROM = 1 << 24
#: The number of pairs of tiles that are yielded together, at least.
CHUNK_PAIRS = 1 << 20
#: Thresholds at which a list of shares may be cut, as fractions of the budget.
CUTS = 8.0 ** -np.arange(7)

#: Bounds of pairs of tiles: the terms of the rows' and of the columns' side.
_Sides = tuple[TileBounds, TileBounds]


class Candidates(NamedTuple):
    """Column tiles of some row tiles, and a bound of the share of all other column tiles."""

    part: range
    pairs: TilePairs
    unseen: Float64  #: (row tiles of the part,)


def candidates(
    loop: RowLoop,
    rows: Cloud,
    columns: Cloud,
    bounds: TileBounds,
    of_rows: Float64,
    of_columns: Float64,
    k: float,
    budget: float,
) -> Iterator[Candidates]:
    """Yield pairs of tiles, in parts of the row tiles; others hold at most the share `budget`."""
    n_columns = len(columns.centers)
    sides = [(bounds, column_bounds(columns, of_columns, k))]
    wides: list[_Sides] = []
    if len(rows.centers) * n_columns >= WIDE_FROM:
        wides = [(row_bounds(rows.wide, of_rows, k), column_bounds(columns.wide, of_columns, k))]
    # All tiles below this limit together stay within a quarter of the budget, whatever their
    # number; so do all groups of tiles.
    hopeless = float(np.log2(0.25 * budget / n_columns))
    limit = hopeless + np.log2(n_columns / -(-n_columns // WIDTH_OF_GROUPS))

    def chosen(bound: BoundTiles) -> Candidates:
        starts, tiles, values = _above(bound, hopeless)
        # In units of the budget, because shares of small budgets would underflow.
        shares = np.exp2(np.fmin(values - np.float32(np.log2(budget)), np.float32(60.0)))
        keep, unseen = kept_shares(starts, shares, 0.5)
        each = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
        pairs = paired(rows, columns, bound.part, each, tiles[keep])
        return Candidates(bound.part, pairs, (unseen + 0.5) * budget)

    bounded = tile_bounds(loop, rows, sides, k, _lists(loop, rows, columns, wides, k, limit))
    yield from _joined((found for _, found in in_order(chosen, bounded)), len(rows.centers))


def possible_pairs(
    loop: RowLoop, rows: Cloud, columns: Cloud, values: list[tuple[Float64, Float64]], k: float
) -> Iterator[tuple[range, TilePairs]]:
    """Yield pairs of tiles of which one bound is not below 0, at least one of each row tile."""

    def bounds_of(one: Tiles, other: Tiles) -> list[_Sides]:
        return [(row_bounds(one, r, k), column_bounds(other, c, k, True)) for r, c in values]

    sides = bounds_of(rows, columns)
    many = len(rows.centers) * len(columns.centers) >= WIDE_FROM
    wides = bounds_of(rows.wide, columns.wide) if many else []

    def possible(bound: BoundTiles) -> Candidates:
        starts, tiles, _ = _above(bound, 0.0)
        pairs = paired(rows, columns, bound.part, np.diff(starts), tiles)
        return Candidates(bound.part, pairs, np.zeros(len(bound.part)))

    bounded = tile_bounds(loop, rows, sides, k, _lists(loop, rows, columns, wides, k, 0.0))
    for part, pairs, _ in _joined(map(possible, bounded), len(rows.centers)):
        yield part, pairs


def _joined(parts: Iterable[Candidates], n_rows: int) -> Iterator[Candidates]:
    """Join successive parts until they have `CHUNK_PAIRS` pairs of tiles, and yield each whole."""
    waiting: list[Candidates] = []
    count = 0
    for found in parts:
        waiting.append(found)
        count += len(found.pairs.tiles)
        if count < CHUNK_PAIRS and found.part.stop < n_rows:
            continue
        own = [each.pairs for each in waiting]
        # Lists of a part count no pairs of other row tiles.
        pairs = TilePairs(
            sum((each.starts for each in own[1:]), own[0].starts),
            np.concatenate([each.tiles for each in own]),
            np.concatenate([each.distances for each in own]),
        )
        unseen = np.concatenate([each.unseen for each in waiting])
        yield Candidates(range(waiting[0].part.start, found.part.stop), pairs, unseen)
        waiting, count = [], 0


def _lists(
    loop: RowLoop, rows: Cloud, columns: Cloud, wides: list[_Sides], k: float, limit: float
) -> Iterator[TileLists]:
    """Yield the column tiles of blocks of row tiles, without groups bounded below `limit`."""
    n_columns = len(columns.centers)
    if not wides:
        yield all_tiles(len(rows.centers), n_columns)
        return
    every = all_tiles(len(rows.wide.centers), len(columns.wide.centers))
    for bound in tile_bounds(loop, rows, wides, k, [every]):
        starts, groups, _ = _above(bound, limit)
        members = np.arange(WIDTH_OF_GROUPS, dtype=np.uint32)
        tiles: NDArray[np.uint32] = np.uint32(WIDTH_OF_GROUPS) * groups[:, None] + members
        present = tiles < n_columns
        lengths = np.add.reduceat(present.sum(axis=1), starts[:-1])
        yield TileLists(bound.part.start, tiles[present], np.cumsum(lengths) - lengths, lengths)


def _above(
    bound: BoundTiles, limit: float
) -> tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.float32]]:
    """Return column tiles not below a limit, or the highest one: starts, numbers, bounds."""
    values, starts = bound.values, bound.starts
    above = ~(values < limit)  # a bound that overflows is no number, and is kept
    for row in np.flatnonzero(~np.logical_or.reduceat(above, starts[:-1])):
        above[starts[row] + np.argmax(values[starts[row] : starts[row + 1]])] = True
    places = np.flatnonzero(above)
    found = np.searchsorted(places, starts)
    tiles = bound.numbers[places - np.repeat(bound.list_offsets, np.diff(found))]
    return found, tiles, values[places]


def joined_pairs(rows: Cloud, columns: Cloud, one: TilePairs, other: TilePairs) -> TilePairs:
    """Return the pairs of tiles that are in the list of the rows or in the list of the columns."""
    own = np.repeat(np.arange(len(rows.centers)), np.diff(one.starts)) * len(columns.centers)
    others = np.repeat(np.arange(len(columns.centers)), np.diff(other.starts))
    keys = np.union1d(own + one.tiles, other.tiles * np.int64(len(columns.centers)) + others)
    lengths = np.bincount(keys // len(columns.centers), minlength=len(rows.centers))
    tiles = (keys % len(columns.centers)).astype(np.uint32)
    return paired(rows, columns, range(len(rows.centers)), lengths, tiles)


def paired(
    rows: Cloud, columns: Cloud, part: range, lengths: NDArray[np.int64], tiles: NDArray[np.uint32]
) -> TilePairs:
    """Return the pairs of some row tiles as a list in which other row tiles have no pairs."""
    each = np.zeros(len(rows.centers), np.int64)
    each[part.start : part.stop] = lengths
    distances = np.zeros(len(tiles))
    for own, others in zip(rows.centers.T, columns.centers.T, strict=True):
        between = np.repeat(own, each)
        between -= others[tiles]
        between *= between
        distances += between
    distances *= 0.5
    return TilePairs(np.concatenate(([0], np.cumsum(each))), tiles, distances)


def kept_shares(
    starts: NDArray[np.int64], shares: NDArray[Any], budget: float
) -> tuple[NDArray[np.bool_], Float64]:
    """Return a mask of shares so that others of a row sum to a budget at most, and these sums."""
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
