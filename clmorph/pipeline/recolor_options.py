"""All options of `clmorph.recolor`, which are also those of ``clmorph recolor``."""

from dataclasses import dataclass

from clmorph._shared.option_kinds import choice, integer, number
from clmorph._shared.options import Options, option
from clmorph.images.color import ColorSpace


@dataclass(frozen=True, init=False)
class RecolorOptions(Options):
    """All options of `clmorph.recolor`, by keywords.

    Parameters
    ----------
    **given
        Options, see `clmorph.recolor`.

    Raises
    ------
    InputError
        If an option is unknown, or its value cannot be used.

    Examples
    --------
    >>> from clmorph.pipeline.recolor_options import RecolorOptions
    >>> RecolorOptions(strength=0.5).strength
    0.5
    """

    strength: float = option(
        1.0, number(0.0, 1.0),
        "Strength of the change of colors: 0 keeps the picture, 1 changes it in full.",
        "Color", word="",
    )  # fmt: skip
    color_space: ColorSpace = option(
        "oklab", choice(ColorSpace), "Color space in which colors are compared and moved.",
        "Color", word="",
    )  # fmt: skip
    blur: float = option(
        0.1, number(0.01, 10.0),
        "Length scale below which neighboring colors stay together: a larger one changes colors "
        "more evenly, a smaller one matches the other picture's colors more exactly.",
        "Color", unit="units of a channel", word="",
    )  # fmt: skip
    reach: float | None = option(
        1.0, number(0.005, 1e6),
        "Length scale beyond which colors stay rather than move; a small one keeps colors that "
        "have no counterpart; balanced: the other picture's colors are taken in full.",
        "Color", unit="units of a channel", word="balanced",
    )  # fmt: skip
    feather: float = option(
        0.0, number(0.0, 1e4), "Width over which the edge of the mask is softened.", "Color",
        unit="pixels", word="",
    )  # fmt: skip
    reference_frame: int | None = option(
        None, integer(0, 1 << 31),
        "The frame of a clip, counted from 0, to which the colors are fitted; spread: 16 frames "
        "over the clip.",
        "Color", word="spread",
    )  # fmt: skip
