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
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import MESSAGE, printable
from clmorph.measures.landmark_options import MAX_LANDMARKS
from clmorph.output.bounded import MAX_HEAD
from clmorph.output.html.encoding import Encoder
from clmorph.output.html.geometry import frame_boxes
from clmorph.output.html.scene import Scene, as_json

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
    parts = "\n".join(_resource(name) for name in SCRIPTS)
    style, script = "\n" + _resource("viewer.css"), f'\n(() => {{\n"use strict";\n{parts}}})();\n'
    slots = {
        "policy": (
            f"default-src 'none'; img-src data: blob:; style-src '{digest(style)}'; "
            f"script-src '{digest(script)}'; base-uri 'none'; form-action 'none'"
        ),
        "title": ascii_html(scene.title),
        "style": style,
        "script": script,
        "parameters": PARAMETERS + as_json("parameters", dict(scene.parameters)) + "</script>",
        "table": "".join(_rows({**scene.facts, **scene.parameters})),
    }
    # Only marks in the template are replaced, never marks inside the inserted text.
    for index, part in enumerate(re.split(r"\{\{(\w+)\}\}", _resource("viewer.html"))):
        if index % 2 and part == "frames":
            file.writelines(_frames(scene, max_bytes))
        else:
            file.write(slots[part] if index % 2 else part)


def _frames(scene: Scene, max_bytes: float) -> Iterator[str]:
    """Yield each frame as a data block, and at last the data that the script needs about them."""
    encoder = Encoder(len(scene.times), max_bytes)
    for kind, frame in encoder.encode(scene.frames):
        yield f'<script type="{kind}" class="frame">{frame}</script>\n'
    notes = [printable(note, MESSAGE) for note in (*scene.notes, encoder.note) if note]
    marks = scene.marks
    known = {
        "times": _numbers(scene.times, 12),
        "fps": float(scene.fps),
        "hold": float(scene.hold),
        "loop": scene.loop,
        "pixelated": bool(scene.pixelated),
        "alpha": encoder.alpha,
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
        "marks": marks
        and {
            "pairs": _numbers(marks.pairs, 9),
            "sizes": [[int(width), int(height)] for height, width in marks.shapes],
            "backwards": bool(marks.backwards),
            "most": MAX_LANDMARKS,
        },
    }
    text = as_json("scene", known)
    yield f'<script type="application/json" id="clmorph-scene">{text}</script>'


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
        yield f"<tr><th scope=row>{ascii_html(str(name))}</th><td>{ascii_html(shown)}</td></tr>\n"


def ascii_html(text: str) -> str:
    """Escape text from an unknown source for HTML: in ASCII, short, without control characters."""
    return escape(printable(text, MESSAGE)).encode("ascii", "xmlcharrefreplace").decode("ascii")


@cache
def _resource(name: str) -> str:
    return files("clmorph.output.html").joinpath(name).read_text(encoding="ascii")


def digest(text: str) -> str:
    """Return the hash by which a Content-Security-Policy permits an element."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def read_metadata(path: Path) -> str:
    """Return the text of the parameters in a page that `write_page` made; "" if there is none."""
    # The frames stand behind the parameters and are not read.
    with path.open("rb") as file:
        text = file.read(HEAD)
    start = text.find(PARAMETERS.encode())
    end = text.find(b"</script>", start)
    return text[start + len(PARAMETERS) : end].decode() if 0 <= start < end else ""
