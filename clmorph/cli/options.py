"""Options of the command line, by the panels in which the help shows them."""

import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import rich_click as click

from clmorph._shared.validation import shown
from clmorph.frames.endpoints import ENDPOINTS
from clmorph.frames.kernel_width import SPLATTING
from clmorph.frames.particles import UNMATCHED
from clmorph.images.color import COLOR_SPACES
from clmorph.images.pixels import MAX_PIXELS
from clmorph.measures.lift import MASSES
from clmorph.measures.measure import EXTENTS
from clmorph.output.framing import SCALINGS
from clmorph.output.playback import EASES, LOOPS
from clmorph.output.save import FORMATS
from clmorph.pipeline import presets as defaults

Command = TypeVar("Command", bound=Callable[..., Any])

#: Value of ``--reach`` that stands for no creation or destruction of mass.
BALANCED = "balanced"
#: Value of ``--log-threshold`` that stands for none: pairs are kept relative to the largest ones.
RELATIVE = "relative"


class _Reach(click.ParamType):
    """A number, or "balanced", or two of them with a comma."""

    name = "number|balanced"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        parts = value if isinstance(value, list | tuple) else str(value).split(",")
        reaches = [self._one(part, param, ctx) for part in parts]
        return reaches[0] if len(reaches) == 1 else tuple(reaches)

    def _one(self, value: Any, param: Any, ctx: Any) -> float:
        if value == BALANCED:
            return math.inf
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            self.fail(f"{shown(value)} is neither a number nor {BALANCED!r}.", param, ctx)
        if number == math.inf:
            self.fail(f"{shown(value)}: expected a finite number, or {BALANCED!r}.", param, ctx)
        return number


class _NumberOr(click.ParamType):
    """A number, or one word."""

    def __init__(self, word: str) -> None:
        self.word, self.name = word, f"number|{word}"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == self.word:
            return value
        try:
            return float(value)
        except (TypeError, ValueError, OverflowError):
            self.fail(f"{shown(value)} is neither a number nor {self.word!r}.", param, ctx)


class FileName(click.Path):
    """The name of a file or a folder; an empty one would stand for the current folder."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: D102 (click's)
        if not str(value) or "\0" in str(value):
            self.fail(f"{str(value)!r} is no name; expected that of a file.", param, ctx)
        return super().convert(value, param, ctx)


class OutputName(FileName):
    """The name of what is to be written."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: D102 (click's)
        path = super().convert(value, param, ctx)
        ends = tuple(separator for separator in (os.sep, os.altsep) if separator)
        files = {ending for format in FORMATS.values() for ending in format.endings if ending}
        if str(value).endswith(ends) and path.suffix.lower() in files:
            self.fail(
                f"{str(value)!r} names a folder, but {path.suffix} is the ending of a file; leave "
                f"out the {str(value)[-1]!r} or the ending.",
                param,
                ctx,
            )
        return path


#: Bytes of the unit in which the command line takes memory.
GIGABYTE = 1e9


class _Gigabytes(click.ParamType):
    """A number of gigabytes."""

    name = "GB"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not 0 < number < 1e9:
            self.fail(f"{shown(value)}: expected gigabytes, such as 4.", param, ctx)
        return number


def for_library(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of the command line as `clmorph.morph` takes them.

    Parameters
    ----------
    settings : mapping
        By the names of `clmorph.morph`.
    """
    options = dict(settings)
    if "max_memory" in options:
        options["max_memory"] *= GIGABYTE
    if options.get("log_threshold") == RELATIVE:
        del options["log_threshold"]
    return options


def _together(*decorators: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Return decorators as one, the first on top."""

    def decorate(command: Command) -> Command:
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorate


def _option(panel: str, *names: str, **settings: Any) -> Callable[[Command], Command]:
    return click.option(*names, panel=panel, **settings)


problem_options = _together(
    _option("Transport", "--size", type=int, help="Reduce pictures to this longer side, pixels."),
    _option("Transport", "--blur", type=float, help="Entropic length scale, in image sides."),
    _option(
        "Transport",
        "--reach",
        type=_Reach(),
        help="How far mass moves before it rather fades, in image sides; or balanced; two "
        "(source,target) may differ.",
    ),
    _option("Transport", "--epsilon", type=float, help="The square of blur, in its place."),
    _option("Transport", "--rho", type=_Reach(), help="The square of reach, in its place."),
    _option("Transport", "--color-weight", type=float, help="Weight of color against position."),
    _option(
        "Transport",
        "--color-space",
        type=click.Choice(COLOR_SPACES),
        help="In which colors are compared.",
    ),
    _option("Transport", "--mass", type=click.Choice(MASSES), help="What a pixel weighs."),
    _option(
        "Transport",
        "--extent",
        type=click.Choice(EXTENTS),
        help="True aspect ratio, or both axes stretched to the unit square.",
    ),
    _option(
        "Transport", "--tol", type=float, help="Residual at which the solver stops, in epsilons."
    ),
    _option(
        "Transport", "--max-iter", type=int, help="Iterations after which it stops all the same."
    ),
    _option(
        "Transport",
        "--solve-size",
        type=int,
        help="Solve between cells of pixels, so many along the longer side; draw with pixels.",
    ),
    _option(
        "Transport",
        "--max-particles",
        type=int,
        help="If the plan has more pairs, about so many are drawn from it.",
    ),
    _option(
        "Transport",
        "--max-memory",
        type=_Gigabytes(),
        help="Gigabytes; if the plan needs more, fewer particles are drawn.  [default: half of "
        "the device's]",
    ),
    _option(
        "Transport",
        "--log-threshold",
        type=_NumberOr(RELATIVE),
        help="Keep the plan's pairs with log pi above this (the paper's is -13), or those "
        "relative to the largest of their row or column.",
    ),
)

plan_options = _together(
    _option(
        "Transport", "--barycentric/--no-barycentric", is_flag=True, default=None,
        help="One particle a pixel.",
    ),
    _option(
        "Transport", "--sample", type=int, help="So many particles a pixel, drawn from the plan."
    ),
    _option("Transport", "--seed", type=int, help="Of these draws."),
)  # fmt: skip

drawing_options = _together(
    _option(
        "Drawing", "--splatting", type=click.Choice(SPLATTING),
        help="Kernel width: each particle's own (local), the paper's (adaptive), fixed, or none.",
    ),
    _option(
        "Drawing", "--sigma-start", type=_NumberOr("auto"),
        help="Kernel width at the start, in pixels.",
    ),
    _option(
        "Drawing", "--sigma-end", type=_NumberOr("auto"),
        help="Kernel width at the end, in pixels.",
    ),
    _option("Drawing", "--gamma", type=float, help="Its bulge in between (adaptive splatting)."),
    _option(
        "Drawing", "--sigma", type=click.Choice(["optimal"]), help="Find the widths instead; slow."
    ),
    _option(
        "Drawing", "--endpoints", type=click.Choice(ENDPOINTS),
        help="Ends exactly as the pictures, or through the kernel as in the paper.",
    ),
    _option(
        "Drawing", "--unmatched", type=click.Choice(UNMATCHED),
        help="Mass that does not move: drawn as it dies and is born, or left out.",
    ),
    _option(
        "Drawing", "--path-space", type=click.Choice(COLOR_SPACES),
        help="In which colors change on the way.",
    ),
)  # fmt: skip

motion_options = _together(
    _option(
        "Motion", "--frames", type=int,
        help=f"Frames of each morph, both ends included.  [default: {defaults.N_FRAMES}]",
    ),
    _option(
        "Motion", "--fps", type=float, help=f"Frames a second.  [default: {defaults.FPS:g}]"
    ),
    _option("Motion", "--duration", type=float, help="Seconds of one round, in place of --fps."),
    _option(
        "Motion", "--hold", type=float,
        help=f"Seconds that the pictures rest.  [default: {defaults.HOLD:g}]",
    ),
    _option(
        "Motion", "--ease", type=click.Choice(EASES),
        help="Even, slow at both ends (smooth), at the start (in) or the end (out).",
    ),
    _option("Motion", "--loop", type=click.Choice(LOOPS), help="What follows the last frame."),
    _option(
        "Motion", "--reverse/--no-reverse", is_flag=True, default=None,
        help="From the last to the first.",
    ),
)  # fmt: skip

file_options = _together(
    _option(
        "File", "-o", "--output", type=OutputName(),
        multiple=True,
        help="Where to, once or more; the ending says what: .gif .webp .apng .mp4 .webm .html, "
        ".png (contact sheet), .npz (NumPy), .tif; without one a folder of PNG frames.",
    ),
    _option(
        "File", "--format", type=click.Choice(list(FORMATS)), help="In place of the ending."
    ),
    _option(
        "File", "--canvas", metavar="dynamic|source|target|WxH",
        help="Size of the frames: each its own where the file can (dynamic, the default), or all "
        "alike.",
    ),
    _option(
        "File", "--scaling", type=click.Choice(SCALINGS),
        help="How frames are enlarged; auto: nearest for pixel art, smooth for the rest.",
    ),
    _option(
        "File", "--background", metavar="COLOR",
        help="Under what is transparent, and for bars: white, #204060 …",
    ),
    _option(
        "File", "--lossless/--no-lossless", is_flag=True, default=None, help="WebP without loss."
    ),
    _option(
        "File", "--recipe/--no-recipe", is_flag=True, default=None,
        help="Leave OUTPUT.json beside it, from which --config repeats the run.",
    ),
)  # fmt: skip

device_options = _together(
    _option(
        "Device", "--device", metavar="NAME",
        help="OpenCL device: an index (0:1) or part of a name.",
    ),
    _option(
        "Device", "--backend", metavar="NAME",
        help="auto, opencl, numpy, or what --device takes.  [default: auto]",
    ),
)  # fmt: skip

max_pixels_option = _option(
    "Transport", "--max-pixels", type=int,
    help=f"Refuse larger files.  [default: {MAX_PIXELS}]",
)  # fmt: skip
