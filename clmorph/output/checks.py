"""Check the canvas and the color that a user requests."""

import re
from typing import Any

import numpy as np

from clmorph._shared.validation import as_float, shown
from clmorph.errors import InputError

#: Canvases with a name: each frame's own size, the first picture's, the last one's.
CANVASES = ("dynamic", "source", "target")
#: A canvas's largest side, in pixels.
MAX_SIDE = 16384


def check_color(color: Any) -> str:
    """Return the color, or raise InputError if Pillow does not know it."""
    from PIL import ImageColor

    try:
        if not isinstance(color, str):
            raise TypeError
        ImageColor.getrgb(color)
    except (ValueError, AttributeError, TypeError):
        raise InputError(
            f"background={shown(color)}: expected a color such as 'white' or '#204060'"
        ) from None
    return color


def as_canvas(canvas: Any) -> Any:
    """Return a canvas as one of `CANVASES` or as (width, height), or raise InputError."""
    if isinstance(canvas, str) and canvas in CANVASES:
        return canvas
    sides: Any = canvas
    if isinstance(canvas, str):
        found = re.fullmatch(r"(\d{1,6})[x×](\d{1,6})", canvas)
        sides = found.groups() if found else ()
    elif isinstance(canvas, list | tuple) or (isinstance(canvas, np.ndarray) and canvas.ndim == 1):
        numbers = [as_float(side) for side in canvas]
        sides = [number for number in numbers if number is not None and number % 1 == 0]
    else:
        sides = ()
    width, height = (int(side) for side in sides) if len(sides) == 2 else (0, 0)
    if 1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE:
        return width, height
    raise InputError(
        f"canvas={shown(canvas)}: expected {', '.join(map(repr, CANVASES))}, or width x height in "
        f"pixels such as '640x480', each from 1 to {MAX_SIDE}"
    )
