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
#: Largest difference of a mixture of two colors from the line between them; a color off this line
#: is none if its contrast is this share of the stronger one's.
OFF_MIXTURE, NEARLY = 0.08, 0.7
#: Contrasts of what compression leaves on a flat ground, and of edges beside which it does; its
#: reach in pixels.
WEAK, STRONG, BLOCK = 0.15, 0.3, 8
#: Colors of a palette that are nearer than this, in every channel, are taken as one.
ALIKE = 0.1
#: Rounds by which the colors of a palette are improved (k-means).
ROUNDS = 3


def background_color(colors: Array) -> Array | None:
    """Return the color (3,) of at least half of the border's pixels, or None if there is none."""
    border = np.concatenate((colors[0], colors[-1], colors[1:-1, 0], colors[1:-1, -1]))
    color = np.median(border, axis=0)
    share = np.mean(np.abs(border - color).max(axis=1) <= LEVEL)
    return color if share >= BORDER_SHARE else None


def foreground(colors: Array, alpha: Array | None = None) -> BoolArray:
    """Return which pixels (H, W) stand before a transparent or flat ground; all if none do."""
    from scipy.ndimage import binary_propagation, maximum_filter, minimum_filter

    color = background_color(colors) if alpha is None else None
    if alpha is not None:
        contrast = alpha
    elif color is None:
        return np.ones(colors.shape[:2], dtype=bool)
    else:
        contrast = np.abs(colors - color).max(axis=2)
    if has_few_colors(colors if alpha is None else np.dstack((colors, alpha))):
        found = contrast > SPRITE_LEVEL
    else:
        found = contrast > LEVEL
        lesser = found & (contrast < 0.5 * maximum_filter(contrast, WINDOW))
        if color is not None:
            # A light surface behind a dark outline is no edge.
            near = minimum_filter(contrast, 3) < WEAK
            mixed = lesser & ~near & (minimum_filter(contrast, WINDOW) < WEAK)
            mixed[mixed] = shares_in_mixtures(colors, color, mixed) < 0.5
            lesser &= near | mixed
            # What an outline parts from the background is no mixture with it.
            lesser = binary_propagation(~found, mask=~found | lesser) & lesser
        found &= ~lesser
        if alpha is None:
            found &= ~_noise(found, contrast)
    return found if found.any() else np.ones(found.shape, dtype=bool)


def shares_in_mixtures(colors: Array, background: Array, which: BoolArray) -> Array:
    """Return the strongest neighbor's share (n,) in each pixel `which`; 1 if it is no mixture."""
    half = WINDOW // 2
    rows, columns = np.nonzero(which)
    own = colors[which] - background
    most, way = np.abs(own).max(axis=1), own
    for down in range(-half, half + 1):
        for along in range(-half, half + 1):
            row = np.clip(rows + down, 0, which.shape[0] - 1)
            column = np.clip(columns + along, 0, which.shape[1] - 1)
            other = colors[row, column] - background
            contrast = np.abs(other).max(axis=1)
            way = np.where((contrast > most)[:, None], other, way)
            most = np.maximum(contrast, most)
    share = (own * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), LEVEL**2)
    off = np.abs(own - share[:, None] * way).max(axis=1)
    whole = (off > OFF_MIXTURE) & (np.abs(own).max(axis=1) >= NEARLY * most)
    return np.where(whole, 1.0, np.clip(share, 0.0, 1.0))


def _noise(found: BoolArray, contrast: Array) -> BoolArray:
    """Return which pixels are what compression leaves beside something strong: thin and weak."""
    from scipy.ndimage import grey_opening, maximum_filter

    weak = found & (contrast < WEAK)
    if not weak.any():
        return weak
    beside = maximum_filter(contrast >= STRONG, 2 * BLOCK + 1, mode="constant")
    return np.asarray(weak & ~grey_opening(weak, (WINDOW, WINDOW), mode="constant") & beside)


class Regions(NamedTuple):
    """Regions of a picture whose pixels have nearly one color."""

    #: The number of each pixel's region, from 0; (H, W).
    labels: IntArray
    #: The picture (H, W, 3); beyond the regions, the color of the nearest pixel in one.
    colors: Array
    #: Opacity (H, W), likewise.
    alpha: Array


def flat_regions(colors: Array, alpha: Array, within: BoolArray, n_colors: int) -> Regions:
    """Divide the pixels `within` pixel art into at most `n_colors` regions of nearly one color."""
    from scipy.ndimage import distance_transform_edt

    labels = np.zeros(within.shape, dtype=np.int64)
    labels[within] = palette(colors[within], n_colors)[0]
    place = tuple(distance_transform_edt(~within, return_distances=False, return_indices=True))
    return Regions(labels[place], colors[place], alpha[place])


def palette(colors: Array, n_colors: int) -> tuple[IntArray, Array]:
    """Return the number (N,) of the nearest of a few colors for colors (N, 3), and that one."""
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
