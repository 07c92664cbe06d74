"""The pixels on which a frame is drawn (paper, 3.3, "Dynamic Rasterization Grid")."""

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array


@dataclass(frozen=True)
class Canvas:
    """The pixels of one frame."""

    #: Height and width.
    shape: tuple[int, int]
    #: Pixels per unit of the common frame, along x and y.
    scale: tuple[float, float]

    @property
    def center(self) -> tuple[float, float]:
        """Pixel coordinates (x, y) of the common frame's center."""
        return (self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2

    def reduced(self, longest: int) -> "Canvas":
        """Return a canvas of the same extent with at most `longest` pixels along a side."""
        shrink = min(1.0, longest / max(self.shape))
        height, width = (max(1, round(side * shrink)) for side in self.shape)
        x, y = width / self.shape[1], height / self.shape[0]
        return Canvas((height, width), (self.scale[0] * x, self.scale[1] * y))

    def positions(self, first: int = 0, stop: int | None = None) -> Array:
        """Return positions (x, y) of some rows' pixels in the common frame: (H, W, 2) array."""
        y, x = np.mgrid[first : self.shape[0] if stop is None else stop, : self.shape[1]]
        # Along a side of one pixel the scale may be 0.
        scale = np.maximum(self.scale, 1e-9)
        return np.stack((x - self.center[0], y - self.center[1]), axis=-1) / scale + 0.5

    def places(self, positions: Array) -> Array:
        """Return the pixel coordinates (row, column) of positions (..., 2): (2, ...) array."""
        pixels = (positions - 0.5) * self.scale + self.center
        return np.stack((pixels[..., 1], pixels[..., 0]))


def canvas_at(
    t: float, source_shape: tuple[int, int], target_shape: tuple[int, int], extent: str = "true"
) -> Canvas:
    """Return the canvas at time t (paper, 3.3, "Dynamic Rasterization Grid").

    Sides are interpolated from those of the source to those of the target, and rounded down. At
    both ends the common frame maps exactly onto the pixels of the image. `extent`, "true" or
    "unit", is that with which the measures were lifted.
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
