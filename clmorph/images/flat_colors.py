"""Flat regions of a picture: its background, what stands before it, and regions of one color."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array, BoolArray, IntArray
from clmorph.images.detail import has_few_colors

#: Least share of the border's pixels that have the background's color.
BORDER_SHARE = 0.5
#: Largest difference of a channel between pixels of the background.
LEVEL, SPRITE_LEVEL = 0.03, 0.01
#: Pixels along a side of the window that tells edges, which mix two colors, from thin strokes.
WINDOW = 5
#: Least share of pixels inside regions; if there are fewer, pixels of edges count as regions too.
INSIDE = 0.2
#: Colors of a palette that are nearer than this, in every channel, are taken as one.
ALIKE = 0.1
#: Rounds by which the colors of a palette are improved (k-means).
ROUNDS = 3


def background_color(colors: Array) -> Array | None:
    """Return the color of a flat background: (3,) array, or None if there is none.

    Parameters
    ----------
    colors : (H, W, 3) array
        The background's color is that of at least half of the pixels along the border.
    """
    border = np.concatenate((colors[0], colors[-1], colors[1:-1, 0], colors[1:-1, -1]))
    color = np.median(border, axis=0)
    share = np.mean(np.abs(border - color).max(axis=1) <= LEVEL)
    return color if share >= BORDER_SHARE else None


def foreground(colors: Array, alpha: Array | None = None) -> BoolArray:
    """Return which pixels stand before a transparent or flat background: (H, W) array of bool.

    All pixels of the background's color belong to it, those inside a ring too. A pixel of an edge
    belongs to the side to which its color or its opacity is nearer; pixel art has no such edges.
    If there is no background, or nothing before it, all pixels belong to the foreground.

    Parameters
    ----------
    colors : (H, W, 3) array
    alpha : (H, W) array, optional
        Opacity. If it is given, the background is what is transparent.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.ones((5, 6, 3))
    >>> picture[1:4, 2:4] = (0.8, 0.1, 0.1)
    >>> foreground(picture).sum()
    np.int64(6)
    """
    from scipy.ndimage import maximum_filter

    if alpha is not None:
        contrast = alpha
    else:
        color = background_color(colors)
        if color is None:
            return np.ones(colors.shape[:2], dtype=bool)
        contrast = np.abs(colors - color).max(axis=2)
    if has_few_colors(colors if alpha is None else np.dstack((colors, alpha))):
        found = contrast > SPRITE_LEVEL
    else:
        found = (contrast > LEVEL) & (contrast >= 0.5 * maximum_filter(contrast, WINDOW))
    return found if found.any() else np.ones(found.shape, dtype=bool)


class Regions(NamedTuple):
    """Regions of a picture whose pixels have nearly one color.

    Attributes
    ----------
    labels : (H, W) array of int
        The number of each pixel's region, from 0.
    colors : (H, W, 3) array
        The picture without mixed colors: those of edges are replaced by the region's own.
    alpha : (H, W) array
        Opacity, likewise.
    """

    labels: IntArray
    colors: Array
    alpha: Array


def flat_regions(
    colors: Array, alpha: Array, within: BoolArray, n_colors: int, *, edges: bool
) -> Regions:
    """Divide a picture into regions of nearly one color.

    Parameters
    ----------
    colors : (H, W, 3) array
    alpha : (H, W) array
    within : (H, W) array of bool
        The pixels that are divided; at least one.
    n_colors : int
        Largest number of regions.
    edges : bool
        Whether edges mix the colors of both sides, as in drawings; pixel art has none.
    """
    from scipy.ndimage import distance_transform_edt

    inside = within
    if edges:
        flat = within & _is_inside(np.dstack((colors, alpha)))
        if flat.sum() >= INSIDE * within.sum():
            inside = flat
    labels = np.zeros(inside.shape, dtype=np.int64)
    labels[inside] = palette(colors[inside], n_colors)[0]
    nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    rows, columns = nearest
    place = rows, columns
    return Regions(labels[place], colors[place], alpha[place])


def palette(colors: Array, n_colors: int) -> tuple[IntArray, Array]:
    """Return the nearest of a few colors for each color, by maximum coverage and k-means.

    Parameters
    ----------
    colors : (N, 3) array
    n_colors : int

    Returns
    -------
    (N,) array of int
        The number of the nearest one, from 0 without gaps; colors that are `ALIKE` share one.
    (N, 3) array
        The color that stands for each, before alike ones are joined.
    """
    from PIL import Image

    levels = np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8)
    row = Image.fromarray(levels[None])
    found = row.quantize(n_colors, method=Image.Quantize.MAXCOVERAGE, kmeans=ROUNDS)
    each = np.asarray(found.convert("RGB"))[0] / 255.0
    used, first, numbers, counts = np.unique(
        np.asarray(found)[0], return_index=True, return_inverse=True, return_counts=True
    )
    kept: list[int] = []
    merged = np.zeros(len(used), dtype=np.int64)
    for number in np.argsort(-counts, kind="stable"):
        color = each[first[number]]
        near = [np.abs(color - each[first[other]]).max() for other in kept]
        if near and min(near) < ALIKE:
            merged[number] = int(np.argmin(near))
            continue
        merged[number] = len(kept)
        kept.append(int(number))
    return merged[numbers.reshape(-1)], each


def _is_inside(channels: Array) -> BoolArray:
    """Return which pixels have the color of all four neighbors: (H, W) array of bool."""
    inside = np.ones(channels.shape[:2], dtype=bool)
    for axis in (0, 1):
        same = np.abs(np.diff(channels, axis=axis)).max(axis=2) <= LEVEL
        before, after = ([(0, 0), (0, 0)] for _ in range(2))
        before[axis], after[axis] = (1, 0), (0, 1)
        inside &= np.pad(same, before, constant_values=True)
        inside &= np.pad(same, after, constant_values=True)
    return inside
