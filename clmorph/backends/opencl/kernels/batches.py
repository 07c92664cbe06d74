"""The clouds of many problems in one sorted cloud, in which each of them begins a tile."""

import weakref
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.boxes import boxes_of_runs
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.kernels.clouds import Cloud, tile_order, upload
from clmorph.backends.opencl.kernels.row_loop import RowLoop
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs, center_costs
from clmorph.backends.records import Float64


class Batch(NamedTuple):
    """The clouds of many problems on the device."""

    #: All points, with the last tile of each problem padded to a whole one: `order` repeats the
    #: problem's last point there, and it has no mass.
    cloud: Cloud
    #: Number of points of each problem: (B,) array.
    counts: NDArray[np.int64]
    #: Number of tiles of each problem: (B,) array.
    tiles: NDArray[np.int64]
    #: Smallest and largest coordinates of each problem: (B, 2, D) array.
    boxes: Float64
    #: The lists of tiles for the columns with which these rows have been summed.
    paired: dict[int, tuple[weakref.ref[Cloud], TilePairs]]

    @property
    def first_tiles(self) -> NDArray[np.int64]:
        """(B,) the first tile of each problem."""
        return np.cumsum(self.tiles) - self.tiles

    def in_order(self, values: Float64) -> Float64:
        """Return values of the sorted and padded points in the caller's order."""
        result = np.empty(int(self.counts.sum()))
        result[self.cloud.order] = values
        return result


def runs(firsts: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the concatenation of runs of consecutive numbers."""
    ends = np.cumsum(lengths)
    total = int(ends[-1]) if len(ends) else 0
    return np.arange(total) + np.repeat(firsts - (ends - lengths), lengths)


def as_batch(cloud: Cloud | Batch) -> Batch:
    """Return a cloud as a batch of one."""
    if isinstance(cloud, Batch):
        return cloud
    counts, tiles = np.array([len(cloud)]), np.array([len(cloud.centers)])
    return Batch(cloud, counts, tiles, cloud.box[None], {})


class BatchStore:
    """Uploads the clouds of many problems."""

    def __init__(self, loop: RowLoop) -> None:
        self._loop = loop

    def upload_batch(
        self,
        points: Float64,
        weights: Float64,
        counts: NDArray[np.int64],
        offsets: Float64 | None = None,
    ) -> Batch:
        """Upload the clouds of many problems."""
        size = self._loop.constants.tile
        points, counts = np.asarray(points, float), np.asarray(counts, np.int64)
        starts = np.cumsum(counts) - counts
        boxes = np.swapaxes(boxes_of_runs(points, starts), 0, 1)
        tiles = -(-counts // size)
        # Places in the sorted list, with the last place of a problem repeated up to a whole tile.
        within = runs(np.zeros_like(tiles), tiles * size)
        last = np.repeat(counts - 1, tiles * size)
        # The order of `CloudStore.upload`, so that a problem alone has the same bits.
        order = tile_order(points, size, counts, self._loop.constants.group_rows)
        order = order[np.repeat(starts, tiles * size) + np.minimum(within, last)]
        cloud = upload(self._loop.work, size, order, points, weights, offsets, keep=True)
        masses = np.where(within > last, SENTINEL, cloud.log2_weights)
        cloud = replace(cloud, log2_weights=masses)
        return Batch(cloud, counts, tiles, boxes, {})

    def take_batch(self, batch: Batch, problems: NDArray[np.int64]) -> Batch:
        """Return a batch of some clouds of a batch."""
        cloud, size = batch.cloud, self._loop.constants.tile
        tiles = runs(batch.first_tiles[problems], batch.tiles[problems])
        places = (tiles[:, None] * size + np.arange(size)).ravel()
        counts = batch.counts[problems]
        before, after = np.cumsum(batch.counts) - batch.counts, np.cumsum(counts) - counts
        moved = np.repeat(after - before[problems], batch.tiles[problems] * size)
        assert cloud.planes is not None
        planes, boxes = cloud.planes[:, :, places], batch.boxes[problems]
        centers, work = cloud.centers[tiles], self._loop.work
        taken = replace(
            cloud, order=cloud.order[places] + moved, centers=centers,
            log2_weights=cloud.log2_weights[places], offsets=cloud.offsets[places],
            own_costs=cloud.own_costs[places], stride=len(places), shifts=cloud.shifts[tiles],
            shifts_buffer=work.buffer(planes), centers_buffer=work.buffer(centers),
            box=np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0))), planes=planes,
        )  # fmt: skip
        return Batch(taken, counts, batch.tiles[problems], boxes, {})


def pairs_of(rows: Batch, columns: Batch) -> TilePairs:
    """Return the column tiles of every row tile: those of its own problem."""
    known = rows.paired.get(id(columns.cloud))
    if known is not None and known[0]() is columns.cloud:
        return known[1]
    per_row = np.repeat(columns.tiles, rows.tiles)
    tiles = runs(np.repeat(columns.first_tiles, rows.tiles), per_row)
    row_of = np.repeat(np.arange(len(per_row)), per_row)
    distances = center_costs(rows.cloud.centers[row_of], columns.cloud.centers[tiles])
    pairs = TilePairs(np.append(0, np.cumsum(per_row)), tiles.astype(np.uint32), distances)
    # Another cloud can have the address of one that is gone, hence the reference.
    rows.paired[id(columns.cloud)] = weakref.ref(columns.cloud), pairs
    return pairs
