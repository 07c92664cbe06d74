"""How each picture of a morph moves and changes its colors: one field over each picture.

The plan sends the mass of a pixel to many places. Its mean displacement and mean change of color
are averaged over cells, then over neighbors of like color, and enlarged to the grid of the field
along the picture's own colors (Kopf et al., "Joint bilateral upsampling", 2007). So motion is
torn along the edges of the picture and nowhere else, and what has no partner follows its like.

A `Layer` is a picture with the paths along its field. The outline of a figure on its way is a mean
of those of both layers. A line along a layer's own outline would be cut off where the frame's runs
inside of it, and would be as broad as the gap where it runs outside. So near its outline a layer is
displaced by the gap, along its distance's slope (`led_to`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import Operations
from clmorph.backends.records import LIKE, Affine
from clmorph.frames.canvas import Canvas
from clmorph.frames.particles import Particles
from clmorph.frames.resampling import Float32, reduced
from clmorph.measures.measure import Measure

_Real = TypeVar("_Real", np.float32, np.float64)

#: Cells and points of a field along the longer side.
CELLS, POINTS = 64, 256
#: Standard deviations of the mean over cells of like color and of the enlargement, in cells; rounds
#: of that mean; the distance of colors that count as like there.
SIGMA, SIGMA_FINE, ROUNDS = 3.3, 1.2, 3
LIKE_CELLS = 0.26
#: Share of the points' longer side over which displacements are smoothed: paths need a slope.
SOFT = 1 / 144
#: Weight of a cell whose mass has no partner; and the share of such mass that takes the color that
#: the other picture has at its place.
LONELY, RECOLORED = 1e-3, 0.7
#: Least width, as a share of the longer side, of the margin in which a border takes others along;
#: and that width in units of how far the border goes out, if it can be had.
NEAR_BORDER, STRETCHED = 0.1, 2.0
#: Distance of labels in a guide: no mean crosses their borders.
LABEL_STEP = 3.0
#: Shares of the stage's longer side: the depth below an outline to which it takes its layer along,
#: beside 1.5 gaps, and the gap that is too far to be closed.
DEPTH, FAR = 0.024, 0.06
GAPS = 1.5
#: Points of the stage by which outlines that meet differ.
CLOSE = 1.5
#: Least squared slope of a distance by which a gap is divided; its ridges have none.
LEAST_SLOPE = 0.25


class Field(NamedTuple):
    """The motion of a picture."""

    #: (h, w, 2) Displacement (x, y) to the other end, in units of the common frame.
    move: Array
    #: Change of color, in the space of the path: (h, w, 3) array.
    change: Array
    #: What the picture shows: (h, w, 3) array.
    guide: Array
    #: One pixel for each point, over the picture's extent.
    canvas: Canvas

    def steps(self) -> NDArray[np.float32]:
        """Return the displacement in points of the field: (h, w, 2) array (row, column)."""
        return (self.move[..., ::-1] * self.canvas.scale[::-1]).astype(np.float32)


def affine(here: Canvas, there: Canvas) -> Affine:
    """Return where the pixels of one canvas stand on another one of the same common frame."""
    step = [to / max(own, 1e-9) for to, own in zip(there.scale, here.scale, strict=True)]
    origin = [
        center - ratio * own
        for center, ratio, own in zip(there.center, step, here.center, strict=True)
    ]
    return Affine((origin[1], origin[0]), (step[1], step[0]))


def _cells(particles: Particles, end: int, n: int, grid: Canvas) -> tuple[Array, Array, Array]:
    """Add up the particles that start (end 0) or end (end 1) at pixels; n are the source's.

    The result is, over the cells of the picture, the mean displacement and change of color,
    (h, w, 5), the mass with a partner, and all mass, (h, w) each.
    """
    known = len(particles.table) - particles.n_grown
    links = particles.links.astype(np.int64)
    own, other = links[:, end], links[:, 1 - end]
    if end == 0:
        mine, paired = own < n, (own < n) & (other >= n)
    else:
        mine = (own >= n) & (own < known)
        paired = mine & ((other < n) | (other >= known))
    mass = particles.weights[:, end] * mine
    table = particles.table
    row, column = (
        np.clip(np.rint(place).astype(np.int64), 0, side - 1)
        for place, side in zip(grid.places(table[:, :2]), grid.shape, strict=True)
    )
    cell = (row * grid.shape[1] + column)[own]

    def total(values: Array) -> Array:
        sums = np.bincount(cell, values, grid.shape[0] * grid.shape[1])
        return np.asarray(sums, dtype=np.float64).reshape(grid.shape)

    partners = mass * paired
    matched = total(partners)
    # Columns one by one: gathers from whole rows of the table take several times as long.
    columns = np.ascontiguousarray(table[:, :5].T)
    sums = np.stack(
        [total(partners * (column[other] - column[own])) for column in columns], axis=-1
    )
    tiny = np.finfo(np.float64).tiny
    return sums / np.maximum(matched, tiny)[..., None], matched, total(mass)


def field_of(
    particles: Particles,
    end: int,
    measures: tuple[Measure, Measure],
    picture: Float32,
    other: Float32,
    canvases: Sequence[Canvas],
    operations: Operations,
    *,
    figure: bool,
) -> Field:
    """Return the field of one picture: the source's with `end` 0, the target's with 1.

    `picture` and `other`, (H, W, 3), are this one and the other one in the space of the path. No
    mean crosses the borders of this one's labels. With `figure` only pixels with mass count, and
    the rest moves as the nearest of them.
    """
    canvas = canvases[end]
    grid, points = canvas.reduced(CELLS), canvas.reduced(POINTS)
    values, matched, mass = _cells(particles, end, len(measures[0]), grid)
    tiny = np.finfo(np.float64).tiny
    share = matched / np.maximum(mass, tiny)
    small = reduced(picture, points.shape)
    guide, fine = reduced(small, grid.shape).astype(float), small.astype(float)
    if figure:
        weights = matched / max(float(matched.max()), tiny)
    else:
        there = canvases[1 - end].reduced(CELLS)
        others = sampled(reduced(other, there.shape), there.places(grid.positions()))
        lonely = 1.0 - np.minimum(share, 1.0)[..., None]
        values[..., 2:] *= 1.0 - lonely
        values[..., 2:] += RECOLORED * lonely * (others - guide)
        weights = np.minimum(share, 1.0) ** 2 + LONELY
    if particles.labels is not None:
        labels = particles.labels[end].reshape(measures[end].shape)
        guide, fine = (
            np.dstack((colored, LABEL_STEP * _nearest(labels, colored.shape[:2])))
            for colored in (guide, fine)
        )
    own, finer = guide.astype(np.float32), fine.astype(np.float32)
    known = np.maximum(weights, 1e-9).astype(np.float32)
    for _ in range(ROUNDS):
        values = operations.edge_preserving_mean(
            values.astype(np.float32), known, own, own, SIGMA, LIKE_CELLS
        )
    if figure:
        values = _spread(values, weights)
    values = operations.edge_preserving_mean(
        values.astype(np.float32), np.ones(grid.shape, np.float32), own, finer,
        SIGMA_FINE, LIKE,
    )  # fmt: skip
    soft = (2.0 if figure else 1.0) * SOFT * max(points.shape)
    move = blurred(values[..., :2], soft)
    if not figure:
        move = _kept_at_border(move, points, canvases[1 - end])
    return Field(move, values[..., 2:5], fine[..., :3], points)


def _kept_at_border(move: Array, points: Canvas, other: Canvas) -> Array:
    """Return displacements, (h, w, 2), by which borders go out at least as far as the other's.

    One that fell behind would leave places of the frame at which nothing is to be shown.
    """
    kept = move.copy()
    for axis in (0, 1):
        side, scale = points.shape[1 - axis], max(points.scale[axis], 1e-9)
        extents = side / scale, other.shape[1 - axis] / max(other.scale[axis], 1e-9)
        allowed = 0.5 * (extents[0] - extents[1])
        reach = min(max(NEAR_BORDER * max(points.shape), -STRETCHED * allowed * scale), 0.5 * side)
        near = np.arange(side) / max(reach, 1.0)
        for sign, distance in ((1.0, near), (-1.0, near[::-1])):
            shape = (1, side) if axis == 0 else (side, 1)
            rest = np.clip(1.0 - distance, 0.0, 1.0).reshape(shape)
            kept[..., axis] -= sign * rest * np.maximum(sign * kept[..., axis] - allowed, 0.0)
    return kept


def _nearest(labels: IntArray, shape: tuple[int, ...]) -> Array:
    """Return the labels at the pixels of a smaller canvas: (h, w) array."""
    rows, columns = (
        np.clip(((np.arange(few) + 0.5) * many / few).astype(int), 0, many - 1)
        for many, few in zip(labels.shape, shape, strict=True)
    )
    return labels[np.ix_(rows, columns)].astype(float)


def _spread(values: Array, weights: Array) -> Array:
    """Give cells without mass the values of the nearest cells with mass, smoothly."""
    from scipy.ndimage import gaussian_filter

    known = np.clip(20 * weights / weights.max(), 0.0, 1.0)
    found, width = values, 1.0
    filled = known
    while width < max(weights.shape):
        total = gaussian_filter(filled, width, mode="constant")
        means = gaussian_filter(found * filled[..., None], (width, width, 0), mode="constant")
        means /= np.maximum(total, 1e-9)[..., None]
        reached = np.clip(total / 0.02, 0.0, 1.0) * (1 - filled)
        found = found + reached[..., None] * (means - found)
        filled = filled + reached
        width *= 2
    return known[..., None] * values + (1 - known[..., None]) * found


def sampled(image: NDArray[np.floating], places: Array) -> Array:
    """Interpolate an image (H, W, C) linearly at pixels (2, ...), constant outside: (..., C)."""
    height, width, channels = image.shape
    flat = image.reshape(-1, channels)
    sides: list[tuple[IntArray, IntArray, Array]] = []
    for place, side in zip(places, (height, width), strict=True):
        inside = np.clip(place, 0, side - 1)
        low = np.minimum(inside.astype(np.int64), max(side - 2, 0))
        sides.append((low, np.minimum(low + 1, side - 1), (inside - low)[..., None]))
    (above, below, down), (left, right, along) = sides
    lines = [
        flat.take(row * width + left, axis=0) * (1 - along)
        + flat.take(row * width + right, axis=0) * along
        for row in (above, below)
    ]
    return np.asarray(lines[0] * (1 - down) + lines[1] * down)


def blurred(image: NDArray[_Real], width: float) -> NDArray[_Real]:
    """Return an image (H, W) or (H, W, C) under a Gaussian of some pixels."""
    from scipy.ndimage import gaussian_filter

    widths = (width, width, 0.0)[: image.ndim]
    return np.asarray(gaussian_filter(image, widths, mode="nearest"), dtype=image.dtype)


def slopes(image: NDArray[_Real]) -> list[NDArray[_Real]]:
    """Return the slopes of an image (H, W) in both directions; 0 along a side of one pixel."""
    return [
        np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image)
        for axis in (0, 1)
    ]


class Layer(NamedTuple):
    """What moves one picture; the handle is that of `Operations.upload_layer`."""

    field: Field
    paths: Float32  # (steps + 1, h, w, 2), see `Operations.follow_paths`
    handle: Any

    def moved(self, way: float) -> Array:
        """Return how far each point of the stage is displaced on the field: (h, w, 2) array."""
        last = len(self.paths) - 1
        step = min(int(way * last), last - 1)
        first, second = self.paths[step : step + 2].astype(np.float64)
        return np.asarray(first + (way * last - step) * (second - first))


def layer_of(field: Field, paths: Float32, operations: Operations) -> Layer:
    """Upload a layer."""
    change = np.zeros((*field.canvas.shape, 8), np.float32)
    change[..., :3], change[..., 4:7] = field.change, field.guide
    return Layer(field, paths, operations.upload_layer(paths, change))


def led_to(
    layer: Layer, distance: Array, outline: Array, way: float, stage: Canvas, operations: Operations
) -> Layer:
    """Return a layer whose outline is led to another one, at one share of its way.

    `distance` and `outline`, (h, w), are the signed distances from both in points of the stage.
    """
    longest = max(stage.shape)
    gap = blurred(outline - distance, 1.0)
    slope = np.stack(slopes(blurred(distance, 1.0)), axis=-1)
    steep = np.maximum((slope**2).sum(axis=-1), LEAST_SLOPE)
    near = np.exp(-((outline / (DEPTH * longest + GAPS * np.abs(gap))) ** 2))
    # Outlines that meet stay where they are.
    near *= np.exp(-((gap / (FAR * longest)) ** 2)) * (1.0 - np.exp(-((gap / CLOSE) ** 2)))
    shift = blurred(slope * (near * gap / steep)[..., None], 1.0)
    places = np.indices(stage.shape) + np.moveaxis(shift, -1, 0)
    moved = sampled(layer.moved(way), places)
    moved += shift * affine(stage, layer.field.canvas).step
    # Both steps are this one, so that it is drawn at any share of the way.
    return layer_of(layer.field, np.stack([moved, moved]).astype(np.float32), operations)
