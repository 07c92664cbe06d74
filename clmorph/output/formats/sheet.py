"""A contact sheet: the frames at a glance."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.output.formats.format import SIZES, Format
from clmorph.output.formats.limits import encoding
from clmorph.output.framing import FrameStyle, Framing, in_time
from clmorph.output.metadata import as_png_info, read_png
from clmorph.output.recording import Recording

#: Longer side, in pixels, of each picture; of small pixel art at least.
SIDE = 192
#: Pictures, and how many stand in a row.
FRAMES = 10
COLUMNS = 5
#: Pixels between pictures, and below them for the time.
GAP, LABEL = 12, 22


@encoding("PNG")
def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write up to ten frames with their times, on white."""
    from PIL import Image, ImageDraw, ImageFont

    count = min(FRAMES, len(recording))
    chosen = np.unique(np.round(np.linspace(0, len(recording) - 1, count)).astype(int))
    shapes = in_time([recording.shapes[i] for i in chosen], recording.times[chosen])
    framing = Framing(_fitting(style, shapes), shapes, recording.pixelated, SIDE)
    width, height = framing.size
    captions = [f"t = {recording.times[index]:.2f}" for index in chosen]
    font = ImageFont.load_default(14)
    # Below narrow pictures captions need more than these.
    cell = max(width, *(math.ceil(font.getlength(caption)) for caption in captions))
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    sheet = Image.new(
        "RGB", (columns * (cell + GAP) + GAP, rows * (height + LABEL + GAP) + GAP), "white"
    )
    draw = ImageDraw.Draw(sheet)
    for place, index in enumerate(tracked(chosen.tolist(), report)):
        x = GAP + (place % columns) * (cell + GAP)
        y = GAP + (place // columns) * (height + LABEL + GAP)
        sheet.paste(framing(recording.picture(index)), (x + (cell - width) // 2, y))
        draw.text(
            (x + cell / 2, y + height + 3), captions[place], fill="black", font=font, anchor="ma"
        )
        if place == len(chosen) - 1:
            # Before the last report, for it takes a while as well.
            sheet.save(file, format="PNG", pnginfo=as_png_info(recording.parameters))


def _fitting(style: FrameStyle, shapes: list[tuple[int, ...]]) -> FrameStyle:
    """Return the style on white; of large frames, with a canvas as large as a picture here."""
    style = replace(style, background=style.background or "white")
    longest = max(max(shape[:2]) for shape in shapes)
    if style.canvas != "dynamic" or longest <= SIDE:
        return style
    height, width = (max(shape[axis] for shape in shapes) for axis in (0, 1))
    canvas = [max(1, round(side * SIDE / longest)) for side in (width, height)]
    # Reduced by leaving out pixels, pixel art would be hard to know again.
    scaling = "smooth" if style.scaling == "auto" else style.scaling
    return replace(style, canvas=canvas, scaling=scaling)


FORMATS = (
    Format(
        name="sheet", endings=(".png",), write=write, read_metadata=read_png,
        signatures=((0, b"\x89PNG"),), relevant_options=SIZES,
    ),
)  # fmt: skip
