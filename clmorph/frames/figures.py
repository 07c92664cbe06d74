"""Figures before a flat or transparent ground: their outlines, and their colors beyond these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array, BoolArray
from clmorph.frames.ends import End
from clmorph.frames.resampling import Float32
from clmorph.images.color import to_space
from clmorph.images.flat_colors import LEVEL, foreground, shares_in_mixtures
from clmorph.measures.measure import Measure

_Real = TypeVar("_Real", np.float32, np.float64)

#: Share of the pixels without mass that must have one color, so that they are a ground.
FLAT_SHARE = 0.75
#: Distance from the outline in pixels up to which they may mix figure and ground; the share of the
#: figure from which they do not count as mixtures.
EDGE, PURE = 2, 0.95
#: Share of a side within which two figures reach the same place of a border.
SAME_PLACE = 0.05
#: Opacity, beside the largest one near, from which a figure is whole; bounds of that of an edge.
OPAQUE, CLEAR, SOLID = 0.999, 0.05, 0.95


class Figure(NamedTuple):
    """What stands before the ground of a picture."""

    #: Which pixels belong to it alone, (H, W); those of the edge mix it with the ground.
    pure: BoolArray
    #: Signed distance from the outline in pixels, positive inside: (H, W) array.
    distance: Float32
    #: Opacity, continued beyond the outline: (H, W) array.
    alpha: Float32
    #: Width of the outline in pixels.
    softness: float
    #: The color of the ground, sRGB: (3,) array.
    ground: Array
    #: Its opacity: 1, or 0 if it is transparent or there is none.
    ground_alpha: float

    @property
    def area(self) -> float:
        """Share of the canvas inside the outline."""
        return float(np.clip(0.5 + self.distance / self.softness, 0.0, 1.0).mean(dtype=float))

    @property
    def translucent(self) -> bool:
        """Whether the figure is translucent somewhere."""
        return bool(self.alpha.min() < OPAQUE)


def figures_of(measures: Sequence[Measure], ends: Sequence[End]) -> list[Figure] | None:
    """Return the figures of some pictures; None if none has a ground."""
    masks = [_inside(measure, end) for measure, end in zip(measures, ends, strict=True)]
    if all(mask is None or mask.all() for mask in masks) and all(e.alpha is None for e in ends):
        return None
    whole = [
        np.ones(end.shape, bool) if mask is None else mask
        for mask, end in zip(masks, ends, strict=True)
    ]
    return [
        _figure(_within_border(mask, whole[:number] + whole[number + 1 :]), end)
        for number, (mask, end) in enumerate(zip(whole, ends, strict=True))
    ]


def _within_border(mask: BoolArray, others: Sequence[BoolArray]) -> BoolArray:
    """Return a mask with one more pixel on each side: whether the figure goes on beyond the border.

    In a picture that is cut to its figure it ends there; not if all others reach the same place.
    """
    from scipy.ndimage import maximum_filter1d

    around = np.pad(mask, 1)
    for turned in (lambda m: m, np.flipud, np.transpose, np.rot90):
        line = turned(mask)[0].copy()
        for other in others:
            reached = turned(other)[0].astype(np.uint8)
            reached = maximum_filter1d(reached, 2 * round(SAME_PLACE * reached.size) + 1)
            line &= (
                reached[((np.arange(line.size) + 0.5) * reached.size / line.size).astype(int)] > 0
            )
        turned(around)[0, 1:-1] = line
    return around


def _inside(measure: Measure, end: End) -> BoolArray | None:
    """Return which pixels belong to the figure; None if there is no ground."""
    massive = (measure.weights > 0).reshape(measure.shape)
    if measure.shape != end.shape:
        massive = np.ones(end.shape, bool) if massive.all() else foreground(end.colors, end.alpha)
    if end.alpha is not None:
        # A pixel of an edge belongs to the figure if it is mostly opaque.
        solid = massive & foreground(end.colors, end.alpha)
        return solid if solid.any() else massive
    if massive.all():
        return None
    bare = end.colors[~massive]
    flat = np.abs(bare - np.median(bare, axis=0)).max(axis=1) <= LEVEL
    return massive if flat.mean() >= FLAT_SHARE else None


def _figure(around: BoolArray, end: End) -> Figure:
    """Return a figure from a mask with one more pixel on each side."""
    from scipy.ndimage import distance_transform_edt, maximum_filter

    inside = around[1:-1, 1:-1]
    if inside.all():
        far = float(max(inside.shape))
        alpha = _all(1.0, end) if end.alpha is None else end.alpha.astype(np.float32)
        return Figure(inside, _all(far, end), alpha, 1.0, np.zeros(3), 0.0)
    distance: Float32 = distance_transform_edt(around)[1:-1, 1:-1].astype(np.float32)
    distance -= distance_transform_edt(~around)[1:-1, 1:-1].astype(np.float32)
    distance += np.where(inside, np.float32(-0.5), np.float32(0.5))
    pure = inside.copy()
    rim = inside & (distance < EDGE)
    if end.alpha is None:
        ground = np.median(end.colors[~inside], axis=0)
        pure[rim] = shares_in_mixtures(end.colors, ground, rim) >= PURE
        pure = pure if pure.any() else inside
        edge = np.abs(distance) <= 1
        rows, columns = nearest(pure)
        covered = _covered(end.colors[edge], end.colors[rows[edge], columns[edge]], ground)
        mixed = (covered > 0) & (covered < 1)
        distance[edge] = np.where(mixed, covered - 0.5, distance[edge])
        return Figure(pure, distance, _all(1.0, end), 1.0, ground, 1.0)
    pure[rim] = (end.alpha >= OPAQUE * maximum_filter(end.alpha, 2 * EDGE + 1))[rim]
    pure = pure if pure.any() else inside
    opacity = beyond(end.alpha[..., None], pure)[..., 0]
    # Pixels of the edge say where in them the outline runs.
    covered = end.alpha / np.maximum(opacity, CLEAR)
    edge = (covered > CLEAR) & (covered < SOLID) & (np.abs(distance) < 0.1 * max(end.shape))
    outline = (np.abs(distance) <= 0.5).sum()
    softness = float(np.clip(float(edge.sum()) / max(float(outline), 1.0), 1.0, 16.0))
    mixed = (covered > 0) & (covered < 1) & (np.abs(distance) < EDGE + softness)
    distance[mixed] = softness * (covered[mixed] - 0.5)
    return Figure(pure, distance, opacity.astype(np.float32), softness, np.zeros(3), 0.0)


def _all(value: float, end: End) -> Float32:
    """Return a value for each pixel of a picture, as a view of one number."""
    return np.broadcast_to(np.float32(value), end.shape)


def _covered(colors: Array, figure: Array, ground: Array) -> Array:
    """Return the share of the figure in pixels (n, 3) that mix it with the ground; else 0."""
    way, own = figure - ground, colors - ground
    share = (own * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), LEVEL**2)
    lies_between = np.abs(own - share[:, None] * way).max(axis=1) <= LEVEL
    return np.where(lies_between, share, 0.0)


def mixed_ground(
    shares: Sequence[float], grounds: Sequence[tuple[Array, float]], space: str
) -> tuple[Array, float]:
    """Return color, in a space, and opacity of the mean of grounds, sRGB and opacity, by shares."""
    colors, alphas = zip(*grounds, strict=True)
    parts = np.array(shares) * alphas
    alpha = float(parts.sum())
    if alpha == 0:
        return np.zeros(3), 0.0
    return parts @ to_space(np.array(colors), space) / alpha, alpha


def beyond(image: NDArray[_Real], pure: BoolArray) -> NDArray[_Real]:
    """Return an image (H, W, C) whose figure is continued over its edge and over the ground."""
    return image if pure.all() else image[nearest(pure)]


def nearest(
    pure: BoolArray, pitch: Sequence[float] | None = None
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the row and the column of the nearest pixel that belongs to a figure, (H, W) each."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(
        ~pure, sampling=pitch, return_distances=False, return_indices=True
    )
    return rows, columns
