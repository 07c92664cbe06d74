"""Write the text of one HTML file, and read its parameters back."""

import base64
import hashlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import MESSAGE, printable
from clmorph._shared.threads import in_order
from clmorph._shared.typing import Array
from clmorph.errors import OutputError
from clmorph.measures.landmark_options import MAX_LANDMARKS
from clmorph.output.bounded import MAX_HEAD
from clmorph.output.html.scene import Curve, Field, Scene, as_json

if TYPE_CHECKING:
    from PIL.Image import Image

#: The limit of the size of all frames in a page, in bytes of text; a phone still opens such a page.
PAGE_BYTES = 100e6
#: Parts of the script in their order; each part can use the parts before it.
SCRIPTS = ("numbers", "frames", "player", "stage", "arrows", "charts", "marks", "viewer")
#: The text before the parameters. It occurs only once, because "<" is escaped in all other text.
PARAMETERS = '<script type="application/json" id="clmorph-parameters">'
#: The number of bytes within which the parameters end, because they stand near the start.
HEAD = 2 * MAX_HEAD
#: The largest distance from a whole number at which a time counts as whole.
WHOLE = 1e-9
#: The formats of frames, as Pillow calls them.
WEBP, PNG = "WEBP", "PNG"

#: Options of lossless WebP. With this effort files are a quarter smaller than PNG, at about 0.4
#: microseconds a pixel; the highest effort takes forty times as long and saves another 4 %.
LOSSLESS: dict[str, Any] = {"lossless": True, "quality": 80, "method": 4}
OPTIMAL: dict[str, Any] = {"optimize": True}
#: Qualities that are tried in turn where frames without loss would take too many bytes.
QUALITIES = (99, 95, 90, 80, 60)
#: Bytes that a frame without loss may take, as a multiple of its share: the first frames are often
#: the sharpest.
ADVANCE = 1.25
#: The longest side that WebP can have.
WEBP_SIDE = 16383


def page(scene: Scene, *, max_bytes: float = PAGE_BYTES) -> str:
    """Return the page as one text; see `write_page`."""
    file = io.StringIO()
    write_page(scene, file, max_bytes=max_bytes)
    return file.getvalue()


def write_page(scene: Scene, file: TextIO, *, max_bytes: float = PAGE_BYTES) -> None:
    """Write a page that plays a scene, frame by frame; its own policy lets it load nothing else."""
    parts = "\n".join(_resource(f"{name}.js") for name in SCRIPTS)
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
        "curves": [_plain(curve) for curve in scene.curves],
        "fields": [_plain(field) for field in scene.fields],
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


def _numbers(values: Array, digits: int = 5) -> Any:
    """Return numbers for JSON, rounded to `digits` significant digits."""
    rounded = [float(f"{value:.{digits}g}") for value in np.ravel(values)]
    return np.reshape(rounded, np.shape(values)).tolist()


def _plain(part: Curve | Field) -> dict[str, Any]:
    """Return a part of a scene for JSON."""
    return {
        name: value if isinstance(value, str | None) else _numbers(value)
        for name, value in vars(part).items()
    }


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


def frame_boxes(sizes: Sequence[tuple[int, int]], times: Array, extent: str = "true") -> Array:
    """Return (n, 4): width and height of each frame, borders included, and of the common square."""
    shapes = np.asarray(sizes, np.float64).reshape(-1, 2)
    whole = np.abs(times - np.round(times)) < WHOLE
    whole[[0, -1]] = True
    _, first = np.unique(np.round(times[whole], 9), return_index=True)
    anchors = np.flatnonzero(whole)[first]
    known = times[anchors], shapes[anchors]
    # Canvases grow by whole pixels, but their content moves smoothly.
    smooth = np.column_stack([np.interp(times, known[0], side) for side in known[1].T])
    per_unit = np.interp(times, known[0], known[1].max(axis=1) - 1)
    # Frames whose sizes are not those of a morph keep their own sizes.
    other = np.any(np.abs(smooth - shapes) > 1 + WHOLE, axis=1)
    smooth[other] = shapes[other]
    per_unit[other] = shapes[other].max(axis=1) - 1
    pitch = np.repeat(1 / np.maximum(per_unit, 1.0)[:, None], 2, axis=1)
    if extent == "unit":
        # The centers of the outer pixels stand on the borders of the square, whatever the number
        # of pixels between them.
        pitch *= np.maximum(smooth - 1, 0.0) / np.maximum(shapes - 1, 1.0)
        pitch[shapes == 1] = 1 / np.maximum(per_unit, 1.0)[np.nonzero(shapes == 1)[0]]
        unit = (shapes - 1) * pitch
    else:
        unit = per_unit[:, None] * pitch
    return np.concatenate(((shapes * pitch)[:, ::-1], unit[:, ::-1]), axis=1)


class Encoder:
    """Encodes `count` frames within `max_bytes` of text; from the first too large one with loss."""

    def __init__(self, count: int, max_bytes: float) -> None:
        from PIL import features

        self._count = count
        self._bytes_left = max_bytes
        self._max_bytes = max_bytes
        self._webp = bool(features.check("webp"))
        #: (height, width) of the frames so far, their qualities, and whether one has opacity.
        self.sizes: list[tuple[int, int]] = []
        self.qualities: list[int] = []
        self.alpha = False

    def encode(self, frames: Iterable[NDArray[np.uint8]]) -> Iterator[tuple[str, str]]:
        """Yield the media type and the Base64 of frames (H, W, 3 or 4); threads work ahead."""
        from PIL import Image

        pictures = (Image.fromarray(np.ascontiguousarray(frame)) for frame in frames)
        for picture, without_loss in in_order(self._first_try, pictures):
            yield self._within_share(picture, without_loss)

    def _is_webp(self, picture: "Image") -> bool:
        return self._webp and max(picture.size) <= WEBP_SIDE

    def _first_try(self, picture: "Image") -> str | None:
        """Return a frame without loss, unless an earlier one was encoded with loss."""
        if min(self.qualities, default=100) < 100:
            return None
        return _text(picture, *((WEBP, LOSSLESS) if self._is_webp(picture) else (PNG, OPTIMAL)))

    def _within_share(self, picture: "Image", without_loss: str | None) -> tuple[str, str]:
        webp = self._is_webp(picture)
        share = self._bytes_left / (self._count - len(self.sizes))
        qualities: list[int] = [100] if min(self.qualities, default=100) == 100 else []
        for quality in (*qualities, *(QUALITIES if webp else ())):
            if quality == 100:
                text, most = without_loss or "", min(self._bytes_left, ADVANCE * share)
            else:
                text, most = _text(picture, WEBP, {"quality": quality}), share
            if len(text) <= most:
                self._bytes_left -= len(text)
                self.sizes.append((picture.height, picture.width))
                self.qualities.append(quality)
                self.alpha = self.alpha or picture.mode == "RGBA"
                return f"image/{(WEBP if webp else PNG).lower()}", text
        raise OutputError(
            f"the page would take more than {self._max_bytes / 1e6:.3g} MB: use fewer or smaller "
            "frames, or write a .gif or a folder of frames"
        )

    @property
    def note(self) -> str | None:
        """A note for the reader if frames are compressed with loss; None otherwise."""
        lossy = [quality for quality in self.qualities if quality < 100]
        if not lossy:
            return None
        return (
            f"{len(lossy)} of {len(self.qualities)} frames are compressed with loss "
            f"(WebP, quality {min(lossy)} or better), so that this page stays within "
            f"{self._max_bytes / 1e6:.3g} MB."
        )


def _text(picture: "Image", form: str, options: dict[str, Any]) -> str:
    """Return a frame, encoded, in Base64."""
    file = io.BytesIO()
    picture.save(file, form, **options)
    return base64.b64encode(file.getbuffer()).decode("ascii")
