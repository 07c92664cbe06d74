"""Small copies of pictures, in which things are found, and the way back to their pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clmorph._shared.typing import AnyArray, Array
from clmorph.images.pixels import reduced_shape
from clmorph.images.resizing import as_unit

Bytes = NDArray[np.uint8]
#: Color under transparent pixels: neither black nor white, so that outlines of either are seen.
UNDER = 0.5


class Copy(NamedTuple):
    """A small copy of a picture."""

    #: (H, W, 3).
    pixels: Bytes
    #: (height, width) of the picture.
    shape: tuple[int, int]

    def whole(self, places: Array) -> Array:
        """Return places (n, 2) of the copy in pixels of the picture, rounded to tenths."""
        small = np.array(self.pixels.shape[1::-1], float)
        size = np.array(self.shape[::-1], float)
        found = (np.asarray(places, float) + 0.5) / small * size - 0.5
        return np.round(np.clip(found, 0.0, size - 1.0), 1)


def small_copy(image: AnyArray, most: int) -> Copy:
    """Return a copy of at most `most` pixels along the longer side; clear parts become gray."""
    shape = image.shape[0], image.shape[1]
    # Of large pictures every k-th pixel is enough: two to three times as many are left.
    step = max(1, max(shape) // (2 * most))
    pixels = as_unit(image[step // 2 :: step, step // 2 :: step] if min(shape) > step else image)
    if pixels.shape[2] == 4:
        pixels = UNDER + (pixels[..., :3] - UNDER) * pixels[..., 3:]
    found = Image.fromarray((255 * np.clip(pixels, 0, 1) + 0.5).astype(np.uint8))
    small = found.resize(reduced_shape(shape, most)[::-1], Image.Resampling.LANCZOS)
    return Copy(np.ascontiguousarray(small), shape)
