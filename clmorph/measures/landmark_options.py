"""The option of landmarks: its values, and how a text or a CSV file is read."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clmorph._shared.option_kinds import Kind
from clmorph._shared.options import Options, option
from clmorph._shared.printable import reason_of
from clmorph._shared.validation import as_float, check_number, shown
from clmorph.errors import InputError

Point = tuple[float, float]
#: Pairs of corresponding points, ((x, y), (x', y')), in pixels of the two images.
Landmarks = Sequence[tuple[Point, Point]]
#: The value with which landmarks are found in the pictures.
AUTO = "auto"
#: What the option of landmarks may be: for more than two images a sequence for each pair of them.
Guide = Landmarks | Sequence[Landmarks] | Literal["auto"] | None
#: Largest number of landmarks: the work of the spline grows with its third power.
MAX_LANDMARKS = 256
#: Largest number of morphs that have landmarks of their own.
MAX_MORPHS = 256
#: Largest length of a file of landmarks, in characters.
MAX_FILE = 1 << 20
_EXPECTED = "pairs of points in pixels, such as [((120, 80), (131, 92))]"
_PLAINLY = "x,y:x',y' in pixels, such as 120,80:131,92, the name of a CSV file, or auto"


def check_guide(name: str, value: Any) -> Any:
    """Return the option of landmarks: "auto", pairs of points, or such pairs for several morphs.

    Of a chain of images there is a sequence for each image and its successor, and of a mix one for
    each two images in the order (1, 2), (1, 3), ..., (2, 3), ...
    """
    if isinstance(value, str) and value == AUTO:
        return AUTO
    rows = _parts(value)
    if rows is not None and is_for_several(rows):
        if len(rows) > MAX_MORPHS:
            raise InputError(
                f"{name}: landmarks of {len(rows)} morphs; expected {MAX_MORPHS} or fewer"
            )
        return tuple(check_landmarks(name, row) for row in rows)
    try:
        return check_landmarks(name, value)
    except InputError as error:
        raise InputError(f"{error}, or {AUTO!r}") from None


def is_for_several(value: Any) -> bool:
    """Return whether landmarks are those of several morphs: a sequence of sequences of pairs."""
    for row in _parts(value) or []:
        parts = _parts(row)
        if parts is None:
            return False
        if not parts:
            return True  # a morph without landmarks
        ends = _parts(parts[0]) or [None]
        return _parts(ends[0]) is not None
    return False


def check_landmarks(name: str, value: Any) -> tuple[tuple[Point, Point], ...]:
    """Return landmarks, pairs ((x, y), (x', y')), as tuples of finite numbers."""
    found: list[Any] = []
    rows = _parts(value)
    for k, row in enumerate(rows if rows is not None else [None]):
        ends = [_parts(end) or [] for end in _parts(row) or []]
        numbers = [[as_float(each) for each in end] for end in ends]
        usable = len(numbers) == 2 and all(
            len(end) == 2 and all(each is not None and abs(each) < 1e9 for each in end)
            for end in numbers
        )
        if not usable:
            which = "" if rows is None else f", entry {k + 1}"
            raise InputError(f"{name}={shown(value)}{which}: expected {_EXPECTED}")
        found.append(tuple((x, y) for x, y in numbers))
    if len(found) > MAX_LANDMARKS:
        raise InputError(f"{name}: {len(found)} pairs; expected at most {MAX_LANDMARKS}")
    return tuple(found)


def _parts(value: Any) -> list[Any] | None:
    """Return the entries of a list, a tuple or an array; None for anything else."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return list(value) if isinstance(value, list | tuple) else None


def read_landmarks(text: str) -> Any:
    """Return landmarks from a text: one or more x,y:x',y', the name of a CSV file, or "auto".

    A line of the file is ``x,y,x',y'``; empty lines, lines after ``#`` and a first line of names
    are left out. Pairs in a text are separated by spaces or semicolons. A text that is neither
    raises a ValueError; a file that cannot be read, or has other lines, an InputError.
    """
    if text == AUTO:
        return AUTO
    try:
        pairs = [
            tuple(tuple(map(float, end.split(","))) for end in pair.split(":"))
            for pair in text.replace(";", " ").split()
        ]
        return check_landmarks("landmarks", pairs or None)
    except (ValueError, InputError):
        if not text.lower().endswith((".csv", ".txt")):
            raise ValueError(text) from None
    try:
        with Path(text).open(encoding="utf-8-sig") as stream:
            content = stream.read(MAX_FILE + 1)
    except (OSError, ValueError) as error:
        raise InputError(f"{text}: landmarks cannot be read ({reason_of(error)})") from None
    if len(content) > MAX_FILE:
        raise InputError(f"{text}: larger than {MAX_FILE} characters: expected a line a landmark")
    found: list[tuple[list[float | None], list[float | None]]] = []
    titled = False
    for k, line in enumerate(content.splitlines()):
        cells = [cell.strip() for cell in line.split("#")[0].replace(";", ",").split(",")]
        numbers = [as_number(cell) for cell in cells]
        if cells == [""]:
            continue
        if not (found or titled or any(number is not None for number in numbers)):
            titled = True  # the first line may name the columns
            continue
        if len(numbers) != 4 or None in numbers:
            raise InputError(f"{text}, line {k + 1}: {shown(line)}: expected x,y,x',y' in pixels")
        found.append((numbers[:2], numbers[2:]))
    if not found:
        raise InputError(f"{text}: it holds no landmarks; expected lines x,y,x',y' in pixels")
    return check_landmarks("landmarks", found)


def as_number(text: str) -> float | None:
    """Return the number that a text means, or None."""
    try:
        return float(text)
    except ValueError:
        return None


_POINT_SCHEMA = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
_PAIR_SCHEMA = {"type": "array", "items": _POINT_SCHEMA, "minItems": 2, "maxItems": 2}
_PAIRS_SCHEMA = {"type": "array", "items": _PAIR_SCHEMA, "maxItems": MAX_LANDMARKS}
#: The kind of landmarks among options.
LANDMARKS = Kind(
    check_guide, _PLAINLY, "auto|x,y:x',y'|CSV", read_landmarks,
    {"anyOf": [
        {"const": AUTO}, _PAIRS_SCHEMA,
        {"type": "array", "items": _PAIRS_SCHEMA, "maxItems": MAX_MORPHS},
    ]},
    lambda value: value == AUTO or (
        isinstance(value, list) and not any(isinstance(each, str) for each in value)
    ),
    several=True, in_files="pairs of points in pixels, such as [[[120, 80], [131, 92]]], or 'auto'",
)  # fmt: skip

#: Largest weight of a feature, and largest number of features.
MAX_WEIGHT, MAX_FEATURES = 1e6, 6


def check_feature_weight(name: str, value: Any) -> float | tuple[float, ...]:
    """Return the weight of features: one number of at least 0, or one for each."""
    rows = _parts(value)
    if rows is None:
        return check_number(name, value, 0.0, MAX_WEIGHT)
    if not 1 <= len(rows) <= MAX_FEATURES:
        raise InputError(f"{name}={shown(value)}: expected one number, or up to {MAX_FEATURES}")
    return tuple(check_number(name, each, 0.0, MAX_WEIGHT) for each in rows)


def _read_weight(text: str) -> float | tuple[float, ...]:
    numbers = [float(part) for part in text.split(",")]
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


def _is_weight(value: Any) -> bool:
    parts = value if isinstance(value, list) else [value]
    return all(as_float(each) is not None for each in parts)


_WEIGHT_SCHEMA = {"type": "number", "minimum": 0.0, "maximum": MAX_WEIGHT}
#: The kind of the weights of features among options.
FEATURE_WEIGHT = Kind(
    check_feature_weight, "a number, or several joined by commas", "number|number,number,...",
    _read_weight,
    {"anyOf": [_WEIGHT_SCHEMA, {"type": "array", "items": _WEIGHT_SCHEMA, "minItems": 1,
                                "maxItems": MAX_FEATURES}]},
    _is_weight,
)  # fmt: skip


@dataclass(frozen=True, init=False)
class GuideOptions(Options):
    """Options that guide the transport."""

    landmarks: Guide = option(
        AUTO, LANDMARKS,
        "Points that correspond, each a point of A and its partner in B, in pixels of each picture "
        "as it is given; repeatable. What A shows at its point moves to the partner. auto: faces, "
        "or things in both pictures, if there are any; none: no points.",
        "Transport", unit="pixels", outside="landmark",
    )  # fmt: skip
    feature_weight: float | Sequence[float] = option(
        1.0, FEATURE_WEIGHT,
        "Weight of features in the cost: the distance in the picture that counts as much as a "
        "difference of 1; several values belong to one feature each.",
        "Transport", unit="image sides", word="",
    )  # fmt: skip
