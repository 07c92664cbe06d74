"""``.png``: a contact sheet, which shows frames side by side."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.output.formats.format import SIZES, Format, encoding
from clmorph.output.metadata import as_png_info, read_png
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

#: Longer side, in pixels, of each picture; of small pixel art at least.
SIDE = 192
#: The largest number of pictures, and the number of pictures in a row.
FRAMES = 10
COLUMNS = 5


def lengths(width: int, height: int) -> tuple[int, ...]:
    """Return the gap between pictures, the height of captions, of their text, and of its margin."""
    scale = max(1.0, math.sqrt(width * height) / SIDE)
    return tuple(round(length * scale) for length in (12, 22, 14, 3))


@encoding("PNG")
def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write up to ten frames with their times, on white."""
    from PIL import Image, ImageDraw, ImageFont

    from clmorph.output.framing import Framing, in_time

    count = min(FRAMES, len(recording))
    chosen = np.unique(np.round(np.linspace(0, len(recording) - 1, count)).astype(int))
    shapes = in_time([recording.shapes[i] for i in chosen], recording.times[chosen])
    framing = Framing(_fitting(style, shapes), shapes, recording.pixelated, SIDE)
    width, height = framing.size
    captions = [f"t = {recording.times[index]:.2f}" for index in chosen]
    gap, label, size, margin = lengths(width, height)
    font = ImageFont.load_default(size)
    # A caption can be wider than a narrow picture.
    cell = max(width, *(math.ceil(font.getlength(caption)) for caption in captions))
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    step = cell + gap, height + label + gap
    sheet = Image.new("RGB", (columns * step[0] + gap, rows * step[1] + gap), "white")
    draw = ImageDraw.Draw(sheet)
    for place, index in enumerate(tracked(chosen.tolist(), report)):
        x = gap + (place % columns) * step[0]
        y = gap + (place // columns) * step[1]
        sheet.paste(framing(recording.picture(index)), (x + (cell - width) // 2, y))
        middle = x + cell / 2, y + height + margin
        draw.text(middle, captions[place], fill="black", font=font, anchor="ma")
        if place == len(chosen) - 1:
            # The file is written before the last report, because writing takes a while too.
            sheet.save(file, format="PNG", pnginfo=as_png_info(recording.parameters))


def _fitting(style: FrameStyle, shapes: list[tuple[int, ...]]) -> FrameStyle:
    """Return the style on white; large frames get a canvas of the size of the sheet's pictures."""
    style = replace(style, background=style.background or "white")
    longest = max(max(shape[:2]) for shape in shapes)
    if style.canvas != "dynamic" or longest <= SIDE:
        return style
    height, width = (max(shape[axis] for shape in shapes) for axis in (0, 1))
    canvas = [max(1, round(side * SIDE / longest)) for side in (width, height)]
    # Pixel art is reduced smoothly: with pixels left out it would be hard to recognize.
    scaling = "smooth" if style.scaling == "auto" else style.scaling
    return style.replace(canvas=canvas, scaling=scaling)


FORMATS = (
    Format(
        name="sheet", endings=(".png",), write=write, read_metadata=read_png,
        signatures=((0, b"\x89PNG"),), relevant_options=SIZES,
    ),
)  # fmt: skip
