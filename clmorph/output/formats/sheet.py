"""A contact sheet: the frames at a glance."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.output.formats.limits import encoding
from clmorph.output.framing import Framing, Look, in_time
from clmorph.output.provenance import as_png_info
from clmorph.output.recording import Film

#: Longer side, in pixels, of each picture; of small pixel art at least.
SIDE = 192
#: Pictures, and how many stand in a row.
FRAMES = 10
COLUMNS = 5
#: Pixels between pictures, and below them for the time.
GAP, LABEL = 12, 22


@encoding("PNG")
def write(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write up to ten frames with their times, on white."""
    from PIL import Image, ImageDraw, ImageFont

    count = min(FRAMES, len(film))
    chosen = np.unique(np.round(np.linspace(0, len(film) - 1, count)).astype(int))
    shapes = in_time([film.shapes[i] for i in chosen], film.times[chosen])
    framing = Framing(_fitting(look, shapes), shapes, film.pixelated, SIDE)
    width, height = framing.size
    captions = [f"t = {film.times[index]:.2f}" for index in chosen]
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
        sheet.paste(framing(film.picture(index)), (x + (cell - width) // 2, y))
        draw.text(
            (x + cell / 2, y + height + 3), captions[place], fill="black", font=font, anchor="ma"
        )
        if place == len(chosen) - 1:
            # Before the last report, for it takes a while as well.
            sheet.save(file, format="PNG", pnginfo=as_png_info(film.parameters))


def _fitting(look: Look, shapes: list[tuple[int, ...]]) -> Look:
    """Return the look on white; of large frames, with a canvas as large as a picture here."""
    look = replace(look, background=look.background or "white")
    longest = max(max(shape[:2]) for shape in shapes)
    if look.canvas != "dynamic" or longest <= SIDE:
        return look
    height, width = (max(shape[axis] for shape in shapes) for axis in (0, 1))
    canvas = [max(1, round(side * SIDE / longest)) for side in (width, height)]
    # Reduced by leaving out pixels, pixel art would be hard to know again.
    scaling = "smooth" if look.scaling == "auto" else look.scaling
    return replace(look, canvas=canvas, scaling=scaling)
