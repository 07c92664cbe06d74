"""The content of a page: frames, curves, arrows, parameters and notes."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import check_choice, check_number, shown
from clmorph.errors import InputError
from clmorph.measures.landmark_options import MAX_LANDMARKS
from clmorph.measures.options import EXTENTS
from clmorph.output.options import FPS, PlaybackOptions

#: The rules for the playback after the last frame.
LOOPS = ("loop", "ping-pong", "once")


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A finite number for each frame, (n,); curves of equal units share one axis."""

    name: str
    unit: str
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("name", "unit"):
            _check_text(f"a curve's {name}", getattr(self, name))
        values = _finite(f"curve {self.name!r}", self.values, "(n,)")
        if values.ndim != 1:
            raise InputError(f"curve {self.name!r} has shape {values.shape}: expected (n,)")
        object.__setattr__(self, "values", values)


@dataclasses.dataclass(frozen=True, eq=False)
class Field:
    """Arrows that travel along the morph, in the common frame."""

    #: (K, 2), the start of each arrow: x to the right, y down.
    positions: NDArray[np.float64]
    #: (K, 2), from the start of each arrow to its end.
    displacement: NDArray[np.float64]
    #: (K,), the mass that each arrow represents, in any unit; None if all are equal.
    weights: NDArray[np.float64] | None = None
    #: Morph times between which the arrows travel; they are drawn only then.
    begin: float = 0.0
    end: float = 1.0

    def __post_init__(self) -> None:
        for name in ("positions", "displacement"):
            array = _finite(f"the field's {name}", getattr(self, name), "(K, 2)")
            if array.ndim != 2 or array.shape[1] != 2:
                raise InputError(f"the field's {name} have shape {array.shape}: expected (K, 2)")
            object.__setattr__(self, name, array)
        count = len(self.positions)
        if len(self.displacement) != count:
            raise InputError(
                f"the field has {count} positions and {len(self.displacement)} displacements: "
                "expected one for each"
            )
        if self.weights is not None:
            weights = _finite("the field's weights", self.weights, f"({count},)")
            if weights.shape != (count,) or np.any(weights < 0):
                raise InputError(
                    f"the field's weights have shape {weights.shape}: expected ({count},), none "
                    "of them negative"
                )
            object.__setattr__(self, "weights", weights)
        begin = check_number("begin", self.begin, -1e9, 1e9)
        if check_number("end", self.end, -1e9, 1e9) <= begin:
            raise InputError(f"end={self.end!r}: expected a time after begin={self.begin!r}")


@dataclasses.dataclass(frozen=True, eq=False)
class Marks:
    """Landmarks of a morph, which the page shows on both pictures and lets its reader change."""

    #: (n, 2, 2), a point of the first picture and its partner in the second, in pixels of the
    #: pictures as they were given; n can be 0.
    pairs: NDArray[np.float64]
    #: (height, width) of the pictures as they were given.
    shapes: tuple[tuple[int, int], tuple[int, int]]
    #: Whether the first frame is the second picture.
    backwards: bool = False

    def __post_init__(self) -> None:
        pairs = _finite("the landmarks", self.pairs, "(n, 2, 2)")
        pairs = pairs.reshape(0, 2, 2) if not pairs.size else pairs
        if pairs.ndim != 3 or pairs.shape[1:] != (2, 2) or len(pairs) > MAX_LANDMARKS:
            raise InputError(
                f"the landmarks have shape {pairs.shape}: expected (n, 2, 2), n up to "
                f"{MAX_LANDMARKS}"
            )
        object.__setattr__(self, "pairs", pairs)
        sides = np.asarray(self.shapes)
        if sides.shape != (2, 2) or sides.dtype.kind not in "iu" or sides.min() < 1:
            raise InputError(f"shapes={shown(self.shapes)}: expected two of (height, width)")


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A morph with all data that its page shows."""

    #: (H, W, 3) or (H, W, 4), each of its own size; colors are straight: not multiplied by opacity.
    #: Each frame is read once, in order, and not kept.
    frames: Sequence[NDArray[np.uint8]]
    #: Morph time of each frame, ascending: 0 to 1, or 0 to k for a chain of k morphs.
    times: NDArray[np.float64]
    fps: float = FPS
    #: Additional seconds for which the first and the last frame are shown.
    hold: float = PlaybackOptions.hold
    loop: str = "ping-pong"
    title: str = "Morph"
    #: Whether pixels are enlarged as squares when the page opens.
    pixelated: bool = False
    curves: Sequence[Curve] = ()
    #: One field for each morph of a chain.
    field: Field | Sequence[Field] | None = None
    #: As `json.dumps` accepts them. The page shows them as a table, and `read_parameters` returns
    #: them.
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    #: Further rows of the table, which `read_parameters` does not return.
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    #: Position of the frames in the common frame, as the measures were lifted.
    extent: str = "true"
    #: Shown under the picture.
    notes: Sequence[str] = ()
    #: For the morph of two pictures, which are the first and last frame; None if the page has none.
    marks: Marks | None = None

    def __post_init__(self) -> None:
        times = _finite("times", self.times, "(n,)")
        if times.ndim != 1 or not len(times) or np.any(np.diff(times) < 0):
            raise InputError("times: expected (n,) ascending numbers, at least one")
        object.__setattr__(self, "times", times)
        if len(self.frames) != len(times):
            raise InputError(
                f"there are {len(self.frames)} frames and {len(times)} times: expected one each"
            )
        check_number("fps", self.fps, 0.01, 1000.0)
        check_number("hold", self.hold, 0.0, 3600.0)
        check_choice("loop", self.loop, LOOPS)
        check_choice("extent", self.extent, EXTENTS)
        _check_text("title", self.title)
        for note in self.notes:
            _check_text("a note", note)
        for curve in self.curves:
            if len(curve.values) != len(times):
                raise InputError(
                    f"curve {curve.name!r} has {len(curve.values)} values: expected one for each "
                    f"of the {len(times)} frames"
                )
        if not isinstance(self.parameters, Mapping):
            raise InputError(
                f"parameters is a {type(self.parameters).__name__}: expected a mapping, as a dict"
            )
        as_json("parameters", dict(self.parameters))

    @property
    def fields(self) -> tuple[Field, ...]:
        """The fields of arrows as a tuple, which may be empty."""
        if self.field is None:
            return ()
        return (self.field,) if isinstance(self.field, Field) else tuple(self.field)


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


def _check_text(name: str, value: Any) -> None:
    if not isinstance(value, str):
        raise InputError(f"{name} is a {type(value).__name__}: expected a str")


def _finite(name: str, values: Any, shape: str) -> NDArray[np.float64]:
    """Return an array of finite float64."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected an array {shape} of numbers") from None
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name}: expected finite numbers, without NaN and infinity")
    return array
