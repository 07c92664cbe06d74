"""Regions that are painted on the page, as label images and masks of the size of the picture."""

import io
from typing import Any

import numpy as np
from PIL import Image

from clmorph.errors import InputError

#: Largest number of labels of the brush; the page draws label k in red level k LEVEL.
LABELS, LEVEL = 3, 60
#: Largest number of pixels of the canvas on which the page paints.
MAX_CANVAS = 4096 * 4096


def read_painted(content: bytes, shape: tuple[int, int], kind: str) -> Image.Image:
    """Return painted regions as a gray picture of the size of their picture, or raise InputError.

    `content` is the page's canvas as PNG, perhaps smaller: its opaque pixels are painted, with the
    label in their red level. Labels are the gray levels 0 (not painted) to `LABELS`; a mask is 0 or
    255.
    """
    try:
        with Image.open(io.BytesIO(content), formats=("PNG",)) as image:
            if image.width * image.height > MAX_CANVAS:
                raise InputError(
                    f"painted regions of {image.width} x {image.height} pixels: expected fewer"
                )
            pixels = np.asarray(image.convert("RGBA"))
    except InputError:
        raise
    except Exception:  # decoders raise exceptions of any class
        raise InputError("painted regions: expected a picture in PNG") from None
    labels = np.clip(np.rint(pixels[..., 0] / LEVEL), 1, LABELS)
    found: Any = np.where(pixels[..., 3] >= 128, labels, 0).astype(np.uint8)
    if kind == "mask":
        found = np.where(found > 0, 255, 0).astype(np.uint8)
    rows, columns = (
        np.minimum((np.arange(size) + 0.5) * drawn / size, drawn - 1).astype(int)
        for size, drawn in zip(shape, found.shape, strict=True)
    )
    return Image.fromarray(np.ascontiguousarray(found[rows[:, None], columns]))
