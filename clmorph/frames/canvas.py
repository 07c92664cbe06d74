"""The pixels on which a frame is drawn (paper, 3.3, "Dynamic Rasterization Grid")."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Canvas:
    """The pixels of one frame.

    Attributes
    ----------
    shape : (height, width)
    scale : (x, y)
        Pixels per unit of the common frame.
    """

    shape: tuple[int, int]
    scale: tuple[float, float]

    @property
    def center(self) -> tuple[float, float]:
        """Pixel coordinates (x, y) of the common frame's center."""
        return (self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2


def canvas_at(
    t: float, source_shape: tuple[int, int], target_shape: tuple[int, int], extent: str = "true"
) -> Canvas:
    """Return the canvas at time t (paper, 3.3, "Dynamic Rasterization Grid").

    Sides are interpolated from those of the source to those of the target, and rounded down. At
    both ends the common frame maps exactly onto the pixels of the image.

    Parameters
    ----------
    t : float in [0, 1]
    source_shape, target_shape : (height, width)
    extent : {"true", "unit"}
        The extent with which the measures were lifted.
    """
    # The small number keeps rounding from turning an integer into the one below.
    height, width = (
        s + int(np.floor(t * (e - s) + 1e-9))
        for s, e in zip(source_shape, target_shape, strict=True)
    )
    if extent == "unit":
        return Canvas((height, width), (width - 1.0, height - 1.0))
    per_unit = (1 - t) * (max(source_shape) - 1) + t * (max(target_shape) - 1)
    return Canvas((height, width), (per_unit, per_unit))
