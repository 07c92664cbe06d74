"""Convert a plan between blocks of pixels to a plan between pixels, which are then drawn."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array, BoolArray, IntArray
from clmorph.images.resizing import resized
from clmorph.measures.pixel_blocks import PixelBlocks
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan, plan_of_pairs
from clmorph.transport.plan_sampling import Draws


def refined(
    plan: Plan | Barycentric, source: PixelBlocks, target: PixelBlocks
) -> Plan | Barycentric:  # fmt: skip
    """Convert a plan between blocks to a plan between their pixels.

    The mass of a pair goes from each pixel of one block to the pixel at its place in the other, or
    to several if that has more: blocks move unchanged, and images keep all detail. Marginals are
    those of the blocks, divided among the pixels by mass.
    """
    if source.side == target.side == 1:
        return plan
    if isinstance(plan, Barycentric):
        return _refined_means(plan, source, target)
    i, j = plan.rows, plan.indices.astype(np.int64)
    a, b = source.fine.weights, target.fine.weights
    side, parts = max(source.side, target.side), []
    for place in np.ndindex(side, side):
        rows, inside = _at_place(source, i, place, side)
        columns, there = _at_place(target, j, place, side)
        pairs = np.flatnonzero(inside | there)
        parts.append((pairs, rows[pairs], columns[pairs]))
    pairs, rows, columns = (np.concatenate(values) for values in zip(*parts, strict=True))
    weights = a[rows] * b[columns]
    whole = np.bincount(pairs, weights, len(plan))
    per_pair = np.divide(plan.mass, whole, out=np.zeros(len(plan)), where=whole > 0)
    mass = weights * per_pair[pairs]
    # If no place has mass in both blocks, the heaviest pixels represent the blocks.
    lone = np.flatnonzero(whole == 0)
    rows = np.concatenate((rows, source.heaviest[i[lone]]))
    columns = np.concatenate((columns, target.heaviest[j[lone]]))
    mass = np.concatenate((mass, plan.mass[lone]))
    return _as_plan(rows, columns, mass, plan.marginals, source, target)


def drawn(
    draws: Draws,
    source: PixelBlocks,
    target: PixelBlocks,
    points: tuple[IntArray, IntArray] | None = None,
) -> Plan:
    """Convert draws from a plan between blocks to pairs of pixels, each draw to one pair.

    The draws of a row are ordered along a Z-curve over the target's blocks, and go in turn, by
    mass, to the pixels of the row's block in the same order: every pixel gets draws from the whole
    row, and neighbors go to neighboring blocks, there to the pixel at their own place. Draws of
    columns are treated likewise. `points` are the blocks between which the plan is; all if missing.
    """
    by_row, by_column = draws.masses()
    sizes = len(source.coarse), len(target.coarse)
    targets: AnyArray = draws.targets
    sources: AnyArray = draws.sources
    i, j = np.arange(sizes[0]), np.arange(sizes[1])
    if points is not None:
        i, j = points
        targets, sources = j[targets], i[sources]
    with ThreadPoolExecutor(1) as pool:  # NumPy sorts and searches without Python's lock
        of_columns = pool.submit(_to_pixels, sources, j, by_column, target, source)
        own, other, mass = _to_pixels(targets, i, by_row, source, target)
        back, forth, arriving = of_columns.result()
    rows, columns = np.concatenate((own, forth)), np.concatenate((other, back))
    marginals = np.zeros(sizes[0]), np.zeros(sizes[1])
    marginals[0][i], marginals[1][j] = draws.row_mass, draws.column_mass
    return _as_plan(rows, columns, np.concatenate((mass, arriving)), marginals, source, target)


def _to_pixels(
    drawn: AnyArray, chosen: IntArray, masses: Array, own: PixelBlocks, other: PixelBlocks
) -> tuple[IntArray, IntArray, Array]:
    """Return pixel pairs of one side's draws: own pixels, other pixels, and masses of the pairs."""
    n, count = drawn.shape
    along = z_order(*np.divmod(np.arange(len(other.coarse)), other.coarse.shape[1]))
    order = np.argsort(along[drawn], axis=1, kind="stable")
    blocks, others = (np.repeat(chosen, count), np.take_along_axis(drawn, order, axis=1).ravel())
    mass = np.take_along_axis(masses, order, axis=1).ravel()
    travels = np.flatnonzero(mass > 0)
    rank, finest = np.tile(np.arange(count), n)[travels], max(own.side, other.side)
    pixels, place = _in_turn(own, blocks[travels], rank, count, finest)
    there, _ = _at_place(other, others[travels].astype(np.int64), place, finest)
    return pixels, _with_mass(other)[there], mass[travels]


def z_order(row: IntArray, column: IntArray) -> IntArray:
    """Return the positions of grid points along a Z-curve (Morton 1966), by interleaved bits."""
    code = np.zeros_like(row)
    for bit in range(int(max(row.max(initial=0), column.max(initial=0))).bit_length()):
        code |= (column >> bit & 1) << 2 * bit | (row >> bit & 1) << 2 * bit + 1
    return code


def _along_curve(blocks: PixelBlocks) -> IntArray:
    """Return the pixels, block by block, along a Z-curve in each."""
    places = np.divmod(np.arange(len(blocks.fine)), blocks.fine.shape[1])
    return np.lexsort((z_order(*(axis % blocks.side for axis in places)), blocks.owners))


def _in_turn(
    blocks: PixelBlocks, owner: IntArray, rank: IntArray, draws: int, finest: int
) -> tuple[IntArray, IntArray]:
    """Return the pixel of each draw, and its place (row and column) in the largest block."""
    order = _along_curve(blocks)
    owners = blocks.owners[order]
    count = np.bincount(owners, minlength=len(blocks.coarse))
    share = blocks.fine.weights[order] / np.maximum(
        blocks.coarse.weights[owners], np.finfo(float).tiny
    )
    before = np.append(0.0, np.cumsum(np.bincount(owners, share)))[owners]  # of all blocks before
    ends = owners + np.clip(np.cumsum(share) - before, 0.0, 1.0)
    n = count[owner]
    level = ((rank % n) + (rank // n + 0.5) / -(-draws // n)) / n
    found = np.minimum(np.searchsorted(ends, owner + level), np.cumsum(count)[owner] - 1)
    # The remainder of the level selects one of the places that a pixel covers in a larger block.
    inner = np.clip((owner + level - ends[found]) / np.maximum(share[found], 1e-12) + 1, 0, 1)
    pixels = order[found]
    inside = np.stack(np.divmod(pixels, blocks.fine.shape[1])) % blocks.side
    per_pixel = finest // blocks.side
    sub = np.minimum((inner * per_pixel**2).astype(np.int64), per_pixel**2 - 1)
    return pixels, inside * per_pixel + np.stack(np.divmod(sub, per_pixel))


def _at_place(
    blocks: PixelBlocks, owner: IntArray, place: Any, finest: int
) -> tuple[IntArray, BoolArray]:
    """Return each block's pixel at a place (row and column) of the largest block, and if it has it.

    A block that the border cuts off repeats its pixels.
    """
    pixels, there = np.zeros(owner.shape, np.int64), np.ones(owner.shape, bool)
    indices = np.divmod(owner, blocks.coarse.shape[1])
    for index, length, offset in zip(indices, blocks.fine.shape, place, strict=True):
        inside = np.minimum(blocks.side, length - index * blocks.side)
        wanted = offset * blocks.side // finest
        there &= wanted < inside
        pixels = pixels * length + index * blocks.side + wanted % inside
    return pixels, there


def _with_mass(blocks: PixelBlocks) -> IntArray:
    """Return each pixel, or for one without mass the next one of its block that has some."""
    count, massive = len(blocks.fine), blocks.fine.weights > 0
    if massive.all():
        return np.arange(count)
    order = _along_curve(blocks)
    owners, there = blocks.owners[order], np.flatnonzero(massive[order])
    following = np.searchsorted(there, np.arange(count))
    found = np.arange(count)
    # The next one along the curve, or the one before, if it is of the same block.
    for near in (following, following - 1):
        near = there[np.clip(near, 0, len(there) - 1)] if len(there) else np.arange(count)
        wanted = ~massive[order[found]] & (owners[near] == owners)
        found = np.where(wanted, near, found)
    chosen = np.empty(count, np.int64)
    chosen[order] = order[found]
    return chosen


def _as_plan(
    rows: IntArray,
    columns: IntArray,
    mass: Array,
    marginals: tuple[Array, Array],
    source: PixelBlocks,
    target: PixelBlocks,
) -> Plan:
    """Return pairs of pixels as a plan whose marginals are those of the blocks, by mass."""
    shape = len(source.fine), len(target.fine)
    row_mass, column_mass = source.share_out(marginals[0]), target.share_out(marginals[1])
    rows, columns, mass = _with_all_pixels(rows, columns, mass, source, row_mass)
    columns, rows, mass = _with_all_pixels(columns, rows, mass, target, column_mass)
    return plan_of_pairs((rows, columns), mass, shape, (row_mass, column_mass))


def _with_all_pixels(
    own: IntArray, other: IntArray, mass: Array, blocks: PixelBlocks, wanted: Array
) -> tuple[IntArray, IntArray, Array]:
    """Let pixels that should move but have no pair share the heaviest pair of their block.

    Such pixels have little mass in comparison with others of their block, or have no partner at
    their place in the blocks to which their block moves. Without a pair they would not move.
    """
    missed = np.flatnonzero((wanted > 0) & (np.bincount(own, mass, len(wanted)) == 0))
    if not len(missed):
        return own, other, mass
    owners = blocks.owners
    near = np.flatnonzero(np.isin(owners[own], owners[missed]) & (mass > 0))
    order = near[np.lexsort((mass[near], owners[own[near]]))]
    heaviest = np.full(len(blocks.coarse), -1)
    heaviest[owners[own[order]]] = order  # the last pair of each block, the heaviest one, is kept
    missed = missed[heaviest[owners[missed]] >= 0]
    pairs = heaviest[owners[missed]]
    mass = mass / (1 + np.bincount(pairs, minlength=len(mass)))
    return (
        np.concatenate((own, missed)),
        np.concatenate((other, other[pairs])),
        np.concatenate((mass, mass[pairs])),
    )


def _refined_means(plan: Barycentric, source: PixelBlocks, target: PixelBlocks) -> Barycentric:
    """Move each pixel as the blocks around it move, by linear interpolation between them."""
    fine, coarse, owners = source.fine, source.coarse, source.owners

    def between(values: Array) -> Array:
        grid = values.reshape(*coarse.shape, -1)
        height, width = (side * source.side for side in coarse.shape)
        whole = resized(grid, (height, width))
        return whole[: fine.shape[0], : fine.shape[1]].reshape(len(fine), -1)

    return replace(
        plan, positions=fine.positions + between(plan.positions - coarse.positions),
        colors=np.clip(between(plan.colors), 0.0, 1.0), covariance=plan.covariance[owners],
        row_mass=source.share_out(plan.row_mass), column_mass=target.share_out(plan.column_mass),
    )  # fmt: skip
