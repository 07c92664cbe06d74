"""Options of the frames: kernel widths, ends, unmatched mass, colors on the way (paper, 3.3)."""

from dataclasses import dataclass
from typing import Literal

from clmorph._shared.option_kinds import choice, number, number_or
from clmorph._shared.options import Options, option
from clmorph.images.color import ColorSpace

#: The rules by which particles become pixels: each particle has a kernel width that depends on the
#: density around it; all have the width of Eq. 4; all have sigma_start at all times; or each
#: particle is given to its nearest pixel. The last two are the paper's baselines.
Splatting = Literal["local", "adaptive", "fixed", "none"]
#: Rules whose width has the bulge gamma. Each of them, and "local", accepts sigma="optimal".
BULGING = ("adaptive",)
#: The rules for the first and the last frame: they are the images themselves, or the images
#: smoothed by the kernel as in the paper.
Endpoints = Literal["exact", "paper"]
#: The rules for mass that does not travel: it is drawn as it dies and is born in its place, or as
#: it shrinks into and grows out of the nearest mass that travels; or it is left out.
Unmatched = Literal["fade", "grow", "drop"]
#: What draws a frame: both pictures in motion, one of which is seen at each place; their blocks,
#: which move as wholes; whole pixels of sprites; or the particles alone, as in the paper.
Detail = Literal["layers", "cells", "pixels", "particles"]
#: A kernel width in pixels, or "auto": half the smallest detail of the image.
Sigma = float | Literal["auto"]

#: A kernel width in pixels, and the same or "auto".
WIDTH = number(1e-3, 1e4)
_WIDTH = number_or("auto", WIDTH)
#: The default height of the bulge of Eq. 4.
GAMMA = 0.5
#: Who draws the detail by default, and the former names of these layers.
LAYERS = ("layers", "carried", "shapes")


@dataclass(frozen=True, init=False)
class RenderOptions(Options):
    """Options of the frames."""

    detail: Detail = option(
        "layers", choice(Detail, dict.fromkeys(LAYERS[1:], "layers")),
        "What draws a frame: both pictures in motion, one of which is seen at each place (layers); "
        "their blocks, which move as wholes (cells); whole pixels of sprites (pixels); or the "
        "particles alone, as in the paper (particles), which options of their kernel below imply.",
        "Drawing", word="",
    )  # fmt: skip
    splatting: Splatting = option(
        "local", choice(Splatting),
        "Kernel width: each particle's own (local), that of the paper's Eq. 4 (adaptive), "
        "sigma-start throughout (fixed), or no kernel (none).",
        "Drawing", word="",
    )  # fmt: skip
    sigma_start: Sigma = option(
        "auto", _WIDTH,
        "Kernel width at the start; auto: half the smallest detail of the first picture.",
        "Drawing", unit="pixels", word="",
    )  # fmt: skip
    sigma_end: Sigma = option(
        "auto", _WIDTH,
        "Kernel width at the end; auto: half the smallest detail of the last picture.",
        "Drawing", unit="pixels", word="",
    )  # fmt: skip
    gamma: float | None = option(
        None, number(0.0, 1e4),
        f"Height of the bulge of the kernel width at t = 1/2 (adaptive splatting: {GAMMA}).",
        "Drawing", unit="pixels",
    )  # fmt: skip
    sigma: Literal["optimal"] | None = option(
        None, choice(Literal["optimal"]),
        "Find the kernel widths whose frames are nearest to the particles; this is slow.",
        "Drawing",
    )  # fmt: skip
    endpoints: Endpoints = option(
        "exact", choice(Endpoints),
        "The first and the last frame are the pictures exactly, or the pictures seen through the "
        "kernel as in the paper.",
        "Drawing", word="",
    )  # fmt: skip
    unmatched: Unmatched = option(
        "fade", choice(Unmatched),
        "Draw mass that does not move as it dies and is born in its place (fade), as it shrinks "
        "into and grows out of the nearest mass that moves (grow), or leave it out (drop).",
        "Drawing", word="",
    )  # fmt: skip
    path_space: ColorSpace = option(
        "oklab", choice(ColorSpace), "Color space in which colors change on the way.", "Drawing",
        word="",
    )  # fmt: skip
