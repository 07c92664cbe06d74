"""A contact sheet: the frames at a glance."""

from pathlib import Path

import numpy as np

from clmorph.film import Film
from clmorph.formats.embedding import as_png_info
from clmorph.formats.limits import encoding
from clmorph.framing import Framing, Look, in_time
from clmorph.progress import Report, tracked

#: Longer side, in pixels, of each picture.
SIDE = 192
#: Pictures, and how many stand in a row.
FRAMES = 10
COLUMNS = 5
#: Pixels between pictures, and below them for the time.
GAP, LABEL = 12, 22


@encoding("PNG")
def write(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write up to ten frames with their times, on white."""
    from dataclasses import replace

    from PIL import Image, ImageDraw, ImageFont

    count = min(FRAMES, len(film))
    chosen = np.unique(np.round(np.linspace(0, len(film) - 1, count)).astype(int))
    look = replace(look, background=look.background or "white")
    shapes = in_time([film.shapes[i] for i in chosen], film.times[chosen])
    framing = Framing(look, shapes, film.pixelated, SIDE)
    width, height = framing.size
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    sheet = Image.new(
        "RGB", (columns * (width + GAP) + GAP, rows * (height + LABEL + GAP) + GAP), "white"
    )
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(14)
    for place, index in enumerate(tracked(chosen.tolist(), report)):
        x = GAP + (place % columns) * (width + GAP)
        y = GAP + (place // columns) * (height + LABEL + GAP)
        sheet.paste(framing(film.picture(index)), (x, y))
        caption = f"t = {film.times[index]:.2f}"
        draw.text((x + width / 2, y + height + 3), caption, fill="black", font=font, anchor="ma")
    sheet.save(file, format="PNG", pnginfo=as_png_info(film.parameters))
