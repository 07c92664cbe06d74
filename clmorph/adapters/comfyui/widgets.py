"""Inputs of nodes, made of clmorph's own options: one default, one range, one text for each."""

import tomllib
from collections.abc import Mapping
from typing import Any

from clmorph._shared.options import Options, specifications
from clmorph.errors import InputError
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.recipe import options_of

#: An input as ComfyUI wants it: its type, or a list of choices, and its settings.
Widget = tuple[Any, dict[str, Any]]

#: The least and the largest longer side that can be asked for; 0 keeps pictures whole.
SIDES = 0, 16384


def image(text: str) -> Widget:
    """Return an input for pictures."""
    return "IMAGE", {"tooltip": text}


def mask(text: str) -> Widget:
    """Return an input for a mask."""
    return "MASK", {"tooltip": text}


def real(default: float, low: float, high: float, text: str) -> Widget:
    """Return an input for a number."""
    settings = {"default": default, "min": low, "max": high, "step": 0.01, "round": False}
    return "FLOAT", settings | {"tooltip": text}


def whole(default: int, low: int, high: int, text: str) -> Widget:
    """Return an input for a whole number."""
    return "INT", {"default": default, "min": low, "max": high, "tooltip": text}


def line(default: str, text: str, *, multiline: bool = False) -> Widget:
    """Return an input for a text."""
    return "STRING", {"default": default, "multiline": multiline, "tooltip": text}


def option(kind: type[Options], name: str) -> Widget:
    """Return the input for an option of clmorph."""
    known = specifications(kind)[name]
    default, schema = getattr(kind, name), known.kind.schema
    if "enum" in schema:
        return list(schema["enum"]), {"default": default, "tooltip": known.help}
    text = f"{known.help} Unit: {known.unit}." if known.unit else known.help
    low = schema.get("minimum", schema.get("exclusiveMinimum"))
    if schema["type"] == "integer":
        return whole(default, low, schema["maximum"], text)
    return real(default, low, schema["maximum"], text)


FRAMES = whole(
    16, 1, 10_000, "Number of pictures between both, both included; with 1 the picture at `time`."
)
TIME = real(0.5, 0.0, 1.0, "With one frame: where between both pictures it is.")
SIZE = whole(512, *SIDES, "Pictures are reduced to this longer side in pixels; 0 keeps them whole.")
PRESET: Widget = (
    [AUTO, *PRESETS],
    {
        "default": AUTO,
        "tooltip": "What kind of pictures they are; auto looks at them. "
        + " ".join(f"{name}: {preset.help}." for name, preset in PRESETS.items()),
    },
)
DEVICE = line(
    "auto", "Where it is computed: auto, numpy, or an OpenCL device as `clmorph devices` lists it."
)
OPTIONS = line(
    "", "More options of clmorph, one a line as in its settings, such as: reach = 0.2",
    multiline=True,
)  # fmt: skip


def more_options(text: str, kind: type[Options]) -> dict[str, Any]:
    """Return the options in a text of TOML, by their names in Python."""
    try:
        settings: Mapping[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"options: {error}; expected lines such as reach = 0.2") from None
    return options_of(settings, "options", kind)


def verdict(text: str | None, kind: type[Options]) -> bool | str:
    """Return True, or what is wrong with options, as ComfyUI asks before it runs anything."""
    try:
        kind(**more_options(text or "", kind))
    except InputError as error:
        return str(error)
    return True
