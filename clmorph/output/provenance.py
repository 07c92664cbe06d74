"""The parameters of a run inside the files that it leaves, and out of them again."""

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clmorph._shared.printable import reason_of
from clmorph.errors import InputError
from clmorph.output.bounded import MAX_HEAD, MAX_TEXT, UNREADABLE, BoundedFile, from_text

if TYPE_CHECKING:
    from PIL.Image import Exif
    from PIL.ImageFile import ImageFile
    from PIL.PngImagePlugin import PngInfo

#: What a text says first, so that it is known for one of ours.
MARK = "clmorph"
#: Exif and TIFF's tag for a text about an image.
IMAGE_DESCRIPTION = 0x010E
#: Pieces of a WebP, at most: one a frame, and some more.
MAX_PIECES = 1_000_000


def as_text(parameters: Mapping[str, Any]) -> str:
    """Return parameters as JSON in ASCII.

    Raises
    ------
    TypeError, ValueError, RecursionError
        If they are no JSON, or longer than files of ours may tell.
    """
    text = json.dumps(dict(parameters), allow_nan=False)
    if len(text) > MAX_TEXT:
        raise ValueError(f"{len(text)} characters are too many: files hold at most {MAX_TEXT}")
    return text


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

    Whatever the file holds, no more than some megabytes of it are read, and no pixels.

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
        path = min(path.glob("frame-*"), default=path)
        if path.is_dir():
            raise InputError(f"{path}: a folder without frames of clmorph; expected a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is not a file; expected one that clmorph has written")
    try:
        text = _reader(path)(path)
        found = from_text(text) if text else None
    except UNREADABLE as error:
        raise InputError(f"{path}: cannot be read ({reason_of(error)})") from None
    if not isinstance(found, dict) or MARK not in found:
        raise InputError(
            f"{path} holds no parameters of clmorph: expected a file that it has written"
        )
    return found


def _from_gif(path: Path) -> str:
    from PIL.GifImagePlugin import GifImageFile

    with _head(GifImageFile, path) as picture:
        return bytes(picture.info.get("comment", b"")).decode("ascii", "replace")


def _from_png(path: Path) -> str:
    from PIL.PngImagePlugin import PngImageFile

    with _head(PngImageFile, path) as picture:
        return str(picture.info.get(MARK, ""))


def _from_tiff(path: Path) -> str:
    from PIL.TiffImagePlugin import TiffImageFile

    with _head(TiffImageFile, path) as picture:
        return str(picture.getexif().get(IMAGE_DESCRIPTION, ""))


@contextmanager
def _head(reader: "type[ImageFile]", path: Path) -> Iterator["ImageFile"]:
    """Give what Pillow finds in a picture's first parts; pixels, however many, are not decoded."""
    from PIL import Image

    try:
        with BoundedFile(path, in_all=MAX_HEAD) as file, reader(file) as picture:
            yield picture
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from None


def _from_webp(path: Path) -> str:
    """Return the description in a WebP's Exif; Pillow would read all frames to reach it.

    Pieces as in RFC 9649, section 2.3: four letters, the length as 4 bytes, an even number of
    bytes.
    """
    from PIL import Image

    with path.open("rb") as file:
        if file.read(12)[8:] != b"WEBP":
            raise ValueError("it is of no kind that clmorph writes")
        for _ in range(MAX_PIECES):
            kind, length = struct.unpack("<4sI", file.read(8))
            if kind == b"EXIF":
                if length > MAX_HEAD:
                    raise ValueError(f"its parameters have more than {MAX_TEXT} characters")
                exif = Image.Exif()
                exif.load(file.read(length))
                return str(exif.get(IMAGE_DESCRIPTION, ""))
            file.seek(length + length % 2, 1)
    return ""


def _from_video(path: Path, container: str) -> str:
    if find_spec("av") is None:
        raise ValueError('videos need the extra "video": pip install "clmorph[video]"')
    import av

    try:
        # A stream, and one kind of file: what stands in it must not name others to be opened.
        with path.open("rb") as file, av.open(file, format=container) as movie:
            tags = {name.lower(): value for name, value in movie.metadata.items()}
    except av.error.FFmpegError as error:
        raise ValueError(error.strerror or error) from None
    return tags.get("comment", "")


def _from_mp4(path: Path) -> str:
    return _from_video(path, "mp4")


def _from_webm(path: Path) -> str:
    return _from_video(path, "webm")


def _from_archive(path: Path) -> str:
    from clmorph.output.formats.npz import Arrays

    with Arrays(path, max_bytes=MAX_HEAD) as arrays:
        return arrays.text("parameters")


def _from_page(path: Path) -> str:
    from clmorph.output.html import read_parameters as read_page

    return json.dumps(read_page(path))


def _from_json(path: Path) -> str:
    with path.open("rb") as file:
        return file.read(MAX_TEXT + 1).decode()


def _from_elsewhere(path: Path) -> str:
    raise ValueError("it is of no kind that clmorph writes")


#: What reads a file, by how it begins: names can be changed.
READERS: dict[bytes, Callable[[Path], str]] = {
    b"GIF8": _from_gif,
    b"\x89PNG": _from_png,
    b"II*\0": _from_tiff,
    b"MM\0*": _from_tiff,
    b"II+\0": _from_tiff,
    b"MM\0+": _from_tiff,
    b"RIFF": _from_webp,
    b"PK": _from_archive,
    b"\x1aE\xdf\xa3": _from_webm,
    b"{": _from_json,
    b"<!doctype": _from_page,
}


def _reader(path: Path) -> Callable[[Path], str]:
    """Return what reads a file."""
    with path.open("rb") as stream:
        start = stream.read(64)
    if start[4:8] == b"ftyp":  # after the length of this part
        return _from_mp4
    for begin, reader in READERS.items():
        if start.startswith(begin) or start.lstrip().lower().startswith(begin):
            return reader
    return _from_elsewhere
