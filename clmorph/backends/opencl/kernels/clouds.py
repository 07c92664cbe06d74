"""Clouds on the device, sorted into tiles, with coordinates split into pairs of float32."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph._shared.boxes import boxes_of_runs
from clmorph.backends.interface import MAX_POINTS
from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM, BuildConstants
from clmorph.backends.opencl.kernels.launches import Workspace
from clmorph.backends.records import Float64
from clmorph.errors import DeviceError

#: The number of consecutive tiles that are bounded together. They are compact too, because tiles
#: are leaves of a tree.
WIDTH_OF_GROUPS = 8
#: Bits of a sorting key: the position of a point in its segment, and the index of the point.
PLACE_BITS, POINT_BITS = 20, 24
#: Added to the normal equations, relative to their trace: points of a tile may lie in a plane.
RIDGE = 1e-6


def _slopes_of_some(
    shifts: NDArray[np.float32], values: Float64, present: NDArray[np.bool_]
) -> Float64:
    """Return the slopes of values of the points that are present: (tiles, D) array."""
    weights = present.astype(float)
    count = np.maximum(weights.sum(axis=1), 1.0)
    means = np.einsum("ntd,nt->nd", shifts, weights) / count[:, None]
    u = (shifts - means[:, None]) * weights[..., None]
    v = values - (np.einsum("nt,nt->n", values, weights) / count)[:, None]
    right = np.einsum("ntd,nt->nd", u, v * weights)
    normal = _with_ridge(np.einsum("ntd,nte->nde", u, u))
    slopes: Float64 = np.linalg.solve(normal, right[..., None])[..., 0]
    return slopes


def _with_ridge(normal: Float64) -> Float64:
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2) + 1e-30
    result: Float64 = normal + ridge[:, None, None] * np.eye(normal.shape[1])
    return result


@dataclass(frozen=True)
class Tiles:
    """Points in tiles, or in groups of tiles, each of which is a tile of its own."""

    #: Tile centers, exact in float32: (tiles, D) array.
    centers: Float64
    #: (tiles, tile, D) Points less their tile's center, padded by repeating the last point.
    shifts: NDArray[np.float32]

    @cached_property
    def half_squares(self) -> Float64:
        """Half the squared distances of the points from their tile's center: (tiles, tile)."""
        return 0.5 * np.einsum("ntd,ntd->nt", self.shifts, self.shifts, dtype=float)

    @cached_property
    def _of_values(self) -> NDArray[np.float32]:
        """The matrices that turn values of all points into slopes: (tiles, D, tile) array."""
        u = self.shifts - self.shifts.mean(axis=1, dtype=float)[:, None]
        across = np.swapaxes(u, 1, 2)
        # `solve` takes many times as long for so many right sides of small matrices.
        found: NDArray[np.float64] = np.linalg.inv(_with_ridge(across @ u)) @ across
        return found.astype(np.float32)

    def slopes(self, values: Float64, present: NDArray[np.bool_]) -> Float64:
        """Return least-squares slopes of values over present points, (tiles, D), as float32."""
        if self.shifts.shape[2] >= SLICED_FROM:
            # A tile has hardly more points than slopes.
            return np.zeros((len(values), self.shifts.shape[2]))
        centered = (values - values.mean(axis=1, keepdims=True)).astype(np.float32)
        slopes = (self._of_values @ centered[..., None])[..., 0]
        some = np.flatnonzero(~present.all(axis=1))
        if len(some):
            slopes[some] = _slopes_of_some(self.shifts[some], values[some], present[some])
        return slopes.astype(float)

    @cached_property
    def half_sides(self) -> NDArray[np.float32]:
        """Half sides of the tiles' boxes, rounded up: (tiles, D) array."""
        _, tile, dimension = self.shifts.shape
        sizes = np.abs(self.shifts).reshape(-1, dimension)
        return boxes_of_runs(sizes, np.arange(0, len(sizes), tile))[1] * np.float32(1 + 1e-6)


@dataclass(frozen=True, kw_only=True)
class Cloud(Tiles):
    """A cloud on the device, sorted into tiles and padded to whole ones."""

    #: Index of each sorted point in the caller's arrays: (N,) array.
    order: NDArray[np.intp]
    #: Logarithms of the masses of the sorted points; SENTINEL for zero mass: (N,) array.
    log2_weights: Float64
    #: Terms added to the costs of the sorted points: (N,) array.
    offsets: Float64
    #: (N,) Half the squared distances of points to their tile's center, plus their offsets.
    own_costs: Float64
    #: N rounded up to whole tiles.
    stride: int
    #: (2, D, stride) float32 points less their tile's center, and these differences' errors.
    shifts_buffer: cl.Buffer
    #: (tiles, D) float32.
    centers_buffer: cl.Buffer
    #: Smallest and largest coordinates: (2, D) array.
    box: Float64
    #: The content of `shifts_buffer`, where it is kept.
    planes: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.order)

    @cached_property
    def radii(self) -> Float64:
        """Bounds of the distances of points from the centers of their tiles: (tiles,) array."""
        return np.sqrt(np.sum(self.half_sides.astype(float) ** 2, axis=1))

    @cached_property
    def wide(self) -> Tiles:
        """The same points in groups of tiles."""
        tiles, tile, dimension = self.shifts.shape
        missing = -tiles % WIDTH_OF_GROUPS
        listed = (self.centers[:, None] + self.shifts).reshape(-1, dimension)
        listed = np.pad(listed, ((0, missing * tile), (0, 0)), mode="edge")
        centers, shifts = centered_tiles(listed, WIDTH_OF_GROUPS * tile)
        return Tiles(centers, shifts.astype(np.float32))


class CloudStore:
    """Uploads clouds to the device."""

    def __init__(
        self, work: Workspace, constants: BuildConstants, take_turns: Callable[[Any], Any]
    ) -> None:
        self._work, self._tile, self._part = work, constants.tile, constants.group_rows
        self._upload = take_turns(upload)

    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Cloud:
        """Sort a weighted cloud into tiles, which needs no device and no turn, and upload it."""
        points = np.asarray(points, float)
        if len(points) > MAX_POINTS:
            raise DeviceError(
                f"{len(points)} points are too many: expected at most 2^24; reduce the image"
            )
        order = tile_order(points, self._tile, part=self._part)
        return self._upload(self._work, self._tile, order, points, weights, offsets)


def upload(
    work: Workspace,
    tile: int,
    order: NDArray[np.intp],
    points: Float64,
    weights: Float64,
    offsets: Float64 | None = None,
    keep: bool = False,
) -> Cloud:
    """Upload (N, D) points, (N,) weights and terms of costs, in the `order` of tiles of a size."""
    n, dimension = len(order), points.shape[1]
    n_tiles = -(-n // tile)
    padded = np.pad(points[order], ((0, n_tiles * tile - n), (0, 0)), mode="edge")
    centers, tiles = centered_tiles(padded, tile)
    shifts = tiles.reshape(-1, dimension)
    planes = split(shifts.T)
    added = np.zeros(n) if offsets is None else np.asarray(offsets, float)[order]
    with np.errstate(divide="ignore"):
        log2_weights = np.log2(np.asarray(weights, float)[order])
    return Cloud(
        order=order,
        centers=centers,
        log2_weights=np.maximum(log2_weights, SENTINEL),
        offsets=added,
        own_costs=0.5 * np.sum(shifts[:n] ** 2, axis=1) + added,
        stride=n_tiles * tile,
        shifts=tiles.astype(np.float32),
        shifts_buffer=work.buffer(planes),
        centers_buffer=work.buffer(centers),
        box=boxes_of_runs(points)[:, 0],
        planes=planes if keep else None,
    )


def tile_order(
    points: NDArray[np.float64],
    size: int,
    counts: NDArray[np.int64] | None = None,
    part: int | None = None,
) -> NDArray[np.intp]:
    """Return the order, (N,), of tiles of `size` points and parts of `part`, cloud by cloud."""
    # Tiles are leaves of a k-d tree, compact so that differences in them suffice in float32.
    # Segments are halved along their longest side, at a multiple of `size` so that only the last
    # tile can be partly filled. Ties keep their order. There are at most 2^24 points, 2^18 clouds.
    count = len(points)
    everyone = np.arange(count)
    order, columns = everyone, points.T.copy()
    bounds = np.array([0, count]) if counts is None else np.append(0, np.cumsum(counts))
    firsts = bounds[:-1]
    while True:
        counts = np.diff(bounds)
        unit = size if part is None else np.where(counts > size, size, part)
        units = -(-counts // unit)
        if units.max(initial=0) <= 1:
            return order.astype(np.intp)
        starts = bounds[:-1]
        low = np.minimum.reduceat(columns, starts, axis=1)
        sides = np.maximum.reduceat(columns, starts, axis=1) - low
        axis = np.argmax(sides, axis=0)
        number = np.arange(len(counts))
        side = sides[axis, number]
        scale = np.zeros(len(counts))
        np.divide(2**PLACE_BITS - 1, side, out=scale, where=side > 1e-290)
        # A cloud that is done keeps its order, which is then that of this cloud alone.
        if len(firsts) > 1:
            segments = np.searchsorted(starts, firsts)
            left = np.maximum.reduceat(units, segments) > 1
            scale *= np.repeat(left, np.diff(np.append(segments, len(starts))))
        places = columns.ravel().take(np.repeat(axis * count, counts) + everyone)
        places -= np.repeat(low[axis, number], counts)
        places *= np.repeat(scale, counts)
        # Each key is one integer of segment, position in it, and index, so that keys are distinct.
        keys = np.repeat(number << PLACE_BITS, counts)
        keys += places.astype(np.int64)
        keys <<= POINT_BITS
        keys += everyone
        keys.sort()
        keys &= 2**POINT_BITS - 1
        order, columns = order[keys], columns.take(keys, axis=1)
        middle = starts + unit * ((units + 1) // 2)
        # All are distinct, and a stable sort of two ascending runs merges them.
        bounds = np.sort(np.concatenate((bounds, middle[units > 1])), kind="stable")


def centered_tiles(points: Float64, tile: int) -> tuple[Float64, Float64]:
    """Return centers of tiles, (tiles, D), rounded to float32, and points less them."""
    low, high = boxes_of_runs(points, np.arange(0, len(points), tile))
    centers = (0.5 * (low + high)).astype(np.float32).astype(float)
    return centers, points.reshape(len(centers), tile, -1) - centers[:, None]


def split(values: Float64) -> NDArray[np.float32]:
    """Return a (2, ...) array of float32: the nearest numbers and their rounding errors."""
    high = values.astype(np.float32)
    return np.stack((high, (values - high).astype(np.float32)))


def pad(values: Float64, length: int, filler: float) -> Float64:
    """Return values padded to `length` by `filler` at their end."""
    more = length - len(values)
    return np.concatenate((values, np.full(more, filler))) if more else values


def unsort(cloud: Cloud, values: NDArray[Any]) -> NDArray[Any]:
    """Return values of sorted points in the caller's order."""
    result = np.empty_like(values)
    result[cloud.order] = values
    return result
