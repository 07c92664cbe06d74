"""The parameters of a run inside the files that it leaves, and out of them again."""

import json
import zipfile
import zlib
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clmorph.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Exif
    from PIL.PngImagePlugin import PngInfo

#: What a text says first, so that it is known for one of ours.
MARK = "clmorph"
#: What libraries raise for files that are damaged, or something else.
UNREADABLE = (
    OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, SyntaxError,
    NotImplementedError, RecursionError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
#: Exif and TIFF's tag for a text about an image.
IMAGE_DESCRIPTION = 0x010E


def as_text(parameters: Mapping[str, Any]) -> str:
    """Return parameters as JSON in ASCII."""
    return json.dumps(dict(parameters), allow_nan=False)


def as_png_info(parameters: Mapping[str, Any]) -> "PngInfo":
    """Return parameters as PNG's text chunk."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text(MARK, as_text(parameters))
    return info


def as_exif(parameters: Mapping[str, Any]) -> "Exif":
    """Return parameters as Exif's description."""
    from PIL import Image

    exif = Image.Exif()
    exif[IMAGE_DESCRIPTION] = as_text(parameters)
    return exif


def read_parameters(path: Path) -> dict[str, Any]:
    """Return the parameters that a file of ours was made with.

    Parameters
    ----------
    path : Path
        A file of any format that `clmorph.save` writes, or a folder of frames.

    Raises
    ------
    InputError
        If there are none.
    """
    if path.is_dir():
        stills = sorted(path.glob("frame-*"))
        if not stills:
            raise InputError(f"{path}: a folder without frames of clmorph; expected a file")
        path = stills[0]
    try:
        text = _reader(path)(path)
        found = json.loads(text) if text else None
    except UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read ({reason})") from None
    if not isinstance(found, dict) or MARK not in found:
        raise InputError(
            f"{path} holds no parameters of clmorph: expected a file that it has written"
        )
    return found


def _from_picture(path: Path) -> str:
    from PIL import Image

    try:
        picture = Image.open(path)
    except Image.DecompressionBombError as error:
        raise ValueError(error) from None
    with picture:
        if picture.format == "GIF":
            return bytes(picture.info.get("comment", b"")).decode("ascii", "replace")
        if picture.format == "PNG":
            return str(picture.info.get(MARK, ""))
        return str(picture.getexif().get(IMAGE_DESCRIPTION, ""))


def _from_video(path: Path) -> str:
    if find_spec("av") is None:
        raise ValueError('videos need the extra "video": pip install "clmorph[video]"')
    import av

    try:
        with av.open(str(path)) as movie:
            tags = {name.lower(): value for name, value in movie.metadata.items()}
    except av.error.FFmpegError as error:
        raise ValueError(error) from None
    return tags.get("comment", "")


def _from_archive(path: Path) -> str:
    import numpy as np

    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        return str(archive["parameters"])


def _from_page(path: Path) -> str:
    from clmorph.viewer import read_parameters as read_page

    return json.dumps(read_page(path))


def _from_json(path: Path) -> str:
    return path.read_text("utf-8")


def _reader(path: Path) -> Callable[[Path], str]:
    """Return what reads a file, by how it begins: names can be changed."""
    with path.open("rb") as stream:
        start = stream.read(64)
    if start[4:8] == b"ftyp" or start.startswith(b"\x1aE\xdf\xa3"):
        return _from_video
    if start.startswith(b"PK"):
        return _from_archive
    text = start.lstrip()
    if text.startswith(b"{"):
        return _from_json
    return _from_page if text[:9].lower() == b"<!doctype" else _from_picture
