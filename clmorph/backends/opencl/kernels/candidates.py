"""Find pairs of tiles that bounds do not exclude, and choose which of them to keep."""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.opencl.kernels.clouds import WIDTH_OF_GROUPS, Cloud, Tiles
from clmorph.backends.opencl.kernels.tile_pairs import (
    TileBounds,
    TilePairs,
    column_bounds,
    row_bounds,
    tile_bounds,
)
from clmorph.backends.records import Float64

#: The number of entries of a block of bounds, small enough for a core's cache.
BLOCK_BOUNDS = 1 << 17
#: The number of pairs of tiles from which groups of tiles are bounded first.
WIDE_FROM = 1 << 24
#: The number of pairs of tiles that are handled together.
CHUNK_PAIRS = 1 << 20
#: Thresholds at which a list of shares may be cut, as fractions of the budget.
CUTS = 8.0 ** -np.arange(7)


class Candidates(NamedTuple):
    """Column tiles of some row tiles, and a bound of the share of all other column tiles."""

    part: range
    pairs: TilePairs
    unseen: Float64  #: (row tiles of the part,)


def candidates(
    rows: Cloud,
    columns: Cloud,
    bounds: TileBounds,
    of_rows: Float64,
    of_columns: Float64,
    k: float,
    budget: float,
) -> Iterator[Candidates]:
    """Yield the pairs of tiles that bounds do not exclude, in parts of the row tiles.

    Parameters
    ----------
    rows, columns : Cloud
    bounds : TileBounds
        Those of the rows: `row_bounds` of `of_rows`.
    of_rows, of_columns : arrays
        Values of the sorted points, the arguments of `row_bounds` and `column_bounds`.
    k : float
    budget : float
        The share of any row's sum that the excluded pairs may hold.
    """
    n_rows, n_columns = len(rows.centers), len(columns.centers)
    sides = bounds, column_bounds(columns, of_columns, k)
    wide = None
    if n_rows * n_columns >= WIDE_FROM:
        wide = row_bounds(rows.wide, of_rows, k), column_bounds(columns.wide, of_columns, k)
    # All tiles below this limit together stay within a quarter of the budget, whatever their
    # number; so do all groups of tiles.
    hopeless = np.float32(np.log2(0.25 * budget / n_columns))
    first, count = 0, 0
    lengths: list[NDArray[np.int64]] = []
    tiles: list[NDArray[np.uint32]] = []
    shares: list[NDArray[np.float32]] = []
    wides = [] if wide is None else [wide]
    limit = float(hopeless) + np.log2(n_columns / -(-n_columns // WIDTH_OF_GROUPS))
    for section, numbers in _blocks(n_rows, n_columns, wides, k, limit):
        highest = tile_bounds(sides[0], section, sides[1], k, numbers)
        # Every row keeps at least the tile with its largest bound.
        above = highest >= np.minimum(highest.max(axis=1), hopeless)[:, None]
        places = np.flatnonzero(above)
        lengths.append(np.count_nonzero(above, axis=1))
        tiles.append(_numbered(places, above.shape[1], numbers))
        # In units of the budget, because shares of small budgets would underflow.
        exponents = highest.ravel()[places] - np.float32(np.log2(budget))
        shares.append(np.exp2(np.minimum(exponents, np.float32(60.0))))
        count += len(places)
        if count >= CHUNK_PAIRS or section.stop == n_rows:
            part = range(first, section.stop)
            starts = np.concatenate(([0], np.cumsum(np.concatenate(lengths))))
            keep, unseen = kept_shares(starts, np.concatenate(shares), 0.5)
            each = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
            pairs = paired(rows, columns, part, each, np.concatenate(tiles)[keep])
            yield Candidates(part, pairs, (unseen + 0.5) * budget)
            first, count, lengths, tiles, shares = section.stop, 0, [], [], []


def possible_pairs(
    rows: Cloud,
    columns: Cloud,
    values: list[tuple[Float64, Float64]],
    k: float,
) -> Iterator[tuple[range, TilePairs]]:
    """Yield pairs of tiles for which at least one of several bounds exceeds 0, in parts.

    Parameters
    ----------
    rows, columns : Cloud
    values : list of (rows', columns') arrays
        Arguments of `row_bounds` and of `column_bounds` (for the largest term).
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
        # Reductions need at least one column tile for each row tile.
        above = highest >= np.minimum(highest.max(axis=1), 0.0)[:, None]
        lengths.append(np.count_nonzero(above, axis=1))
        tiles.append(_numbered(np.flatnonzero(above), above.shape[1], numbers))
        count += len(tiles[-1])
        if count >= CHUNK_PAIRS or section.stop == n_rows:
            part = range(first, section.stop)
            yield (
                part,
                paired(rows, columns, part, np.concatenate(lengths), np.concatenate(tiles)),
            )
            first, count, lengths, tiles = section.stop, 0, [], []


def _blocks(
    n_rows: int,
    n_columns: int,
    wides: list[tuple[TileBounds, TileBounds]],
    k: float,
    limit: float,
) -> Iterator[tuple[slice, NDArray[np.int64] | None]]:
    """Yield row tiles and the numbers of the column tiles to bound for them; None stands for all.

    If there are bounds of groups of tiles, groups whose bound is below a limit are left out.
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
    """Return the column tiles at the given indices of a flattened block of bounds."""
    tiles = places % width
    return (tiles if numbers is None else numbers[tiles]).astype(np.uint32)


def joined_pairs(rows: Cloud, columns: Cloud, one: TilePairs, other: TilePairs) -> TilePairs:
    """Return the pairs of tiles that are in the list of the rows or in the list of the columns."""
    own = np.repeat(np.arange(len(rows.centers)), np.diff(one.starts)) * len(columns.centers)
    others = np.repeat(np.arange(len(columns.centers)), np.diff(other.starts))
    keys = np.union1d(own + one.tiles, other.tiles * np.int64(len(columns.centers)) + others)
    lengths = np.bincount(keys // len(columns.centers), minlength=len(rows.centers))
    tiles = (keys % len(columns.centers)).astype(np.uint32)
    return paired(rows, columns, range(len(rows.centers)), lengths, tiles)


def paired(
    rows: Cloud,
    columns: Cloud,
    part: range,
    lengths: NDArray[np.int64],
    tiles: NDArray[np.uint32],
) -> TilePairs:
    """Return the pairs of some row tiles as a list in which other row tiles have no pairs."""
    each = np.zeros(len(rows.centers), np.int64)
    each[part.start : part.stop] = lengths
    owner = np.repeat(np.arange(len(each)), each)
    distances = np.zeros(len(tiles))
    for d in range(rows.centers.shape[1]):
        distances += 0.5 * (rows.centers[owner, d] - columns.centers[tiles, d]) ** 2
    return TilePairs(np.concatenate(([0], np.cumsum(each))), tiles, distances)


def kept_shares(
    starts: NDArray[np.int64], shares: NDArray[Any], budget: float
) -> tuple[NDArray[np.bool_], Float64]:
    """Choose the shares to keep so that the sum of the others does not exceed the budget.

    Parameters
    ----------
    starts : (k + 1,) array
        Index at which each row's shares begin; every row has at least one.
    shares : (n,) array
    budget : float

    Returns
    -------
    keep : (n,) array of bool
        Mask of the kept shares, which always include each row's largest one.
    left : (k,) array
        Sum of the shares left out of each row.
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
