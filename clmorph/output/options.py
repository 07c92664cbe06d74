"""Options of playback and of the style of frames in files."""

import re
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from clmorph._shared.option_kinds import choice, flag, integer, number, text
from clmorph._shared.options import Options, option
from clmorph._shared.validation import as_float, shown
from clmorph.errors import InputError

#: Canvases with a name: each frame's own size, the first picture's, the last one's.
CANVASES = ("dynamic", "source", "target")
#: A canvas's largest side, in pixels.
MAX_SIDE = 16384
#: The rules by which the time of the morph runs while frames follow one another evenly.
Ease = Literal["linear", "smooth", "in", "out"]
#: The rules for the playback after the last frame: start again, play backwards, or stop.
Loop = Literal["loop", "ping-pong", "once"]
#: The methods to enlarge and reduce frames; "auto" depends on the pictures.
Scaling = Literal["auto", "nearest", "smooth"]


#: The default frame rate, in frames per second.
FPS = 20.0


@dataclass(frozen=True, init=False)
class PlaybackOptions(Options):
    """Options of the number and the timing of frames."""

    n_frames: int = option(
        30, integer(2, 100_000), "Number of frames of each morph, both ends included.", "Motion",
        outside="frames", word="",
    )  # fmt: skip
    fps: float | None = option(FPS, number(0.1, 240.0), "Frames a second.", "Motion")
    duration: float | None = option(
        None, number(0.0, 1e6, open_low=True),
        "Duration of one round, in place of fps; it includes the time of hold.", "Motion",
        unit="seconds",
    )  # fmt: skip
    hold: float = option(
        0.65, number(0.0, 3600.0),
        "Additional time for which the pictures themselves are shown.", "Motion",
        unit="seconds", word="",
    )  # fmt: skip
    ease: Ease = option(
        "linear", choice(Ease),
        "Pace: even (linear), slow at both ends (smooth), at the start (in), or at the end (out).",
        "Motion", word="",
    )  # fmt: skip
    loop: Loop = option("loop", choice(Loop), "What follows the last frame.", "Motion", word="")
    reverse: bool = option(
        False, flag(), "Play from the last picture to the first.", "Motion", word=""
    )


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


_SIDES = {"type": "array", "items": {"type": "integer"}, "minItems": 2, "maxItems": 2}
_CANVAS = replace(
    text("dynamic|source|target|WxH", as_canvas),
    scalar=lambda value: isinstance(value, str)
    or (isinstance(value, list) and all(type(side) is int for side in value)),
    schema={"anyOf": [{"type": "string"}, _SIDES]},
)  # fmt: skip


@dataclass(frozen=True, init=False)
class FrameStyle(Options):
    """Options of the style in which frames are written to a file."""

    canvas: str | tuple[int, int] = option(
        "dynamic", _CANVAS,
        "Size of the frames: each frame's own where the file can hold that (dynamic), the first "
        "picture's (source), the last one's (target), or a size in pixels such as 640x480.",
        "File", word="",
    )  # fmt: skip
    scaling: Scaling = option(
        "auto", choice(Scaling),
        "How frames are enlarged; auto: nearest for pixel art, smooth for the rest.",
        "File", word="",
    )  # fmt: skip
    background: str | None = option(
        None, text("COLOR", check_color),
        "Color under transparent parts and of bars, such as white or #204060; none: opacity is "
        "kept where the file can hold it, and otherwise the frame is drawn on white.",
        "File",
    )  # fmt: skip
    lossless: bool = option(False, flag(), "Write WebP without loss.", "File", word="")

    def is_nearest(self, pixelated: bool) -> bool:
        """Return whether pixels are enlarged as squares, for pictures that are pixel art or not."""
        return pixelated if self.scaling == "auto" else self.scaling == "nearest"
