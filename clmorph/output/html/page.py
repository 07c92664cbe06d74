"""Write the text of one HTML file, and read its parameters back."""

import base64
import hashlib
import io
import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from html import escape
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.validation import check_number
from clmorph.errors import InputError
from clmorph.measures.landmark_options import MAX_LANDMARKS
from clmorph.output.bounded import MAX_HEAD, from_text
from clmorph.output.html.encoding import Encoder
from clmorph.output.html.geometry import frame_boxes
from clmorph.output.html.scene import Marks, Scene, as_json

#: The limit of the size of all frames in a page, in bytes of text; a phone still opens such a page.
PAGE_BYTES = 100e6
#: Parts of the script in their order; each part can use the parts before it.
SCRIPTS = (
    "numbers.js",
    "frames.js",
    "player.js",
    "stage.js",
    "arrows.js",
    "charts.js",
    "marks.js",
    "viewer.js",
)
#: The text before the parameters. It occurs only once, because "<" is escaped in all other text.
PARAMETERS = '<script type="application/json" id="clmorph-parameters">'
#: The number of bytes within which the parameters end, because they stand near the start.
HEAD = 2 * MAX_HEAD


def page(scene: Scene, *, max_bytes: float = PAGE_BYTES) -> str:
    """Return the page as one text; see `write_page`."""
    file = io.StringIO()
    write_page(scene, file, max_bytes=max_bytes)
    return file.getvalue()


def write_page(scene: Scene, file: TextIO, *, max_bytes: float = PAGE_BYTES) -> None:
    """Write a page that plays a scene, frame by frame; its own policy lets it load nothing else."""
    max_bytes = check_number("max_bytes", max_bytes, 1.0, 1e12)
    for part in _parts(scene, max_bytes):
        file.write(part)


def _parts(scene: Scene, max_bytes: float) -> Iterator[str]:
    style, script = _style(), _script()
    slots = {
        "policy": (
            f"default-src 'none'; img-src data: blob:; style-src '{_digest(style)}'; "
            f"script-src '{_digest(script)}'; base-uri 'none'; form-action 'none'"
        ),
        "title": _ascii(scene.title),
        "style": style,
        "script": script,
        "parameters": PARAMETERS + as_json("parameters", dict(scene.parameters)) + "</script>",
        "table": "".join(_rows({**scene.facts, **scene.parameters})),
    }
    # Only marks in the template are replaced, never marks inside the inserted text.
    for index, part in enumerate(re.split(r"\{\{(\w+)\}\}", _resource("viewer.html"))):
        if index % 2 == 0:
            yield part
        elif part == "frames":
            yield from _frames(scene, max_bytes)
        else:
            yield slots[part]


def _frames(scene: Scene, max_bytes: float) -> Iterator[str]:
    """Yield each frame as a data block, and at last the data that the script needs about them."""
    encoder = Encoder(len(scene.times), max_bytes)
    alpha = False
    for encoded in encoder.encode(scene.frames):
        alpha = alpha or encoded.alpha
        yield f'<script type="{encoded.kind}" class="frame">{encoded.text}</script>\n'
    notes = [printable(note, MESSAGE) for note in (*scene.notes, encoder.note) if note]
    known = {
        "times": _numbers(scene.times, 12),
        "fps": float(scene.fps),
        "hold": float(scene.hold),
        "loop": scene.loop,
        "pixelated": bool(scene.pixelated),
        "alpha": alpha,
        "sizes": [[width, height] for height, width in encoder.sizes],
        "boxes": _numbers(frame_boxes(encoder.sizes, scene.times, scene.extent), 9),
        "curves": [
            {"name": curve.name, "unit": curve.unit, "values": _numbers(curve.values)}
            for curve in scene.curves
        ],
        "fields": [
            {
                "begin": float(field.begin),
                "end": float(field.end),
                "positions": _numbers(field.positions),
                "displacement": _numbers(field.displacement),
                "weights": None if field.weights is None else _numbers(field.weights),
            }
            for field in scene.fields
        ],
        "notes": notes,
        "marks": None if scene.marks is None else _marks(scene.marks),
    }
    text = as_json("scene", known)
    yield f'<script type="application/json" id="clmorph-scene">{text}</script>'


def _marks(marks: Marks) -> dict[str, Any]:
    """Return what the script needs about landmarks."""
    return {
        "pairs": _numbers(marks.pairs, 9),
        "sizes": [[int(width), int(height)] for height, width in marks.shapes],
        "backwards": bool(marks.backwards),
        "most": MAX_LANDMARKS,
    }


def _numbers(values: NDArray[np.float64], digits: int = 5) -> Any:
    """Return numbers for JSON, rounded to `digits` significant digits."""
    rounded = [float(f"{value:.{digits}g}") for value in np.ravel(values)]
    return np.reshape(rounded, np.shape(values)).tolist()


def _rows(parameters: Any) -> Iterator[str]:
    """Rows of the table of parameters."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from _rows(value)
            continue
        if isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
            # The table shows the first entry of each mapping, its name; the rest is for programs.
            firsts = (next(iter(dict(item).values()), "") for item in value)
            value = " → ".join(map(str, firsts))
        flat = value if isinstance(value, list | tuple) else [value]
        shown = ", ".join(
            part if isinstance(part, str) else json.dumps(part, ensure_ascii=False) for part in flat
        )
        yield f"<tr><th scope=row>{_ascii(str(name))}</th><td>{_ascii(shown)}</td></tr>\n"


def _ascii(text: str) -> str:
    """Escape text from an unknown source for HTML: in ASCII, short, without control characters."""
    return escape(printable(text, MESSAGE)).encode("ascii", "xmlcharrefreplace").decode("ascii")


@cache
def _resource(name: str) -> str:
    return files("clmorph.output.html").joinpath(name).read_text(encoding="ascii")


@cache
def _style() -> str:
    return "\n" + _resource("viewer.css")


@cache
def _script() -> str:
    parts = "\n".join(_resource(name) for name in SCRIPTS)
    return f'\n(() => {{\n"use strict";\n{parts}}})();\n'


def _digest(text: str) -> str:
    """Return the hash by which a Content-Security-Policy permits an element."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def read_parameters(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the parameters in a page that `write_page` made, without running its script."""
    try:
        # The frames stand behind the parameters and are not read.
        with Path(path).open("rb") as file:
            text = file.read(HEAD)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: cannot be read ({reason_of(error)}); expected a page of clmorph"
        ) from None
    start = text.find(PARAMETERS.encode())
    end = text.find(b"</script>", start)
    block = text[start + len(PARAMETERS) : end] if 0 <= start < end else b""
    try:
        parameters = from_text(block)
    except (ValueError, RecursionError):
        parameters = None
    if not isinstance(parameters, dict):
        raise InputError(f"{path}: it holds no parameters; expected a page that clmorph wrote")
    return parameters
