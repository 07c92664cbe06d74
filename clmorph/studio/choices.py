"""What the page offers and what was chosen on it: options, the command line and the Python code.

The page sends texts as the command line takes them, by the options' names outside.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clmorph._shared.options import (
    Option,
    from_line,
    outside_name,
    specifications,
    to_outside,
    unknown_option,
)
from clmorph._shared.validation import as_float, shown
from clmorph.errors import InputError
from clmorph.measures.landmark_options import check_landmarks
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, AUTO_HELP, PRESETS

#: The options that stand first, each with what it does to the picture.
MAIN = {
    "blur": "Small: sharp and exact. Large: whole regions move together, softly.",
    "reach": "How far things may travel. What has no counterpart within it fades.",
    "color_weight": "High: colors stay and things travel far. Low: things stay and change color.",
    "size": "Pixels along the longer side of the morph. Larger takes longer.",
    "n_frames": "Number of frames. More are smoother.",
}
#: Ends of their sliders, in the unit outside, and whether a step multiplies.
SLIDERS = {
    "blur": (0.003, 0.3, True),
    "reach": (0.02, 2.0, True),
    "color_weight": (0.0, 4.0, False),
    "size": (16, 512, True),
    "n_frames": (2, 120, False),
}
#: Files that the page offers, by their endings.
DOWNLOADS = ("gif", "webp", "mp4", "html", "json")


@dataclass(frozen=True)
class Choices:
    """What is chosen on the page.

    Attributes
    ----------
    preset : str
    given : mapping
        Values by names in Python.
    device : str
        What `clmorph.get_backend` takes.
    """

    preset: str = AUTO
    given: Mapping[str, Any] = field(default_factory=dict)
    device: str = "auto"

    def options(self, recognized: str) -> MorphOptions:
        """Return all options; `recognized` is the preset that the pictures choose."""
        return MorphOptions(preset=self.named(recognized), **self.given)

    def named(self, recognized: str) -> str:
        """Return the name of the preset."""
        return recognized if self.preset == AUTO else self.preset


def controls() -> dict[str, Any]:
    """Return the description of all controls, for the page."""
    return {
        "presets": {AUTO: AUTO_HELP, **{name: each.help for name, each in PRESETS.items()}},
        "options": [
            _control(name, known)
            for name, known in specifications(MorphOptions).items()
            if not known.kind.several
        ],
        "downloads": list(DOWNLOADS),
    }


def _control(name: str, known: Option) -> dict[str, Any]:
    schema = known.kind.schema
    found: dict[str, Any] = {
        "name": outside_name(name, known), "help": MAIN.get(name, known.help), "unit": known.unit,
        "panel": known.panel, "word": known.word, "main": name in MAIN,
        "flag": not known.kind.metavar,
    }  # fmt: skip
    if "enum" in schema:
        found["choices"] = [*schema["enum"], *([known.word] if known.word else [])]
    if name in SLIDERS:
        low, high, multiplies = SLIDERS[name]
        whole = schema.get("type") == "integer"
        found["slider"] = {"low": low, "high": high, "multiplies": multiplies, "whole": whole}
    return found


def read_choices(asked: Any) -> Choices:
    """Return the choices that the page has sent.

    Parameters
    ----------
    asked : mapping
        ``preset``, ``device``, ``settings`` (texts by names outside, truth values for flags) and
        ``landmarks`` (pairs of points).

    Raises
    ------
    InputError
        If an option is unknown, or a value stands for nothing. The names of files are no values
        here, unlike on the command line.
    """
    if not isinstance(asked, Mapping) or not isinstance(asked.get("settings", {}), Mapping):
        raise InputError("settings: expected texts by the names of options")
    preset, device = asked.get("preset", AUTO), asked.get("device", "auto")
    if preset not in (AUTO, *PRESETS):
        raise InputError(f"preset={shown(preset)}: expected one of {', '.join((AUTO, *PRESETS))}")
    if not isinstance(device, str):
        raise InputError(f"device={shown(device)}: expected the name of a device")
    known = {
        outside_name(name, each): (name, each)
        for name, each in specifications(MorphOptions).items()
        if not each.kind.several
    }
    given: dict[str, Any] = {}
    for key, value in asked.get("settings", {}).items():
        if key not in known:
            raise InputError(unknown_option(key, known))
        name, each = known[key]
        given[name] = _value(key, each, value)
    marks = asked.get("landmarks") or ()
    if marks:
        given["landmarks"] = check_landmarks("landmarks", marks)
    return Choices(preset, given, device)


def _value(key: str, known: Option, value: Any) -> Any:
    flag = not known.kind.metavar
    if flag and isinstance(value, bool):
        return value
    if flag or not isinstance(value, str):
        raise InputError(f"{key}={shown(value)}: expected {known.kind.expected}")
    try:
        return from_line(known, value)
    except InputError as error:
        line = key.replace("_", "-")
        raise InputError(f"Invalid value for '--{line}': {error}") from None


def command_line(
    choices: Choices, recognized: str, names: Sequence[str], output: str = "morph.gif"
) -> str:
    """Return the command that writes the same file, in the folder of the pictures."""
    known = specifications(MorphOptions)
    words = ["clmorph", "morph", *(f"./{name}" if name[0] == "-" else name for name in names)]
    words += ["-o", output, "--preset", choices.named(recognized)]
    for name, value in choices.given.items():
        line = "--" + outside_name(name, known[name]).replace("_", "-")
        if isinstance(value, bool):
            words.append(line if value else f"--no-{line[2:]}")
            continue
        if name == "landmarks":
            for (x, y), (u, v) in value:
                words += [line, f"{x:g},{y:g}:{u:g},{v:g}"]
            continue
        text = _text(to_outside(known[name], value), name)
        words += [f"{line}={text}"] if text.startswith("-") else [line, text]
    if choices.device == "numpy":
        words += ["--backend", "numpy"]
    elif choices.device != "auto":
        words += ["--device", choices.device]
    return shlex.join(words)


def _text(value: Any, name: str) -> str:
    if isinstance(value, list):
        return ("x" if name == "canvas" else ",").join(_text(part, name) for part in value)
    number = as_float(value) if not isinstance(value, str) else None
    return str(value) if number is None else repr(value)


def python_code(
    choices: Choices, recognized: str, names: Sequence[str], output: str = "morph.gif"
) -> str:
    """Return the Python code that writes the same file, in the folder of the pictures."""
    given = [f"preset={choices.named(recognized)!r}"]
    given += [f"{name}={value!r}" for name, value in choices.given.items()]
    given += [f"backend={choices.device!r}"] if choices.device != "auto" else []
    return "\n".join(
        (
            "from itertools import pairwise",
            "from pathlib import Path",
            "",
            "import clmorph",
            "from clmorph.pipeline.recipe import picture_entries, recipe",
            "",
            f"files = [Path(name) for name in {list(names)!r}]",
            "pictures = [clmorph.read_image(file) for file in files]",
            f"given = dict({', '.join(given)})",
            "chain = [clmorph.morph(a, b, **given) for a, b in pairwise(pictures)]",
            "known = recipe(",
            "    chain[0].options, images=picture_entries(files),",
            "    device=chain[0].operations.description,",
            ")",
            f"clmorph.save(chain, {output!r}, parameters=known)",
            "",
        )
    )
