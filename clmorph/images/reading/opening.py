"""Open image files by Pillow without decoding them, so that the size is known.

No global state is changed. Pillow's plugins are called directly instead of `PIL.Image.open`, whose
check of the size depends on a global variable. The size is checked here instead.
"""

import io
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from PIL import Image

from clmorph._shared.printable import printable
from clmorph.errors import FileError

#: Formats that Pillow reads, those with unambiguous signatures first. Not read are formats that run
#: other programs (EPS, WMF), that have no decoder (stubs), or that contain images of other formats
#: (ICNS); tifffile reads TIFF.
FORMATS = (
    "PNG", "JPEG", "WEBP", "GIF", "AVIF", "JPEG2000", "ICO", "BMP", "QOI", "PSD", "DDS",
    "SGI", "PPM", "DIB", "PCX",
)  # fmt: skip
#: Endings of TGA, which has no signature and is recognized by the name of the file.
TGA_ENDINGS = (".tga", ".icb", ".vda", ".vst")
#: Largest number of characters of a library's error in a message.
REASON_LENGTH = 120
#: Kinds of files that are not read but named in the error message, with the offset of their
#: signatures and the signatures.
_UNREAD = (
    ("a HEIC picture", 4, (b"ftyphei", b"ftyphev", b"ftypmif1", b"ftypmsf1")),
    ("a JPEG XL picture", 0, (b"\xff\x0a", b"\0\0\0\x0cJXL ")),
    ("a PDF document", 0, (b"%PDF",)),
    ("an SVG drawing", 0, (b"<svg",)),
    ("an XML document, such as SVG", 0, (b"<?xml",)),
    ("a GIMP picture", 0, (b"gimp xcf",)),
    ("an OpenEXR picture", 0, (b"v/1\x01",)),
    ("a Radiance picture", 0, (b"#?RADIANCE", b"#?RGBE")),
)
#: What Pillow says of valid files that it does not read.
_UNSUPPORTED = re.compile(
    "unsupported|not supported(?! between)|unimplemented|unknown (TGA|PCX|pixel)|not a TGA file",
    re.IGNORECASE,
)
#: Largest number of scans of a progressive JPEG. Each scan processes all pixels; encoders write
#: about ten.
MAX_SCANS = 64
#: Number of scans that are accepted for any picture within the limit of pixels.
_ORDINARY_SCANS = 16
#: Number of pixels in all scans together that is always accepted.
MAX_SCANNED = 1 << 30


_XMP_ORIENTATION = re.compile(rb"tiff:Orientation(?:=\"|>)([1-8])")


class UnsupportedError(Exception):
    """A valid file of a kind that is not read; the message continues "<name of the file>"."""


def unsupported_reason(error: Exception) -> str:
    """Return what a decoder does not support of a valid file, or "" if the file is damaged."""
    told = printable(str(error), REASON_LENGTH)
    if "MAX_TEXT_CHUNK" in told:
        return "it holds a text or a color profile of more than 1 MB"
    return told if isinstance(error, NotImplementedError) or _UNSUPPORTED.search(told) else ""


def xmp_orientation(xmp: bytes) -> int:
    """Return the orientation in XMP data, 1 to 8; 1 if there is none."""
    found = _XMP_ORIENTATION.search(xmp)
    return int(found[1]) if found else 1


def check_size(file: Path, size: tuple[int, int], max_pixels: int) -> None:
    """Raise FileError if a picture has too many pixels, or none."""
    width, height = size
    if width < 1 or height < 1:
        raise ValueError("it has no pixels")
    if width * height > max_pixels:
        raise FileError(
            f"{file} has {width} x {height} pixels: expected at most {max_pixels} in "
            "all; reduce it, or raise the limit (--max-pixels, max_pixels)"
        )


def open_picture(file: Path, stream: IO[bytes], max_pixels: int) -> Any:
    """Return a Pillow image that is not decoded yet, after a check of its size."""
    stream.seek(0)
    start = stream.read(64)
    fault = ""
    # Most files have one of the few formats that `preinit` loads; loading all formats is slow.
    for load in (Image.preinit, Image.init):
        load()
        for name in FORMATS + (("TGA",) if file.suffix.lower() in TGA_ENDINGS else ()):
            accepted = _accepts(name, start, unsigned=True)
            if isinstance(accepted, str):  # this build of Pillow lacks the codec
                fault = printable(accepted, REASON_LENGTH)
            elif accepted:
                return _opened(name, file, stream, max_pixels)
    kind = _unread_kind(start)
    found = f"{kind}, which is not read" if kind else "not an image that is read"
    expected = fault or "expected a PNG, JPEG or similar"
    raise FileError(f"{file} is {found}; {expected}; convert it to PNG")


def _opened(name: str, file: Path, stream: IO[bytes], max_pixels: int) -> Any:
    """Open a file by the plugin of a format."""
    stream.seek(0)
    if name in ("BMP", "DIB"):  # Pillow reads run lengths byte by byte
        stream = io.BytesIO(stream.read())
    if name == "ICO":
        picture = _open_icon(file, stream, max_pixels)
    else:
        picture = Image.OPEN[name][0](stream, str(file))
    check_size(file, picture.size, max_pixels)
    if name == "JPEG":
        _check_scans(file, stream, picture.size, max_pixels)
    return picture


def _accepts(name: str, start: bytes, unsigned: bool = False) -> bool | str:
    """Return a plugin's answer to a file's first bytes; `unsigned` if it knows no signature."""
    if name == "AVIF" and b"avi" not in start:  # HEIC uses the same container
        return False
    factory, accept = Image.OPEN.get(name, (None, None))
    if factory is None or accept is None:
        return factory is not None and unsigned
    try:
        return accept(start)
    except (IndexError, struct.error):
        return False


def _unread_kind(start: bytes) -> str:
    """Return the kind of a file that is not read, or "" if it is unknown."""
    for kind, place, marks in _UNREAD:
        if start[place:].startswith(marks):
            return kind
    for name in Image.OPEN:
        if name not in FORMATS and _accepts(name, start) is True:
            return f"a file of the kind {name}"
    return ""


def _open_icon(file: Path, stream: IO[bytes], max_pixels: int) -> Any:
    """Check the size of an icon's largest picture, then open it; Pillow decodes it immediately."""
    from PIL.IcoImagePlugin import IcoFile

    icon = IcoFile(stream)
    if not icon.entry:
        raise ValueError("it holds no picture")
    entry: Any = icon.entry[0]
    stream.seek(entry["offset"] if isinstance(entry, dict) else entry.offset)
    start = stream.read(24)
    if start.startswith(b"\x89PNG"):
        check_size(file, struct.unpack(">II", start[16:24]), max_pixels)
    else:  # a bitmap with its mask below it
        width, height = struct.unpack("<ii", start[4:12])
        check_size(file, (width, abs(height) // 2), max_pixels)
    return icon.frame(0)


def _check_scans(file: Path, stream: IO[bytes], size: tuple[int, int], max_pixels: int) -> None:
    """Raise FileError if a JPEG has more scans than encoders write, or would take too long."""
    place = stream.tell()
    stream.seek(0)
    scans = sum(marker == 0xDA for marker in _markers(stream))
    stream.seek(place)
    most = max(MAX_SCANNED, _ORDINARY_SCANS * max_pixels) // (size[0] * size[1])
    if scans > 1 and scans > min(most, MAX_SCANS):
        counted = f"more than {MAX_SCANS}" if scans > MAX_SCANS else str(scans)
        raise FileError(
            f"{file} is a progressive JPEG of {counted} scans: expected at most "
            f"{min(most, MAX_SCANS)} of {size[0]} x {size[1]} pixels; save it as a plain JPEG "
            "or as PNG"
        )


def _markers(stream: IO[bytes]) -> Iterator[int]:
    """Yield the markers of a JPEG up to its end; few files have more than a hundred."""
    data = stream.read()
    place, scans = 2, 0
    while scans <= MAX_SCANS:
        place = data.find(b"\xff", place)
        if place < 0 or place + 4 > len(data):
            return
        marker = data[place + 1]
        if marker == 0xD9:
            return
        if marker == 0xFF:
            place += 1
        elif marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8:
            place += 2
        else:
            yield marker
            scans += marker == 0xDA
            place += 2 + int.from_bytes(data[place + 2 : place + 4], "big")
