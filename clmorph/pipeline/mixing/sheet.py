"""Pictures side by side, at their places on a sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clmorph.frames.sequence import Frame
from clmorph.output.framing import Framing
from clmorph.output.options import FrameStyle
from clmorph.pipeline.mixing.weights import Layout


def sheet_of(
    pictures: Sequence[Frame],
    layout: Layout,
    pixelated: bool,
    background: str | None,
    clear: bool,
) -> NDArray[np.uint8]:
    """Return pictures at their places on a sheet; see `Mixes.sheet`."""
    from PIL import Image

    style = FrameStyle(background=background or (None if clear else "white"))
    framing = Framing(style, [picture.shape for picture in pictures], pixelated)
    width, height = framing.size
    columns, rows = layout.size
    mode = "RGBA" if framing.clear else "RGB"
    ground = background or ((0, 0, 0, 0) if framing.clear else "white")
    sheet = Image.new(mode, (columns * width, rows * height), ground)
    for picture, (left, top) in zip(pictures, layout.places.tolist(), strict=True):
        framed = framing(np.rint(255 * picture).astype(np.uint8))
        sheet.paste(framed, (round(left * width), round(top * height)))
    return np.asarray(sheet)
