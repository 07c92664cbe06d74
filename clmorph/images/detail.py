"""The resolution of a picture: the size of its smallest detail, and whether it is pixel art."""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array

#: Least share of the edges' energy that lies on the grid of blocks in an enlarged sprite.
BLOCK_SHARE = 0.9
#: Least effective number of lines of edges in a grid of blocks.
FEWEST_LINES = 4.0
#: Largest number of colors, and of pixels along a side, of a sprite that is not enlarged.
SPRITE_COLORS = 64
SPRITE_SIDE = 256
#: Largest share of translucent pixels among the visible ones of such a sprite. The edges of
#: drawings are translucent, even if they have one color.
TRANSLUCENT_SHARE = 0.1
#: Number of colors up to which an outline may be a mixture by chance. Share of the edges whose
#: middle pixel mixes the colors of both sides, from which an image is anti-aliased; least
#: difference of both sides, bounds of a mixture, largest difference from one.
FEW_COLORS, MIXED_SHARE, EDGE, MIXED, OFF_MIXTURE = 6, 0.15, 0.1, (0.1, 0.9), 0.08
_DIGITS = np.array([1 << 16, 1 << 8, 1])
#: Range of luma below which an image has no detail; it is less than a step of 8 bits.
FAINTEST = 1e-3
#: Share of the edges' energy that lies below an image's highest frequency, by definition.
BAND_SHARE = 0.99


def intrinsic_spacing(image: Array) -> float:
    """Return the side, in pixels, of the smallest detail of an image (H, W, C), at least 1."""
    return max(1.0, float(_block_side(image)), _half_period(image))


def auto_sigma(image: Array) -> float:
    """Return the kernel width for an image (H, W, C), in pixels: half of its smallest detail."""
    return 0.5 * intrinsic_spacing(image)


def is_pixel_art(image: Array) -> bool:
    """Return whether visible colors are a sprite: small with few of them, or made of blocks."""
    return _block_side(_visible(image)) > 1 or has_few_colors(image)


def has_few_colors(image: Array) -> bool:
    """Return whether an image is small, has few colors in 8 bits and no anti-aliased edges."""
    if max(image.shape[:2]) > SPRITE_SIDE:
        return False
    if image.shape[2] == 4:
        alpha = image[..., 3]
        translucent = np.count_nonzero((alpha > 0) & (alpha < 1))
        if translucent > TRANSLUCENT_SHARE * np.count_nonzero(alpha):
            return False
    levels = np.rint(255 * _visible(image)).astype(np.int64)
    n_colors = len(np.unique(levels @ _DIGITS))
    if n_colors > min(SPRITE_COLORS, image.shape[0] * image.shape[1] // 4):
        return False
    if n_colors <= FEW_COLORS:
        return True
    # A step of opacity is an edge too, so that an outline before a clear ground is no mixture.
    visible = _visible(image)
    return _mixed_share(np.dstack((visible, image[..., 3:]))) < MIXED_SHARE


def _mixed_share(image: Array) -> float:
    """Return the share of edges that are anti-aliased: the middle pixel mixes both sides."""
    n_mixed, n_edges = 0, 0
    for axis in (0, 1):
        lines = np.moveaxis(image, axis, 0)
        before, own, after = lines[:-2], lines[1:-1], lines[2:]
        way = after - before
        edges = np.abs(way).max(axis=2) > EDGE
        place = ((own - before) * way).sum(axis=2) / np.maximum((way**2).sum(axis=2), EDGE**2)
        off = np.abs(own - before - place[..., None] * way).max(axis=2)
        between = (place > MIXED[0]) & (place < MIXED[1]) & (off < OFF_MIXTURE)
        n_mixed += int(np.count_nonzero(edges & between))
        n_edges += int(np.count_nonzero(edges))
    return n_mixed / max(n_edges, 1)


def _visible(image: Array) -> Array:
    """Return the colors of an image, and black where it is transparent: (H, W, 3) array."""
    return image if image.shape[2] == 3 else np.where(image[..., 3:] > 0, image[..., :3], 0.0)


def _block_side(image: Array) -> int:
    """Return the largest k for which nearly all edges lie on one grid of k x k blocks, else 1."""
    edges = [np.sum(np.diff(image, axis=axis) ** 2, axis=(1 - axis, 2)) for axis in (0, 1)]
    total = sum(float(along.sum()) for along in edges)
    # An image with only a few lines fits many grids.
    if total == 0 or total**2 < FEWEST_LINES * sum(float(np.sum(along**2)) for along in edges):
        return 1
    # A grid of fewer than 8 blocks along a side would fit too many images by chance.
    for side in range(min(image.shape[:2]) // 8, 1, -1):
        on_grid = sum(max(along[phase::side].sum() for phase in range(side)) for along in edges)
        if on_grid >= BLOCK_SHARE * total:
            return side
    return 1


def _half_period(image: Array) -> float:
    """Return half the period, in pixels, of the frequency below which nearly all edges lie."""
    height, width = image.shape[:2]
    if min(height, width) < 8:
        return 1.0
    # The window removes the jump between opposite borders from the spectrum.
    window = np.hanning(height)[:, None] * np.hanning(width)
    gray = image[..., :3].mean(axis=2)
    if np.ptp(gray) < FAINTEST:
        return 1.0
    power = np.abs(np.fft.rfft2((gray - gray.mean()) * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    edges = (frequency**2 * power).ravel()
    order = np.argsort(frequency, axis=None)
    below = np.cumsum(edges[order])
    if below[-1] == 0:
        return 1.0
    highest = frequency.ravel()[order][np.searchsorted(below, BAND_SHARE * below[-1])]
    return float(0.5 / min(0.5, highest)) if highest > 0 else 1.0
