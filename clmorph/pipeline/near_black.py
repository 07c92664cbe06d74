"""Near black a map of colors is no steeper than the picture, so that noise does not become visible.

Color spaces are steep at black: in Oklab the cube root makes the levels 0 and 3 of 8 bits as
different as 60 and 90, and where dark noise is a large part of a picture, a map that gives it the
other picture's colors spreads it over all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array

#: Channels, in sRGB, below which a color counts as near black.
DARK = 16 / 255
#: Largest slope of the map there, and by how much the way to the map of other colors is steeper.
SLOPE, SLOPE_BETWEEN = 1.0, 3.0
#: Grays that count as near black in every picture, each as much as this number of pixels.
GRAYS, WEIGHT = 17, 1e-3


class NearBlack(NamedTuple):
    """The map of colors near black: mean + slope (color - middle)."""

    #: Mean of the picture's colors near black, and of what the map makes of them: (3,) arrays.
    middle: Array
    mean: Array
    slope: float

    def reaches(self, colors: Array) -> NDArray[np.bool_]:
        """Return which colors, (N, 3), `limited` can change."""
        return np.asarray(self.far(colors)[:, 0] < 1.0, bool)

    def far(self, colors: Array) -> Array:
        """Return how far colors may be from the line, at most 1: (N, 1) array."""
        apart = SLOPE_BETWEEN * (colors.max(axis=1) - DARK)
        return np.clip(apart, 0.0, 1.0)[:, None]

    def limited(self, colors: Array, moved: Array) -> Array:
        """Return what a map makes of colors, (N, 3), limited around the line, continuously."""
        line = self.mean + self.slope * (colors - self.middle)
        far = self.far(colors)
        return np.clip(np.clip(moved, line - far, line + far), 0.0, 1.0)


def near_black(colors: Array, weights: Array, move: Callable[[Array], Array]) -> NearBlack:
    """Fit a line of slope 0 to `SLOPE` to what a map makes of colors (N, 3) near black."""
    dark = colors.max(axis=1) <= DARK
    grays = np.repeat(np.linspace(0.0, DARK, GRAYS)[:, None], 3, axis=1)
    before = np.concatenate((colors[dark], grays))
    share = np.concatenate((weights[dark], np.full(GRAYS, WEIGHT)))
    share = (share / share.sum())[:, None]
    after = move(before)
    middle, mean = (share * before).sum(axis=0), (share * after).sum(axis=0)
    apart = before - middle
    slope = float((share * apart * (after - mean)).sum() / (share * apart**2).sum())
    return NearBlack(middle, mean, float(np.clip(slope, 0.0, SLOPE)))
