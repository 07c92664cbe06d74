"""The kind of a picture: a sprite, a flat drawing such as a logo, or a photograph."""

from __future__ import annotations

from typing import Literal

import numpy as np

from clmorph._shared.typing import AnyArray, Array, BoolArray
from clmorph.images.detail import SPRITE_SIDE, has_few_colors
from clmorph.images.flat_colors import foreground, palette
from clmorph.images.pixels import block_size, split_alpha
from clmorph.images.resizing import as_unit

Kind = Literal["sprite", "drawing", "photograph"]

#: Numbers of blocks along the longer side of an enlarged sprite, and of lines between blocks at
#: which it changes: those of a rectangle are 4.
FEWEST_BLOCKS, MOST_BLOCKS, FEWEST_LINES = 8, 128, 8
#: Unequal neighbors are those of a gradient if this share of them differs by at most these steps.
RAMP_STEPS, RAMP_SHARE = 4, 0.8
#: Longest side of a plain sprite, in blocks; a larger one has small parts, and so at least this
#: share of unequal neighbors.
MOST_PLAIN, LEAST_CHANGES = 96, 0.05
#: Pictures are reduced to this longer side before they are judged.
LONGEST = 1024
#: Steps of 8 bits up to which neighbors count as smooth, and up to which a color is explained.
SMOOTH, EXPLAINED = 2, 12
#: Least shares of equal neighbors, of smooth ones, and number and least share of flat colors.
EQUAL, EQUAL_BEFORE, SMOOTH_BEFORE = 0.6, 0.5, 0.85
FLAT_COLORS, FLAT_SHARE = 8, 0.9


def kind_of(image: AnyArray) -> Kind:
    """Return the kind of a picture: of blocks, of flat parts before its background, or other."""
    if _is_sprite(image):
        return "sprite"
    colors, alpha = split_alpha(_reduced(image))
    before = foreground(colors, alpha)
    levels = np.rint(255 * colors)
    if alpha is None:
        steps = _steps(levels, np.ones_like(before))
        if not len(steps) or np.mean(steps == 0) < EQUAL or (before.all() and _is_ramp(steps)):
            return "photograph"
    steps = _steps(levels, before)
    smooth = len(steps) > 0 and np.mean(steps <= SMOOTH) >= SMOOTH_BEFORE
    flat = len(steps) > 0 and np.mean(steps == 0) >= EQUAL_BEFORE
    if flat or (smooth and alpha is not None):
        return "drawing"
    found = palette(colors[before], FLAT_COLORS)[1]
    explained = np.abs(255 * found - levels[before]).max(axis=1) <= EXPLAINED
    return "drawing" if np.mean(explained) >= FLAT_SHARE else "photograph"


def _is_sprite(image: AnyArray) -> bool:
    """Return whether an image consists of equal blocks, or is small with few colors."""
    block = block_size(image)
    if block > 1 and FEWEST_BLOCKS <= max(image.shape[:2]) // block <= MOST_BLOCKS:
        small = image[::block, ::block]
        lines = sum(
            np.count_nonzero(np.any(np.diff(small, axis=axis) != 0, axis=(1 - axis, 2)))
            for axis in (0, 1)
        )
        if lines >= FEWEST_LINES:
            return True
    if max(image.shape[:2]) > SPRITE_SIDE:
        return False
    image = as_unit(image)
    if not has_few_colors(image):
        return False
    steps = _steps(np.rint(255 * image), np.ones(image.shape[:2], dtype=bool))
    if _is_ramp(steps):
        return False
    return max(image.shape[:2]) <= MOST_PLAIN or bool(np.mean(steps > 0) >= LEAST_CHANGES)


def _is_ramp(steps: Array) -> bool:
    """Return whether nearly all differences between neighbors are as small as in a gradient."""
    unequal = steps[steps > 0]
    return len(unequal) > 0 and bool(np.mean(unequal <= RAMP_STEPS) >= RAMP_SHARE)


def _reduced(image: AnyArray) -> Array:
    """Return an image of at most `LONGEST` pixels along a side: means of whole squares of it."""
    side = -(-max(image.shape[:2]) // LONGEST)
    if side == 1:
        return as_unit(image)
    height, width = (max(1, length // side) for length in image.shape[:2])
    along = min(side, image.shape[1])
    found = np.empty((height, width, image.shape[2]))
    for row in range(height):  # a large image is not converted as a whole
        part = image[row * side : (row + 1) * side, : width * along]
        part = as_unit(part, weighted=image.shape[2] == 4)
        found[row] = part.mean(axis=0).reshape(width, along, -1).mean(axis=1)
    if image.shape[2] == 3:
        return found
    seen, alpha = found[..., :3], found[..., 3:]
    return np.dstack((np.divide(seen, alpha, out=np.zeros_like(seen), where=alpha > 0), alpha))


def _steps(levels: Array, within: BoolArray) -> Array:
    """Return the largest difference of a channel of all neighbors within a mask, in 8 bits."""
    down = np.abs(np.diff(levels, axis=0)).max(axis=2)[within[1:] & within[:-1]]
    along = np.abs(np.diff(levels, axis=1)).max(axis=2)[within[:, 1:] & within[:, :-1]]
    return np.concatenate((down, along))
