"""Options of the lift: how an image becomes a measure (paper, 2.3)."""

from dataclasses import dataclass
from typing import Literal, get_args

from clmorph._shared.option_kinds import choice, number
from clmorph._shared.options import Options, option
from clmorph.images.color import ColorSpace

#: Placement of pixels in the common frame: the longer side spans [0, 1] and the shorter one is
#: centered, or both sides span [0, 1] as in the paper.
Extent = Literal["true", "unit"]
EXTENTS = get_args(Extent)
#: Mass of a pixel before multiplication by opacity: the same for all pixels, its luminance (Y of
#: CIE 1931), or its opacity alone; or the same for all pixels before a transparent or flat
#: background (`clmorph.images.flat_colors.foreground`), whatever their opacity.
Mass = Literal["uniform", "luminance", "alpha", "foreground"]


@dataclass(frozen=True, init=False)
class LiftOptions(Options):
    """Options of `clmorph.lift`."""

    color_weight: float = option(
        0.5, number(0.0, 1e3),
        "Weight lambda of color distance against distance in the picture: a high one keeps "
        "colors and moves mass far, a low one keeps places and changes colors.",
        "Transport", unit="image sides per unit of a channel", word="",
    )  # fmt: skip
    color_space: ColorSpace = option(
        "srgb", choice(ColorSpace), "Color space in which the cost compares colors.", "Transport",
        word="",
    )  # fmt: skip
    mass: Mass = option(
        "uniform", choice(Mass),
        "Mass of a pixel: the same for all, or its luminance, both times opacity; its opacity "
        "alone (alpha); or the same for all before a transparent or flat background (foreground).",
        "Transport", word="",
    )  # fmt: skip
    extent: Extent = option(
        "true", choice(Extent),
        "Keep the true aspect ratio, or stretch both axes to the unit square as the paper does.",
        "Transport", word="",
    )  # fmt: skip
