"""The metadata of files: the options that made them, as text."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clmorph._shared.printable import printable
from clmorph._shared.validation import shown
from clmorph.errors import InputError
from clmorph.output.bounded import MAX_HEAD, MAX_TEXT, BoundedFile

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile
    from PIL.PngImagePlugin import PngInfo

#: The first key of every metadata text, by which it is recognized, and the keyword of PNG's chunk.
MARK = "clmorph"
#: The tag of Exif and TIFF for a text about an image.
IMAGE_DESCRIPTION = 0x010E


def as_text(parameters: Mapping[str, Any]) -> str:
    """Return parameters as JSON in ASCII, or raise TypeError, ValueError or RecursionError."""
    text = json.dumps(dict(parameters), allow_nan=False)
    if len(text) > MAX_TEXT:
        raise ValueError(f"{len(text)} characters are too many: files hold at most {MAX_TEXT}")
    return text


def checked_parameters(parameters: Any) -> Mapping[str, Any]:
    """Return a caller's parameters for a file; InputError if JSON cannot represent them."""
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters={shown(parameters)}: expected a mapping that JSON takes")
    try:
        as_text(parameters)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"parameters: expected what JSON takes ({printable(str(error), 120)})"
        ) from None
    return parameters


def as_png_info(parameters: Mapping[str, Any]) -> "PngInfo":
    """Return parameters as a text chunk of PNG."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text(MARK, as_text(parameters))
    return info


def read_png(path: Path) -> str:
    """Return the metadata text of a PNG, animated or not."""
    from PIL.PngImagePlugin import PngImageFile

    with image_head(PngImageFile, path) as image:
        return str(image.info.get(MARK, ""))


@contextmanager
def image_head(reader: "type[ImageFile]", path: Path) -> Iterator["ImageFile"]:
    """Yield the image as Pillow reads it before its pixels, from at most `MAX_HEAD` bytes."""
    from PIL import Image

    try:
        with BoundedFile(path, in_all=MAX_HEAD) as file, reader(file) as image:
            yield image
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from None
