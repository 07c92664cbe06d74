"""The content of a page: frames, curves, arrows, parameters and notes."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.errors import InputError
from clmorph.output.options import FPS, PlaybackOptions


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A finite number for each frame, (n,); curves of equal units share one axis."""

    name: str
    unit: str
    values: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Field:
    """Arrows that travel along the morph, in the common frame."""

    #: (K, 2), the start of each arrow: x to the right, y down.
    positions: Array
    #: (K, 2), from the start of each arrow to its end.
    displacement: Array
    #: (K,), the mass that each arrow represents, in any unit; None if all are equal.
    weights: Array | None = None
    #: Morph times between which the arrows travel; they are drawn only then.
    begin: float = 0.0
    end: float = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Marks:
    """Landmarks of a morph, which the page shows on both pictures and lets its reader change."""

    #: (n, 2, 2), a point of the first picture and its partner in the second, in pixels of the
    #: pictures as they were given; n can be 0.
    pairs: Array
    #: (height, width) of the pictures as they were given.
    shapes: tuple[tuple[int, int], tuple[int, int]]
    #: Whether the first frame is the second picture.
    backwards: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A morph with all data that its page shows."""

    #: (H, W, 3) or (H, W, 4), each of its own size; colors are straight: not multiplied by opacity.
    #: Each frame is read once, in order, and not kept.
    frames: Sequence[NDArray[np.uint8]]
    #: Morph time of each frame, ascending: 0 to 1, or 0 to k for a chain of k morphs.
    times: Array
    fps: float = FPS
    #: Additional seconds for which the first and the last frame are shown.
    hold: float = PlaybackOptions.hold
    loop: str = "ping-pong"
    title: str = "Morph"
    #: Whether pixels are enlarged as squares when the page opens.
    pixelated: bool = False
    curves: Sequence[Curve] = ()
    #: At most one field for each morph of a chain.
    fields: Sequence[Field] = ()
    #: As `json.dumps` accepts them. The page shows them as a table, and `read_metadata` returns
    #: their text.
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    #: Further rows of the table, which are not read back.
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    #: Position of the frames in the common frame, as the measures were lifted.
    extent: str = "true"
    #: Shown under the picture.
    notes: Sequence[str] = ()
    #: For the morph of two pictures, which are the first and last frame; None if the page has none.
    marks: Marks | None = None


def as_json(name: str, value: Any) -> str:
    """Return JSON in plain ASCII without the tags that would end its element in a page."""
    try:
        text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"{name}: not JSON ({error}); expected str, finite numbers, bool, None, and lists and "
            "dicts of them"
        ) from None
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
