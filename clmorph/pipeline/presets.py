"""Presets: named sets of options for kinds of pictures.

A preset lists the options that differ from the defaults of `clmorph.pipeline.options.MorphOptions`.
These defaults are the preset "photo". The values of "paper" are those of the paper's section 4.
`AUTO` is no set of options: it chooses one by the kinds of the pictures (`preset_for`).
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple, get_args

from clmorph.images.kind import Kind

PresetName = Literal[
    "auto", "photo", "portrait", "logo", "pixel-art", "balanced", "mosaic", "crossfade", "paper"
]
#: The default of `clmorph.morph` and of ``clmorph morph``.
AUTO: PresetName = "auto"
AUTO_HELP = (
    "The pictures choose: pixel-art for sprites, logo for flat drawings (also beside sprites), and "
    "photo for all others."
)


#: The number of blocks along the longer side where each of them, or its outline, is seen.
FINE_BLOCKS = 128
#: What flat drawings and sprites have in common.
FLAT = {"mass": "foreground", "reach": math.inf, "blur": 0.02, "solve_size": FINE_BLOCKS}


class Preset(NamedTuple):
    """The options that differ from the defaults, by their names in Python, with a line of help."""

    help: str
    options: Mapping[str, Any]


PRESETS: dict[str, Preset] = {
    "photo": Preset(
        "For any two pictures: one of them is seen at each place, and ends are exact.", {}
    ),
    "portrait": Preset(
        "For faces in similar places: features stay where they are and change their colors.",
        {"color_weight": 0.15},
    ),
    "logo": Preset(
        "For logos and flat drawings: shapes become shapes, and the background stays.",
        FLAT | {"detail": "layers"},
    ),
    "pixel-art": Preset(
        "For sprites: whole pixels move, and blocks of enlarged sprites become pixels.",
        FLAT | {"detail": "pixels", "scaling": "nearest"},
    ),
    "balanced": Preset(
        "Nothing fades: all mass of one picture moves into the other, however far.",
        {"reach": math.inf},
    ),
    "mosaic": Preset(
        "Blocks of one picture move to their places in the other, and nothing is blended.",
        {"detail": "cells", "solve_size": FINE_BLOCKS},
    ),
    "crossfade": Preset(
        "Nothing moves: one picture fades into the other, for comparison.",
        {
            "reach": 0.001,
            "solve_size": FINE_BLOCKS,
            "detail": "particles",
            "splatting": "fixed",
            "sigma_start": 0.3,
            "extent": "unit",
            "landmarks": None,
        },
    ),
    "paper": Preset(
        "Follows the paper: its numbers, axes stretched to a square, its pruning threshold, and a "
        "blurred first and last frame; for pictures of about 48 pixels.",
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
            "landmarks": None,
        },
    ),
}
assert {AUTO, *PRESETS} == set(get_args(PresetName))


#: Largest values of options, and least tolerance, of a first look.
DRAFT: dict[str, int] = {"size": 96, "solve_size": 48, "max_particles": 100_000, "n_frames": 12}
DRAFT_TOL = 1e-2


def drafted(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that a first look changes from the given ones, with their values."""
    found: dict[str, Any] = {}
    for name, most in DRAFT.items():
        value = options.get(name)
        fewer = isinstance(value, int) and not isinstance(value, bool) and value < most
        found[name] = value if fewer else most
    tol = options.get("tol")
    found["tol"] = max(tol, DRAFT_TOL) if isinstance(tol, float) else DRAFT_TOL
    return found


def preset_for(kinds: Iterable[Kind]) -> PresetName:
    """Return the preset for pictures of some kinds (`clmorph.images.kind.kind_of`)."""
    found = set(kinds)
    if found == {"sprite"}:
        return "pixel-art"
    return "photo" if "photograph" in found else "logo"
