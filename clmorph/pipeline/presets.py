"""Presets: named sets of options for kinds of pictures.

A preset lists the options that differ from the defaults of `clmorph.pipeline.options.MorphOptions`.
These defaults are the preset "photo". The values of "paper" are those of the paper's section 4.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, get_args

PresetName = Literal["photo", "paper", "pixel-art", "crossfade", "balanced"]


class Preset(NamedTuple):
    """A preset.

    Attributes
    ----------
    help : str
        A description in one line.
    options : dict
        The options that differ from the defaults, by their names in Python.
    """

    help: str
    options: Mapping[str, Any]


PRESETS: dict[str, Preset] = {
    "photo": Preset("For any two pictures: sharp ends, no holes, colors that change.", {}),
    "paper": Preset(
        "Everything as in the paper: its numbers, axes stretched to a square, pruning threshold, "
        "and blurred first and last frame; for pictures of about 48 pixels.",
        {
            "size": 48,
            "solve_size": None,
            "max_particles": None,
            "blur": 0.05,
            "reach": 0.3,
            "color_weight": 2.0,
            "log_threshold": -13.0,
            "sigma_start": 1.2,
            "sigma_end": 0.5,
            "gamma": 0.5,
            "detail": "particles",
            "splatting": "adaptive",
            "endpoints": "paper",
            "path_space": "srgb",
            "extent": "unit",
            "unmatched": "drop",
        },
    ),
    "pixel-art": Preset(
        "For sprites: pixels stay pixels and move with their colors.",
        {
            "size": 64,
            "blur": 0.01,
            "color_weight": 1.0,
            "detail": "particles",
            "sigma_start": 0.3,
            "sigma_end": 0.3,
            "scaling": "nearest",
        },
    ),
    "crossfade": Preset(
        "Nothing moves: one picture fades into the other, to compare with.",
        {
            "reach": 0.001,
            "detail": "particles",
            "splatting": "fixed",
            "sigma_start": 0.3,
            "extent": "unit",
        },
    ),
    "balanced": Preset(
        "Nothing fades: all mass of one picture moves into the other, however far.",
        {"reach": math.inf},
    ),
}
assert set(PRESETS) == set(get_args(PresetName))
