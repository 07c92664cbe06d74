"""Fields of a morph's layers, paths along them, and layers drawn along paths, in NumPy."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.enlarging import enlarged
from clmorph.backends.records import LIKE, TEAR, Affine, Float32, Float64, LayerView


def edge_preserving_mean(
    values: Float32,
    weights: Float32,
    guide: Float32,
    fine_guide: Float32,
    sigma: float,
    tolerance: float,
) -> Float64:
    """Average values over like neighbors; see `clmorph.backends.interface.Operations`."""
    (height, width), shape = weights.shape, fine_guide.shape[:2]
    around = [nearest_cells(*axis) for axis in zip((height, width), shape, strict=True)]
    places, centers = zip(*around, strict=True)
    radius = mean_radius(sigma)
    sums, total = np.zeros((*shape, values.shape[2])), np.zeros((*shape, 1))
    for down in range(-radius, radius + 1):
        for along in range(-radius, radius + 1):
            i, j = centers[0] + down, centers[1] + along
            rows, columns = (
                np.flatnonzero((index >= 0) & (index < side))
                for index, side in ((i, height), (j, width))
            )
            if not len(rows) or not len(columns):
                continue
            here, there = np.ix_(rows, columns), np.ix_(i[rows], j[columns])
            far = (i - places[0])[rows, None] ** 2 + (j - places[1])[None, columns] ** 2
            unlike = ((fine_guide[here].astype(float) - guide[there]) ** 2).sum(axis=2)
            like = np.exp(-0.5 * unlike / tolerance**2) + LEAST_LIKENESS
            weight = (np.exp(-0.5 * far / sigma**2) * like * weights[there])[..., None]
            sums[here] += weight * values[there]
            total[here] += weight
    return sums / np.maximum(total, LEAST_WEIGHT)


#: What unlike neighbors count at least, so that a mean exists where all are unlike; the sum of
#: weights below which there is none.
LEAST_LIKENESS, LEAST_WEIGHT = 1e-9, 1e-30


def mean_radius(sigma: float) -> int:
    """Return the distance in cells up to which neighbors are averaged."""
    return int(np.ceil(2.0 * sigma))


def nearest_cells(few: int, many: int) -> tuple[Float64, NDArray[np.int64]]:
    """Return where many points stand among few cells over the same extent, and the nearest cell."""
    places = (np.arange(many, dtype=float) + 0.5) * (few / many) - 0.5
    centers: NDArray[np.int64] = np.floor(places + 0.5).astype(np.int64)
    return places, centers


def follow_paths(
    field: Float32, to_field: Affine, shape: tuple[int, int], steps: int, rounds: int
) -> Float32:
    """Follow places backwards along a field; see `clmorph.backends.interface.Operations`."""
    start = to_field.places(shape)
    place = start
    steeper = with_steepness(field)
    found = np.zeros((steps + 1, *shape, 2), np.float32)
    for step in range(1, steps + 1):
        for _ in range(rounds):
            move, steep = np.split(step / steps * linear(steeper, place), (2,), axis=-1)
            place = place - (place - start + move) / (1.0 + steep)
        found[step] = place - start
    return found


def with_steepness(field: Float32) -> Float32:
    """Return a field (h, w, 2) and a bound of its slope's norm, also in between: (h, w, 3)."""
    steep = np.zeros(field.shape[:2])
    for axis in (0, 1):
        apart = np.linalg.norm(np.diff(field.astype(float), axis=axis), axis=2)
        for before, after in ((1, 0), (0, 1)):
            pad = [(0, 0), (0, 0)]
            pad[axis] = (before, after)
            steep = np.maximum(steep, np.pad(apart, pad))
    return np.dstack((field, np.sqrt(2.0) * steep)).astype(np.float32)


def linear(image: Float32, places: Float64) -> Float64:
    """Interpolate an image (H, W, C) linearly at places (..., 2), constant beyond its border."""
    from scipy.ndimage import map_coordinates

    at = np.moveaxis(places, -1, 0)
    return np.stack(
        [
            map_coordinates(image[..., channel].astype(float), at, order=1, mode="nearest")
            for channel in range(image.shape[2])
        ],
        axis=-1,
    )


def draw_layers(
    views: Sequence[LayerView], low: Float32, shape: tuple[int, int], rows: slice | None = None
) -> Float32:
    """Draw two layers over one another; see `clmorph.backends.interface.Operations`."""
    first, stop = (0, shape[0]) if rows is None else (rows.start, rows.stop)
    # Beside a tear a pixel needs its neighbors.
    wider = slice(max(first - 1, 0), min(stop + 1, shape[0]))
    found = enlarged(low.astype(float), shape, wider.start, wider.stop)
    for view in views:
        both = np.stack((view.weights, view.shares), axis=-1)
        weights = linear(both, view.to_paths.places(shape)[wider])
        found += weights[..., [0, 0, 0, 1]] * _drawn(view, shape, wider)
    return found[first - wider.start : stop - wider.start].astype(np.float32)


def _drawn(view: LayerView, shape: tuple[int, int], rows: slice) -> Float64:
    """Return some rows of one layer: (H, W, 4) array."""
    from scipy.ndimage import map_coordinates

    paths, change = view.layer
    steps = len(paths) - 1
    step = min(int(view.way * steps), steps - 1)
    between = view.way * steps - step
    moved = paths[step] + between * (paths[step + 1].astype(float) - paths[step])
    place = view.to_field.places(shape)[rows]
    place = place + linear(moved, view.to_paths.places(shape)[rows])
    at = np.asarray(view.to_picture.origin) + np.asarray(view.to_picture.step) * place
    picture = view.picture
    within = np.moveaxis(np.clip(at, 0, np.array(picture.shape[:2]) - 1), -1, 0)
    colors = np.stack(
        [
            map_coordinates(
                picture[..., channel], within, order=3, mode="mirror", prefilter=False, output=float
            )
            for channel in range(4)
        ],
        axis=-1,
    )  # fmt: skip
    colors += view.way * _alike(change, place, colors)
    torn = _torn(at, view)[..., None]
    if torn.any():
        colors += torn * (_mean_of_nine(colors) - colors)
    return colors


def _alike(change: Float32, places: Float64, colors: Float64) -> Float64:
    """Interpolate the change of color (h, w, 8) between points whose guide is like a color."""
    sides = change.shape[:2]
    low = np.floor(places)
    found, total = np.zeros_like(colors), np.zeros((*colors.shape[:2], 1))
    for row, column in np.ndindex(2, 2):
        at = low + np.array([row, column])
        near = np.prod(1.0 - np.abs(places - at), axis=-1, keepdims=True)
        i, j = (np.clip(at[..., k], 0, side - 1).astype(int) for k, side in enumerate(sides))
        point = change[i, j].astype(float)
        unlike = ((point[..., 4:7] - colors[..., :3]) ** 2).sum(axis=-1, keepdims=True)
        weight = near / (1.0 + unlike / LIKE**2)
        total += weight
        found += weight * point[..., :4]
    return found / total


def _torn(at: Float64, view: LayerView) -> Float64:
    """Return from 0 to 1 how far apart a pixel and its neighbors are in the picture: (H, W)."""
    unit = max(abs(a * b) for a, b in zip(view.to_field.step, view.to_picture.step, strict=True))
    farthest = np.zeros(at.shape[:2])
    for axis in (0, 1):
        apart = np.linalg.norm(np.diff(at, axis=axis), axis=2)
        first, last = (np.s_[:-1], np.s_[1:])
        for part in (first, last):
            place = (part, np.s_[:]) if axis == 0 else (np.s_[:], part)
            farthest[place] = np.maximum(farthest[place], apart)
    return np.clip(farthest / max(unit, 1e-6) / TEAR - 1.0, 0.0, 1.0)


def _mean_of_nine(colors: Float64) -> Float64:
    """Return the binomial mean of each pixel and its eight neighbors, which a border repeats."""
    for axis in (0, 1):
        side = colors.shape[axis]
        before, after = (
            np.maximum(np.arange(side) - 1, 0),
            np.minimum(np.arange(side) + 1, side - 1),
        )
        colors = 0.5 * colors + 0.25 * (colors.take(before, axis) + colors.take(after, axis))
    return colors
