"""Frames of moving cells: each pixel belongs to the cell whose seed is nearest to it.

Seeds move in straight lines. A cell shows its part of a picture, which moves with it as a whole, so
a frame has neither holes nor blends: first what is around the cell's start in picture A, and from
the cell's switching time on what is around its end in picture B. `cells_of_plan` pairs the blocks
of two pictures one to one.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.fields import sampled
from clmorph.measures.measure import Measure
from clmorph.transport.assignment import assign
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

Owners = NDArray[np.int32]

_Number = TypeVar("_Number", np.intp, np.float64)

#: Share of the film within which a cell changes from the one picture to the other.
DURATION = 0.1
#: Pixels that are drawn at once.
PIXELS = 1 << 18
#: The search for pairs of blocks ends when rounds lower the cost by a smaller share.
LEAST_GAIN = 1e-3
#: The first and the last switching time of the cells of a plan.
SWITCHING = 0.25, 0.75


class CellPaths(NamedTuple):
    """Where cells go."""

    #: Positions (x, y) of the seeds at t = 0 and at t = 1, in the common frame: (K, 2) arrays.
    starts: Array
    ends: Array
    #: The time, from 0 to 1, at which each cell changes from picture A to picture B: (K,) array.
    switching: Array


class Cells:
    """Moving cells between two pictures, (H, W, 3) or with opacity 4, in the space of the path."""

    def __init__(
        self,
        paths: CellPaths,
        pictures: Sequence[Array],
        canvases: Sequence[Canvas],
        operations: Operations,
    ) -> None:
        self.paths, self._operations, self._canvases = paths, operations, list(canvases)
        #: Whether frames have opacity.
        self.clear = any(picture.shape[2] == 4 for picture in pictures)
        self._pictures = [
            np.dstack((picture, np.ones(picture.shape[:2])))
            if self.clear and picture.shape[2] == 3
            else picture
            for picture in pictures
        ]

    def on(self, operations: Operations) -> Cells:
        """Return the same cells for another device."""
        other = copy(self)
        other._operations = operations
        return other

    def frame(self, t: float, canvas: Canvas) -> Array:
        """Return the frame at time t: (H, W, 3) array or, with opacity, (H, W, 4)."""
        if t in (0.0, 1.0) and canvas == self._canvases[int(t)]:
            return self._pictures[int(t)].copy()
        begins = np.clip(self.paths.switching, DURATION / 2, 1 - DURATION / 2) - DURATION / 2
        later = np.clip((t - begins) / DURATION, 0.0, 1.0)
        owners = self.owners(t, canvas)
        rows = max(1, PIXELS // canvas.shape[1])
        strips = [
            self._strip(t, canvas, first, owners[first : first + rows].ravel(), later)
            for first in range(0, len(owners), rows)
        ]
        found = np.concatenate(strips)
        if self.clear:
            found[:, :3] /= np.maximum(found[:, 3:], np.finfo(float).tiny)
        return found.reshape(*canvas.shape, -1)

    def _strip(self, t: float, canvas: Canvas, first: int, owners: Owners, later: Array) -> Array:
        """Return the pixels of rows from `first` on, colors multiplied by opacity: (N, C) array.

        `owners`, (N,), are their cells, and `later`, (K,), is the share of picture B in each cell.
        """
        stop = first + len(owners) // canvas.shape[1]
        positions = canvas.positions(first, stop).reshape(-1, 2)
        moves = self.paths.ends - self.paths.starts
        found = np.zeros((len(owners), self._pictures[0].shape[2]))
        for picture, there, way, shares in zip(
            self._weighed, self._canvases, (-t, 1 - t), (1 - later, later), strict=True
        ):
            share = shares[owners]
            seen = np.flatnonzero(share)
            places = there.places(positions[seen] + way * moves[owners[seen]])
            found[seen] += share[seen, None] * sampled(picture, mirrored(places, there.shape))
        return found

    def owners(self, t: float, canvas: Canvas) -> Owners:
        """Return the cell of each pixel at time t: (H, W) array."""
        return owners_at(self.paths.starts, self.paths.ends, t, canvas, self._operations)

    @cached_property
    def _weighed(self) -> list[Array]:
        """The pictures, with colors multiplied by opacity."""
        if not self.clear:
            return self._pictures
        return [np.dstack((each[..., :3] * each[..., 3:], each[..., 3])) for each in self._pictures]


def owners_at(
    starts: Array, ends: Array, t: float, canvas: Canvas, operations: Operations
) -> Owners:
    """Return the seed, of those from `starts` to `ends`, (K, 2), that is nearest to each pixel."""
    rows, columns = canvas.places((1 - t) * starts + t * ends)
    return operations.nearest_seeds(
        np.column_stack((columns, rows)).astype(np.float32), canvas.shape
    )


def mirrored(places: NDArray[_Number], shape: tuple[int, int]) -> NDArray[_Number]:
    """Return places (2, ...) mirrored into a picture about the centers of its outermost pixels."""
    found = places.copy()
    for own, side in zip(found, shape, strict=True):
        outside = (own < 0) | (own > side - 1)
        period = max(2 * side - 2, 1)
        once = np.abs(own[outside]) % period
        own[outside] = np.minimum(once, period - once)
    return found


def cells_of_plan(
    source: Measure, target: Measure, plan: Plan | Barycentric, side: int, *, seed: int = 0
) -> CellPaths:
    """Pair the blocks of two pictures one to one, in position and color.

    Both pictures are cut into about the same number of blocks, which are about square, about `side`
    of them along the longer side. Of the picture that has fewer, some are paired twice: one of
    these two blocks shrinks to nothing. Pairs whose colors are alike switch first. The mean
    destinations of the plan begin the search.
    """
    grids = block_grids((source.shape, target.shape), side)
    clear = source.alpha is not None or target.alpha is not None
    compared = _compared((source, target))
    blocks = [
        _Blocks(measure, points, grid, clear)
        for measure, points, grid in zip((source, target), compared, grids, strict=True)
    ]
    count = max(len(each.centers) for each in blocks)
    # Blocks of the picture that has fewer are taken twice at even steps.
    taken = [np.arange(count) * len(each.centers) // count for each in blocks]
    points = [each.points[own] for each, own in zip(blocks, taken, strict=True)]
    destinations = None
    if isinstance(plan, Plan):
        destinations = blocks[0].mean(plan.mean_destinations(*compared)[0])
        if clear:
            destinations = np.column_stack((destinations, blocks[0].points[:, -1]))
        destinations = destinations[taken[0]]
    pairs = assign(*points, destinations=destinations, least_gain=LEAST_GAIN, seed=seed)
    unlike = np.square(points[0][:, 2:] - points[1][pairs, 2:]).sum(axis=1)
    ranks = np.empty(count)
    ranks[np.argsort(unlike, kind="stable")] = (np.arange(count) + 0.5) / count
    starts, ends = (each.centers[own] for each, own in zip(blocks, taken, strict=True))
    return CellPaths(starts, ends[pairs], SWITCHING[0] + (SWITCHING[1] - SWITCHING[0]) * ranks)


def block_grids(shapes: Sequence[tuple[int, int]], side: int) -> list[tuple[int, int]]:
    """Return rows and columns of about square blocks, about as many in each picture."""
    counts = [side**2 * min(shape) / max(shape) for shape in shapes]
    count = float(np.exp(np.mean(np.log(counts))))
    grids = []
    for height, width in shapes:
        rows = int(np.clip(round(np.sqrt(count * height / width)), 1, height))
        grids.append((rows, int(np.clip(round(count / rows), 1, width))))
    return grids


def _compared(measures: tuple[Measure, Measure]) -> tuple[Array, Array]:
    """Return points of the pixels, without a map of color metrics: their first axes are places."""
    plain = any(measure.has_metric_map for measure in measures)
    first, second = (
        np.column_stack((each.positions, each.color_weight * each.coordinates))
        if plain
        else each.points
        for each in measures
    )
    return first, second


class _Blocks:
    """The blocks of one picture.

    `points`, (N, D), is what is compared of its pixels, the position first; `clear` tells whether
    opacity is compared.
    """

    def __init__(self, measure: Measure, points: Array, grid: tuple[int, int], clear: bool) -> None:
        rows, columns = (
            np.arange(pixels) * parts // pixels
            for pixels, parts in zip(measure.shape, grid, strict=True)
        )
        self._owners = (rows[:, None] * grid[1] + columns).ravel()
        self._sizes = np.bincount(self._owners)
        opacity = np.ones(len(measure)) if measure.alpha is None else measure.alpha
        #: (K, 2) centers in the common frame.
        self.centers = self.mean(measure.positions)
        #: (K, D) what is compared; colors are multiplied by opacity, which follows.
        self.points = self.mean(points)
        if clear:
            weight = measure.color_weight
            shown = self.mean(points[:, 2:] * opacity[:, None])
            self.points = np.column_stack(
                (self.points[:, :2], shown, weight * self.mean(opacity[:, None]))
            )

    def mean(self, values: Array) -> Array:
        """Return the mean over each block of values of the pixels, (N, D): (K, D) array."""
        sums = [np.bincount(self._owners, axis) for axis in values.T]
        return np.column_stack(sums) / self._sizes[:, None]
