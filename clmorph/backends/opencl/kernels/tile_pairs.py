"""Lists of column tiles for every row tile, and bounds of the share of a pair of tiles.

Let p and q be the centers of a row tile and a column tile, x = p + u and y_j = q + v_j points of
these tiles, and c_j = k g_j + log2 b_j. The sum over the column tile is 2^(s(x)) with

    s(x) = log2 sum_j 2^(c_j - k |x - y_j|^2 / 2).

For a suitable a, the term c_j - k |a - v_j|^2 / 2 hardly depends on j (q + a is then roughly the
place from which these columns get their mass). With A = log2 sum_j 2^(c_j - k |a - v_j|^2 / 2), the
half sides H of the column tile's box, and d = p - q + u,

    s(x) <= A + k |a|^2 / 2 - k |d|^2 / 2 + k H . |d - a|.

Likewise R_i + k |u_i|^2 / 2 >= r + k w . u_i over a row tile, for the logarithm R_i of the whole
sum of row i, so the tile's share in any of these rows is at most 2^B,

    B = A + k |a|^2 / 2 - r - k |p - q|^2 / 2 + k (h . |p - q + w| + H . (|p - q - a| + h))

with the half sides h of the row tile's box. The bound holds for any a and w; least squares gives
good ones. The device computes B and adds a bound of its rounding error.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.kernels.clouds import Tiles
from clmorph.backends.records import Float64


@dataclass(frozen=True, eq=False)
class TilePairs:
    """Column tiles of every row tile, and perhaps some columns of each."""

    #: (row tiles + 1,) array.
    starts: NDArray[np.int64]
    #: Ascending for each row tile: (pairs,) array.
    tiles: NDArray[np.uint32]
    #: Half the squared distance of the tiles' centers: (pairs,) array.
    distances: Float64
    #: The columns that each group of rows needs, for consecutive ranges of the row tiles. Each
    #: buffer holds a (pairs, groups, words) array of uint64: one bit for each column. All columns
    #: are needed if not given.
    masks: list[tuple[range, cl.Buffer]] | None = None
    #: (row tiles + 1,) For masks, the work of the row tiles before each one, in pairs of points.
    work: NDArray[np.int64] | None = None

    def without_masks(self) -> "TilePairs":
        """Return the same tiles with all their columns, for kernels that do not look at masks."""
        return replace(self, masks=None, work=None)

    def section(self, part: range) -> slice:
        """Return the indices of the pairs of some row tiles."""
        return slice(int(self.starts[part.start]), int(self.starts[part.stop]))

    def done(self, tile: int) -> NDArray[np.int64]:
        """Return the number of pairs of points of the row tiles before each one, and in all."""
        return self.starts * tile**2 if self.work is None else self.work


def center_costs(rows: Float64, columns: Float64) -> Float64:
    """Return |p - q|^2 / 2 of centers (..., D), in the same bits whichever pairs are listed."""
    costs = np.zeros(np.broadcast_shapes(rows.shape, columns.shape)[:-1])
    for d in range(rows.shape[-1]):
        costs += 0.5 * (rows[..., d] - columns[..., d]) ** 2
    return costs


class TileBounds(NamedTuple):
    """The terms of B from one side, for every tile: see the docstring of the module."""

    centers: NDArray[np.float32]  #: (tiles, D)
    sides: NDArray[np.float32]  #: (tiles, D) half sides of the boxes: h or H
    slopes: NDArray[np.float32]  #: (tiles, D): w or a
    level: NDArray[np.float32]  #: (tiles,): -r or A + k |a|^2 / 2


def column_bounds(cloud: Tiles, values: Float64, k: float, largest: bool = False) -> TileBounds:
    """Return the columns' terms of B, for the sum or its largest term, from the sorted c_j."""
    c = _padded(values, cloud)
    present = c > 0.5 * SENTINEL
    half = cloud.half_squares
    slopes = -cloud.slopes(np.where(present, c / k - half, 0.0), present)
    flat = c - k * (half - np.einsum("ntd,nd->nt", cloud.shifts, slopes))
    flat = np.where(present, flat, SENTINEL)  # the rest of |a - v|^2 / 2 cancels in B
    level = flat.max(axis=1)
    if not largest:
        level += np.log2(np.exp2(flat - level[:, None]).sum(axis=1))
    return _bounds(cloud, slopes, np.maximum(level, SENTINEL))


def row_bounds(cloud: Tiles, values: Float64, k: float) -> TileBounds:
    """Return the rows' terms of B from the sorted R_i, -SENTINEL where none is needed."""
    r = _padded(values, cloud)
    present = r < -0.5 * SENTINEL
    half = cloud.half_squares
    slopes = cloud.slopes(np.where(present, r / k + half, 0.0), present)
    flat = r + k * (half - np.einsum("ntd,nd->nt", cloud.shifts, slopes))
    lowest = np.where(present, flat, -SENTINEL).min(axis=1)
    return _bounds(cloud, slopes, np.maximum(-lowest, SENTINEL))


def _padded(values: Float64, cloud: Tiles) -> Float64:
    tiles, size, _ = cloud.shifts.shape
    # The padding repeats the last point and its value; in columns it can only raise the bound.
    return np.pad(values, (0, tiles * size - len(values)), mode="edge").reshape(tiles, size)


def _bounds(cloud: Tiles, slopes: Float64, level: Float64) -> TileBounds:
    return TileBounds(
        cloud.centers.astype(np.float32), cloud.half_sides, slopes.astype(np.float32),
        level.astype(np.float32),
    )  # fmt: skip
