"""Solve low, render high: transport between cells of pixels, drawn with the pixels themselves."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from clmorph.errors import InputError
from clmorph.images.pixels import resized
from clmorph.measures.lift import Measure
from clmorph.transport.plan import Plan
from clmorph.transport.plan_sampling import Barycentric, Draws

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PixelCells:
    """An image's pixels, in square cells.

    Attributes
    ----------
    fine : Measure
        The pixels.
    coarse : Measure
        The cells: each has its pixels' mass, and their mean position and color by mass.
    side : int
        Pixels along a cell, a power of two; cells at the right and the lower border can be
        smaller.
    """

    fine: Measure
    coarse: Measure
    side: int

    @property
    def owners(self) -> NDArray[np.int64]:
        """(N,) cell of each pixel."""
        return _owners(self.fine.shape, self.side)

    @property
    def heaviest(self) -> NDArray[np.int64]:
        """(cells,) pixel of most mass in each cell."""
        order = np.lexsort((self.fine.weights, self.owners))
        last = np.cumsum(np.bincount(self.owners, minlength=len(self.coarse))) - 1
        return np.asarray(order[last], np.int64)


def _owners(shape: tuple[int, int], side: int) -> NDArray[np.int64]:
    height, width = shape
    columns = -(-width // side)
    row, column = np.arange(height) // side, np.arange(width) // side
    return (row[:, None] * columns + column).ravel()


def in_cells(measure: Measure, size: int) -> PixelCells:
    """Gather an image's pixels into cells.

    Parameters
    ----------
    measure : Measure
    size : int
        The most cells along the longer side.

    Returns
    -------
    PixelCells
        Of one pixel each if the image is no larger.

    Raises
    ------
    InputError
        If each pixel has its own metric of color.
    """
    side = 1
    while -(-max(measure.shape) // side) > size:
        side *= 2
    if side == 1:
        return PixelCells(measure, measure, 1)
    if measure.has_metric_map:
        raise InputError(
            "solve_size: not with a color metric for each pixel; leave it out, or give one metric"
        )
    owners = _owners(measure.shape, side)
    height, width = (-(-length // side) for length in measure.shape)
    count = height * width
    mass = np.asarray(np.bincount(owners, measure.weights, count), float)
    # A cell without mass stands at its middle, in its pixels' mean color.
    even = np.bincount(owners, minlength=count)
    shares = np.where(mass[owners] > 0, measure.weights, 1.0)
    shares = shares / np.where(mass > 0, mass, even)[owners]

    def mean(values: Array) -> Array:
        return np.column_stack([np.bincount(owners, shares * axis, count) for axis in values.T])

    coarse = Measure(
        mean(measure.positions), np.clip(mean(measure.colors), 0.0, 1.0), mass, (height, width),
        measure.color_weight, measure.extent, measure.color_space, measure.color_metric,
    )  # fmt: skip
    return PixelCells(measure, coarse, side)


def refined(
    plan: Plan | Barycentric, source: PixelCells, target: PixelCells
) -> Plan | Barycentric:  # fmt: skip
    """Return a plan between cells as one between their pixels.

    What goes from one cell to another goes from each of its pixels to the one at the same
    place in the other, or to several, if that has more: cells move as they are, so that both
    images keep all their detail.

    Parameters
    ----------
    plan : Plan or Barycentric
        Between `source.coarse` and `target.coarse`.
    source, target : PixelCells

    Returns
    -------
    Plan or Barycentric
        Its marginals are those of the cells, shared out by mass.
    """
    if source.side == target.side == 1:
        return plan
    if isinstance(plan, Barycentric):
        return _refined_means(plan, source, target)
    i, j = plan.rows, plan.indices.astype(np.int64)
    a, b = source.fine.weights, target.fine.weights
    parts = [_pixels(source, target, i, j, place) for place in _places(source, target)]
    weights = [a[rows] * b[columns] for _, rows, columns in parts]
    whole = sum(
        np.bincount(pairs, weight, len(plan))
        for (pairs, _, _), weight in zip(parts, weights, strict=True)
    )
    pairs, rows, columns = (np.concatenate(values) for values in zip(*parts, strict=True))
    per_pair = np.divide(plan.mass, whole, out=np.zeros(len(plan)), where=whole > 0)
    mass = np.concatenate(weights) * per_pair[pairs]
    # Where no place has mass in both cells, the heaviest pixels stand for them.
    lone = np.flatnonzero(whole == 0)
    rows = np.concatenate((rows, source.heaviest[i[lone]]))
    columns = np.concatenate((columns, target.heaviest[j[lone]]))
    mass = np.concatenate((mass, plan.mass[lone]))
    return _as_plan(rows, columns, mass, plan.marginals, source, target)


def _places(source: PixelCells, target: PixelCells) -> list[tuple[int, int]]:
    """Places in the finer of two cells: row and column."""
    side = max(source.side, target.side)
    return [(row, column) for row in range(side) for column in range(side)]


def _pixels(
    source: PixelCells,
    target: PixelCells,
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    place: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs that have this place, and their pixels there, in source and target."""
    finest = max(source.side, target.side)
    there = np.ones((2, len(i)), bool)
    found = []
    for own, (cells, owner) in enumerate(((source, i), (target, j))):
        height, width = cells.fine.shape
        rows, columns = np.divmod(owner, cells.coarse.shape[1])
        pixel = []
        for index, length, offset in zip((rows, columns), (height, width), place, strict=True):
            inside = np.minimum(cells.side, length - index * cells.side)
            wanted = offset * cells.side // finest
            there[own] &= wanted < inside
            # A cell that is cut off by the border gives what it has again.
            pixel.append(index * cells.side + wanted % inside)
        found.append(pixel[0] * width + pixel[1])
    pairs = np.flatnonzero(there.any(axis=0))
    return pairs, found[0][pairs], found[1][pairs]


def drawn(draws: Draws, source: PixelCells, target: PixelCells) -> Plan:
    """Return draws from a plan between cells as pairs of pixels, each draw once.

    The draws of a row, in the order of a Z-curve over the target's cells, go in turn to the cell's
    pixels, in the same order and by mass: every pixel gets some from all over the row, pixels
    nearby go to cells nearby, and each to the pixel at its own place in that cell. So do the draws
    of a column, with both images swapped.

    Parameters
    ----------
    draws : Draws
        Between `source.coarse` and `target.coarse`.
    source, target : PixelCells

    Returns
    -------
    Plan
        Its marginals are those of the cells, shared out by mass.
    """
    by_row, by_column = draws.masses()
    own, other, mass = _to_pixels(draws.targets, by_row, source, target)
    back, forth, arriving = _to_pixels(draws.sources, by_column, target, source)
    rows, columns = np.concatenate((own, forth)), np.concatenate((other, back))
    marginals = draws.row_mass, draws.column_mass
    return _as_plan(rows, columns, np.concatenate((mass, arriving)), marginals, source, target)


def _to_pixels(
    drawn: NDArray[np.int32], masses: Array, own: PixelCells, other: PixelCells
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return draws of one side's cells as pairs of pixels: own, others', and their mass."""
    n, count = drawn.shape
    along = z_order(*np.divmod(np.arange(len(other.coarse)), other.coarse.shape[1]))
    order = np.argsort(along[drawn], axis=1, kind="stable")
    cells, others = np.repeat(np.arange(n), count), np.take_along_axis(drawn, order, axis=1).ravel()
    mass = np.take_along_axis(masses, order, axis=1).ravel()
    travels = np.flatnonzero(mass > 0)
    rank, finest = np.tile(np.arange(count), n)[travels], max(own.side, other.side)
    pixels, place = _in_turn(own, cells[travels], rank, count, finest)
    return pixels, _at_place(other, others[travels].astype(np.int64), place, finest), mass[travels]


def z_order(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the place of grid points along a Z-curve (Morton 1966): their bits, interleaved."""
    code = np.zeros_like(row)
    for bit in range(int(max(row.max(initial=0), column.max(initial=0))).bit_length()):
        code |= (column >> bit & 1) << 2 * bit | (row >> bit & 1) << 2 * bit + 1
    return code


def _in_turn(
    cells: PixelCells, owner: NDArray[np.int64], rank: NDArray[np.int64], draws: int, finest: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pixel of each draw and its place in the finest of cells, by row and column."""
    places = np.divmod(np.arange(len(cells.fine)), cells.fine.shape[1])
    order = np.lexsort((z_order(*(axis % cells.side for axis in places)), cells.owners))
    owners = cells.owners[order]
    count = np.bincount(owners, minlength=len(cells.coarse))
    share = cells.fine.weights[order] / np.maximum(
        cells.coarse.weights[owners], np.finfo(float).tiny
    )
    ends = owners + np.clip(np.cumsum(share) - _before(share, owners), 0.0, 1.0)
    n = count[owner]
    level = ((rank % n) + (rank // n + 0.5) / -(-draws // n)) / n
    found = np.minimum(np.searchsorted(ends, owner + level), np.cumsum(count)[owner] - 1)
    # What is left of the level chooses among the places that one pixel has in finer cells.
    inner = np.clip((owner + level - ends[found]) / np.maximum(share[found], 1e-12) + 1, 0, 1)
    pixels = order[found]
    row, column = np.divmod(pixels, cells.fine.shape[1])
    per_pixel = finest // cells.side
    sub = np.minimum((inner * per_pixel**2).astype(np.int64), per_pixel**2 - 1)
    place = np.stack(
        (
            row % cells.side * per_pixel + sub // per_pixel,
            column % cells.side * per_pixel + sub % per_pixel,
        )
    )
    return pixels, place


def _before(share: Array, owners: NDArray[np.int64]) -> Array:
    """Sum of the shares of all cells before each pixel's."""
    totals = np.cumsum(np.bincount(owners, share))
    return np.concatenate(([0.0], totals))[owners]


def _at_place(
    cells: PixelCells, owner: NDArray[np.int64], place: NDArray[np.int64], finest: int
) -> NDArray[np.int64]:
    """Return the pixel of each cell at a place; a cell that is cut off has what it has again."""
    found = []
    indices = np.divmod(owner, cells.coarse.shape[1])
    for index, length, offset in zip(indices, cells.fine.shape, place, strict=True):
        inside = np.minimum(cells.side, length - index * cells.side)
        found.append(index * cells.side + (offset * cells.side // finest) % inside)
    return np.asarray(found[0] * cells.fine.shape[1] + found[1])


def _as_plan(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    mass: Array,
    marginals: tuple[Array, Array],
    source: PixelCells,
    target: PixelCells,
) -> Plan:
    """Return pairs of pixels as a plan whose marginals are those of the cells, by mass."""
    shape = len(source.fine), len(target.fine)
    row_mass, column_mass = (
        _by_mass(cells, total) for cells, total in zip((source, target), marginals, strict=True)
    )
    rows, columns, mass = _with_all_pixels(rows, columns, mass, source, row_mass)
    columns, rows, mass = _with_all_pixels(columns, rows, mass, target, column_mass)
    matrix = coo_array((mass, (rows, columns)), shape=shape).tocsr()  # sums what is twice there
    matrix.sort_indices()
    matrix.eliminate_zeros()
    return Plan(
        matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32),
        np.asarray(matrix.data, float), shape, row_mass, column_mass,
    )  # fmt: skip


def _by_mass(cells: PixelCells, total: Array) -> Array:
    """Share out what cells have among their pixels, by mass."""
    weights = cells.coarse.weights[cells.owners]
    return np.divide(
        total[cells.owners] * cells.fine.weights, weights,
        out=np.zeros(len(cells.fine)), where=weights > 0,
    )  # fmt: skip


def _with_all_pixels(
    own: NDArray[np.int64],
    other: NDArray[np.int64],
    mass: Array,
    cells: PixelCells,
    wanted: Array,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Let pixels that move without a pair of their own share their cell's heaviest one.

    Those are light beside others of their cell, or have none at their place in the cells that
    theirs moves to. Without a pair they would stay behind.
    """
    missed = np.flatnonzero((wanted > 0) & (np.bincount(own, mass, len(wanted)) == 0))
    if not len(missed):
        return own, other, mass
    owners = cells.owners
    near = np.flatnonzero(np.isin(owners[own], owners[missed]) & (mass > 0))
    order = near[np.lexsort((mass[near], owners[own[near]]))]
    heaviest = np.full(len(cells.coarse), -1)
    heaviest[owners[own[order]]] = order  # the last of each cell stays
    missed = missed[heaviest[owners[missed]] >= 0]
    pairs = heaviest[owners[missed]]
    mass = mass / (1 + np.bincount(pairs, minlength=len(mass)))
    return (
        np.concatenate((own, missed)),
        np.concatenate((other, other[pairs])),
        np.concatenate((mass, mass[pairs])),
    )


def _refined_means(plan: Barycentric, source: PixelCells, target: PixelCells) -> Barycentric:
    """Move each pixel as the cells around it move, in between by linear interpolation."""
    fine, coarse, owners = source.fine, source.coarse, source.owners

    def between(values: Array) -> Array:
        grid = values.reshape(*coarse.shape, -1)
        height, width = (side * source.side for side in coarse.shape)
        whole = resized(grid, (height, width))
        return whole[: fine.shape[0], : fine.shape[1]].reshape(len(fine), -1)

    rows, columns = (
        _by_mass(cells, mass) for cells, mass in zip((source, target), plan.marginals, strict=True)
    )
    return replace(
        plan, positions=fine.positions + between(plan.positions - coarse.positions),
        colors=np.clip(between(plan.colors), 0.0, 1.0), covariance=plan.covariance[owners],
        row_mass=rows, column_mass=columns,
    )  # fmt: skip
