"""The kinds of work that the page offers, each a tab of it: what it needs and how it is named."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

from clmorph._shared.options import Option, Options, outside_name, specifications, to_outside
from clmorph.pipeline.mixing.weights import MOST_IMAGES
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, AUTO_HELP, PRESETS
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recolor_options import RecolorOptions

#: Smallest number of pictures of any work, and largest in a tab.
MIN_PICTURES, MAX_PICTURES = 2, MOST_IMAGES
#: What painted regions can be, each with the number of pictures that have them: the first ones.
PAINTED = {"labels": 2, "mask": 1}
#: What each preset does, in a line.
PRESET_HELP = {AUTO: AUTO_HELP, **{name: each.help for name, each in PRESETS.items()}}
#: Formats of films, and of pictures, with the recipe, that the page offers by their endings.
FILMS, STILLS = ("gif", "webp", "mp4", "html", "json"), ("png", "json")


@dataclass(frozen=True)
class Kind:
    """A kind of work."""

    #: The command of the command line that does the same.
    name: str
    #: What the page calls it.
    title: str
    #: What the button says that begins it.
    action: str
    #: What it does, in a sentence.
    help: str
    #: The class of its options, in which its controls are described.
    options: type[Options]
    #: The options that stand first, each with what it does to the picture.
    main: Mapping[str, str]
    #: Ends of their sliders, in the unit outside, and whether a step multiplies.
    sliders: Mapping[str, tuple[float, float, bool]] = field(default_factory=dict)
    #: Largest number of pictures.
    most: int = MAX_PICTURES
    #: Endings of the files that the page offers.
    downloads: tuple[str, ...] = FILMS
    #: The name of the file, without its ending.
    output: str = "morph"
    #: Whether the result is a film, and not a picture.
    film: bool = True
    presets: bool = False
    #: Whether it shows a grid, whose sides are asked for.
    grid: bool = False
    #: Whether pairs of points can guide it.
    landmarks: bool = False
    #: What painted regions are, a key of `PAINTED`, or "" if nothing is painted.
    painted: str = ""

    def described(self) -> dict[str, Any]:
        """Return the description of the kind and of its controls, for the page."""
        return {
            "name": self.name, "title": self.title, "action": self.action, "help": self.help,
            "output": self.output, "downloads": list(self.downloads), "most": self.most,
            "landmarks": self.landmarks, "painted": self.painted, "grid": self.grid,
            "presets": PRESET_HELP if self.presets else {},
            "options": [
                self._control(name, known)
                for name, known in specifications(self.options).items()
                if not known.kind.several
            ],
        }  # fmt: skip

    def _control(self, name: str, known: Option) -> dict[str, Any]:
        schema = known.kind.schema
        found: dict[str, Any] = {
            "name": outside_name(name, known), "help": self.main.get(name, known.help),
            "unit": known.unit, "panel": known.panel, "word": known.word,
            "main": name in self.main, "flag": not known.kind.metavar,
            "usual": to_outside(known, getattr(self.options, name)),
        }  # fmt: skip
        if "enum" in schema:
            found["choices"] = [*schema["enum"], *([known.word] if known.word else [])]
        if name in self.sliders:
            low, high, multiplies = self.sliders[name]
            whole = schema.get("type") == "integer"
            found["slider"] = {"low": low, "high": high, "multiplies": multiplies, "whole": whole}
        return found


def painted_name(painted: str, name: str) -> str:
    """Return the name of the file of a picture's painted regions, such as ``a-labels.png``."""
    return f"{PurePath(name).stem}{painted_ending(painted)}.png"


def painted_ending(painted: str) -> str:
    """Return how the names of files with painted regions end, without the file's ending."""
    return f"-{painted}"


_MORPH_MAIN = {
    "blur": "Small: sharp and exact. Large: whole regions move together, softly.",
    "reach": "How far things may travel. What has no counterpart within it fades.",
    "color_weight": "High: colors stay and things travel far. Low: things stay and change color.",
    "size": "Pixels along the longer side. Larger takes longer.",
}
_FRAMES = {"n_frames": "Number of frames. More are smoother."}
_MORPH_SLIDERS = {
    "blur": (0.003, 0.3, True),
    "reach": (0.02, 2.0, True),
    "color_weight": (0.0, 4.0, False),
    "size": (16, 512, True),
    "n_frames": (2, 120, False),
}

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            "morph", "Morph", "Make the morph",
            "Things of one picture travel to those of the next one; one of both is seen at each "
            "place.",
            MorphOptions, _MORPH_MAIN | _FRAMES, _MORPH_SLIDERS,
            presets=True, landmarks=True, painted="labels",
        ),
        Kind(
            "rearrange", "Rearrange", "Rearrange the pixels",
            "The pixels of picture A, each with its own color, move so that they form picture B.",
            RearrangeOptions,
            {
                "color_weight": "High: the picture is met better. Low: pixels take shorter ways.",
                "size": "Pixels along the longer side. Larger takes longer.",
                **_FRAMES,
            },
            {name: _MORPH_SLIDERS[name] for name in ("color_weight", "size", "n_frames")},
            output="rearranged",
        ),
        Kind(
            "recolor", "Recolor", "Recolor the picture",
            "Picture A takes the colors of picture B, and everything stays in its place.",
            RecolorOptions,
            {
                "strength": "0 keeps the picture, 1 takes the colors of the other one in full.",
                "blur": "Small: every color moves for itself. Large: like colors stay alike.",
                "reach": "How far colors may change.",
            },
            {
                "strength": (0.0, 1.0, False),
                "blur": (0.01, 0.5, True),
                "reach": (0.05, 2.0, True),
            },
            most=2, downloads=STILLS, output="recolored", film=False, painted="mask",
        ),
        Kind(
            "mix", "Mix", "Make the mixes",
            "A sheet of pictures between two to eight pictures: a row, a triangle, or a grid with "
            "the pictures at its corners.",
            MorphOptions, _MORPH_MAIN,
            {name: ends for name, ends in _MORPH_SLIDERS.items() if name in _MORPH_MAIN},
            downloads=STILLS, output="mixes", film=False, presets=True, grid=True,
        ),
    )
}  # fmt: skip
