"""Read the options that made a file out of its metadata."""

from pathlib import Path
from typing import Any

from clmorph._shared.printable import reason_of
from clmorph.errors import InputError
from clmorph.output.bounded import MAX_TEXT, UNREADABLE, from_text
from clmorph.output.formats.registry import FORMATS
from clmorph.output.metadata import MARK
from clmorph.output.picture import JPEG_START, read_jpeg

#: Number of bytes at the start of a file by which its format is recognized.
START = 64


def read_parameters(path: Path) -> dict[str, Any]:
    """Return the parameters in a file, a folder of frames or a recipe, or raise InputError."""
    if path.is_dir():
        path = min(path.glob("frame-*"), default=path)
        if path.is_dir():
            raise InputError(f"{path}: a folder without frames of clmorph; expected a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is not a file; expected one that clmorph has written")
    try:
        text = _metadata_text(path)
        found = from_text(text) if text else None
    except UNREADABLE as error:
        raise InputError(f"{path}: cannot be read ({reason_of(error)})") from None
    if not isinstance(found, dict) or MARK not in found:
        raise InputError(
            f"{path} holds no parameters of clmorph: expected a file that it has written"
        )
    return found


def _metadata_text(path: Path) -> str:
    """Return the metadata text of a file of any format."""
    with path.open("rb") as file:
        start = file.read(START)
    if start.lstrip().startswith(b"{"):
        with path.open("rb") as file:
            return file.read(MAX_TEXT + 1).decode()
    if start.startswith(JPEG_START):
        return read_jpeg(path)
    format = next((format for format in FORMATS.values() if format.matches(start)), None)
    if format is None:
        raise ValueError("it is not a kind of file that clmorph writes")
    return format.read_metadata(path)
