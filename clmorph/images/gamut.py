"""Colors outside of the sRGB cube: they lose chroma, and keep lightness and hue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.images.color import from_space, to_space

#: Distance, in coordinates of a space, up to which a color that was clipped counts as the same.
SAME = 1e-3
#: Halvings of the interval in which the largest chroma lies.
HALVINGS = 10
#: Weights of red, green and blue in luminance (IEC 61966-2-1), for spaces without lightness.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def into_gamut(coordinates: Array, space: str) -> Array:
    """Convert coordinates (N, 3) to sRGB; colors outside move towards their gray, and keep hue."""
    colors = from_space(coordinates, space)
    # A color that was clipped has a channel at a bound.
    edge = np.flatnonzero(((colors <= 0.0) | (colors >= 1.0)).any(axis=1))
    outside = edge[~_same(coordinates[edge], colors[edge], space)]
    if not len(outside):
        return colors
    wanted = coordinates[outside]
    gray = _gray(wanted, space)
    low, high = np.zeros(len(wanted)), np.ones(len(wanted))
    for _ in range(HALVINGS):
        share = 0.5 * (low + high)
        tried = gray + share[:, None] * (wanted - gray)
        inside = _same(tried, from_space(tried, space), space)
        low, high = np.where(inside, share, low), np.where(inside, high, share)
    colors[outside] = from_space(gray + low[:, None] * (wanted - gray), space)
    return colors


def _same(coordinates: Array, colors: Array, space: str) -> NDArray[np.bool_]:
    """Return whether colors in sRGB are those of the coordinates: (N,) array of bool."""
    return np.asarray(np.abs(to_space(colors, space) - coordinates).max(axis=1) <= SAME, bool)


def _gray(coordinates: Array, space: str) -> Array:
    """Return the grays of the lightness of colors, in coordinates of the space."""
    if space in ("srgb", "linear"):
        values = np.repeat((coordinates @ LUMINANCE)[:, None], 3, axis=1)
    else:
        values = np.zeros_like(coordinates)
        values[:, 0] = coordinates[:, 0]
    white = to_space(np.ones(3), space)
    return np.clip(values, 0.0, np.maximum(white, 0.0))
