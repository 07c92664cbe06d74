"""Decode image files: bytes from anywhere to arrays of sRGB, in bounded time and memory.

Nothing global is changed, not for a moment: plugins of Pillow are opened by themselves, without
the check of size in `PIL.Image.open` that depends on a variable of the module, and the size is
checked here, before anything is decoded. Metadata are read by `clmorph.tags`, which does not warn.
"""

import io
import re
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clmorph import tags, tiff
from clmorph.errors import FileError
from clmorph.printable import printable
from clmorph.profiles import from_gamma, is_srgb, to_srgb

#: Formats of Pillow that are read, the unmistakable ones first. Left out are those that run other
#: programs (EPS, WMF), that decode nothing (stubs), or that hold other pictures (ICNS).
FORMATS = (
    "PNG", "JPEG", "WEBP", "GIF", "TIFF", "AVIF", "JPEG2000", "ICO", "BMP", "QOI", "PSD", "DDS",
    "SGI", "PPM", "DIB", "PCX",
)  # fmt: skip
#: A format without a signature: only names tell.
TGA_ENDINGS = (".tga", ".icb", ".vda", ".vst")
#: Characters that what a library says may take in a message.
_REASON_LENGTH = 120
#: Scans of a progressive JPEG, each of which is work for all its pixels; encoders write about ten.
MAX_SCANS = 64
#: Pixels of all scans together.
MAX_SCANNED = 1 << 30
_XMP_ORIENTATION = re.compile(rb"tiff:Orientation(?:=\"|>)([1-8])")
#: 16 bits of each sample, of which Pillow keeps the upper 8: most significant first, or last.
_DEEP = re.compile(r"(RGBX?|RGBA|RGBa|CMYK);16([BLN])")


class _Reader(io.BufferedReader):
    """A file that is never asked for more than it has: decoders ask for what its sizes say."""

    def __init__(self, file: Path) -> None:
        super().__init__(io.FileIO(file))
        self._end = self.seek(0, 2)
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._end - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


Decoded = tuple[NDArray[Any], list[str]]


def name_of(file: Path) -> str:
    """Return a file's name as messages show it."""
    return printable(file)


def reason_of(error: BaseException) -> str:
    """Return what an error of a library says, in one short line."""
    told = getattr(error, "strerror", None) or error
    text = " ".join(str(told).split()) or type(error).__name__
    return printable(text, _REASON_LENGTH)


def decode(file: Path, max_pixels: int) -> Decoded:
    """Decode the first picture of a file.

    Parameters
    ----------
    file : Path
    max_pixels : int
        A larger image is refused before it is decoded.

    Returns
    -------
    (H, W), (H, W, 3) or (H, W, 4) array
        sRGB as `clmorph.images.as_pixels` takes it; floats are not checked.
    list of str
        What is to be noted, as it would follow the name of the file and "has".

    Raises
    ------
    FileError
        If it is missing, too large, or of a kind that is not read.
    Exception
        Of any kind, if it is damaged: whatever its decoder raises.
    """
    with _Reader(file) as stream:
        if stream.read(4) in tiff.SIGNATURES:
            return _decode_tiff(file, stream, max_pixels)
        picture = _open(file, stream, max_pixels)
        with picture:
            return _decode_picture(file, picture)


def check_size(file: Path, size: tuple[int, int], max_pixels: int) -> None:
    """Raise FileError if a picture has too many pixels, or none."""
    width, height = size
    if width < 1 or height < 1:
        raise ValueError("it has no pixels")
    if width * height > max_pixels:
        raise FileError(
            f"{name_of(file)} has {width} x {height} pixels: expected at most {max_pixels} in "
            "all; reduce it, or raise the limit (--max-pixels, max_pixels)"
        )


def _open(file: Path, stream: IO[bytes], max_pixels: int) -> Any:
    """Return a Pillow image that is not decoded yet, its size checked."""
    from PIL import Image

    Image.init()
    stream.seek(0)
    start = stream.read(64)
    formats = FORMATS + (("TGA",) if file.suffix.lower() in TGA_ENDINGS else ())
    fault = "expected a PNG, JPEG or similar"
    for name in formats:
        factory, accept = Image.OPEN.get(name, (None, None))
        if factory is None:
            continue
        accepted = accept is None or _accepts(accept, start)
        if isinstance(accepted, str):  # this build of Pillow lacks it
            fault = reason_of(ValueError(accepted))
        elif accepted:
            stream.seek(0)
            if name == "ICO":
                picture = _open_icon(file, stream, max_pixels)
            else:
                picture = factory(stream, str(file))
            check_size(file, picture.size, max_pixels)
            if name == "JPEG":
                _check_scans(stream, picture.size[0] * picture.size[1])
            return picture
    raise FileError(f"{name_of(file)} is not an image that can be read; {fault}")


def _accepts(accept: Callable[[bytes], bool | str], start: bytes) -> bool | str:
    """Return what a plugin says to the first bytes of a file; too few can be a fault of its."""
    try:
        return accept(start)
    except (IndexError, struct.error):
        return False


def _open_icon(file: Path, stream: IO[bytes], max_pixels: int) -> Any:
    """Open the largest picture of an icon, its size checked: Pillow decodes it at once."""
    from PIL.IcoImagePlugin import IcoFile

    icon = IcoFile(stream)
    if not icon.entry:
        raise ValueError("it holds no picture")
    entry: Any = icon.entry[0]
    stream.seek(entry["offset"] if isinstance(entry, dict) else entry.offset)
    start = stream.read(24)
    if start.startswith(b"\x89PNG"):
        check_size(file, struct.unpack(">II", start[16:24]), max_pixels)
    else:  # a bitmap, its mask below it
        width, height = struct.unpack("<ii", start[4:12])
        check_size(file, (width, abs(height) // 2), max_pixels)
    return icon.frame(0)


def _check_scans(stream: IO[bytes], pixels: int) -> None:
    """Raise ValueError if a JPEG has more scans than encoders write, or than can be waited for."""
    place = stream.tell()
    stream.seek(0)
    scans = sum(marker == 0xDA for marker in _markers(stream))
    stream.seek(place)
    if scans > MAX_SCANS or (scans > 1 and scans * pixels > MAX_SCANNED):
        raise ValueError(
            f"it has {scans} scans: expected at most {MAX_SCANS}, fewer if it is large"
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


def _decode_tiff(file: Path, stream: IO[bytes], max_pixels: int) -> Decoded:
    """Decode the first full picture of a TIFF."""
    from PIL.TiffImagePlugin import TiffImageFile

    name = name_of(file)
    layout, page, more = tiff.open_page(stream, name, max_pixels)
    check_size(file, (layout.width, layout.height), max_pixels)
    notes = ["several pages: its first is taken"] if more else []
    if tiff.by_tifffile(layout):
        samples, turned = tiff.read_samples(file, page, layout), layout.orientation
    else:
        stream.seek(0)
        try:
            opened = TiffImageFile(stream, str(file))
            opened.seek(page)
        except SyntaxError as error:
            raise tiff.not_read(name, layout) from error
        with opened as picture:
            if picture.size not in ((layout.width, layout.height), (layout.height, layout.width)):
                raise ValueError("its tags contradict each other")
            if layout.bits <= 8:
                return _decode_picture(file, picture, layout.profile, notes)
            samples = _compressed_samples(file, picture, page, layout)
            turned = _rest_to_turn(picture)
    colors, alpha = tiff.interpret(name, samples, layout)
    return _finished(colors, alpha, layout.profile, turned, notes)


def _compressed_samples(file: Path, picture: Any, page: int, layout: tiff.Layout) -> NDArray[Any]:
    """Decode a TIFF of more than 8 bits by Pillow: (H, W, samples) array."""
    samples: NDArray[Any] | None = _deep_samples(picture, file, page)
    if samples is None and picture.mode in (*_GRAY_16, "F"):
        samples = np.asarray(picture)
        samples = samples / 4095.0 if layout.bits == 12 else samples
    if samples is None:
        raise tiff.not_read(name_of(file), layout)
    return samples.reshape(*samples.shape[:2], -1)


def _rest_to_turn(picture: Any) -> int:
    """Return the orientation of a TIFF that Pillow has decoded: newer versions turn it."""
    turned = picture.getexif().get(tags.ORIENTATION, 1)
    return turned if turned in range(1, 9) else 1


def _deep_samples(picture: Any, file: Path, page: int = 0) -> NDArray[np.uint16] | None:
    """Decode 16 bits a sample, of which Pillow would keep 8; None if it would not.

    It is told which byte of each to keep by the letter of the byte order: so it keeps the other
    one if told the wrong order.

    Parameters
    ----------
    picture : PIL.ImageFile.ImageFile
        Not decoded yet.
    file : Path
        To be opened once more.
    page : int
        Which of its pictures it is.

    Returns
    -------
    (H, W, 2 to 4) array or None
    """
    tiles = [_raw_mode(tile) for tile in picture.tile]
    if tiles == ["LA;16B"]:  # four bytes a pixel, as RGBA has
        picture.tile = [_with_raw_mode(tile, "RGBA") for tile in picture.tile]
        bytes_ = np.asarray(picture).astype(np.uint16)
        return np.asarray(bytes_[..., ::2] << 8 | bytes_[..., 1::2], np.uint16)
    if not tiles or not all(_DEEP.fullmatch(tile) for tile in tiles):
        return None
    upper = tiles[0][-1]
    upper = {"little": "L", "big": "B"}[sys.byteorder] if upper == "N" else upper
    with _Reader(file) as stream, type(picture)(stream, str(file)) as again:
        again.seek(page)
        halves = []
        for opened, letter in ((picture, upper), (again, "L" if upper == "B" else "B")):
            # RGBa would be divided by its opacity, half by half.
            opened.tile = [
                _with_raw_mode(tile, f"{_raw_mode(tile)[:-1].upper()}{letter}")
                for tile in opened.tile
            ]
            halves.append(np.asarray(opened).astype(np.uint16))
    return np.asarray(halves[0] << 8 | halves[1], np.uint16)


def _raw_mode(tile: Any) -> str:
    """Return how a part of a file is stored, as Pillow tells its decoder."""
    args = tile[3][0] if isinstance(tile[3], tuple) and tile[3] else tile[3]
    return args if isinstance(args, str) else ""


def _with_raw_mode(tile: Any, mode: str) -> Any:
    """Return a part of a file, stored in another way."""
    args = (mode, *tile[3][1:]) if isinstance(tile[3], tuple) else mode
    changed = (*tile[:3], args)
    return tile._make(changed) if hasattr(tile, "_make") else changed


def _decode_picture(
    file: Path, picture: Any, profile: bytes | None = None, notes: list[str] | None = None
) -> Decoded:
    """Decode what Pillow has opened."""
    notes = list(notes or [])
    kind = picture.format
    shown = picture.tile[0][1] if kind == "GIF" and picture.tile else None
    reduced = _is_reduced(picture)
    # The picture of an icon is a part of its file.
    deep = _deep_samples(picture, file) if kind == "PNG" and not _in_icon(file) else None
    if deep is not None:
        colors, alpha = _of_deep_png(deep, picture.info.get("transparency"))
    else:
        if reduced:
            notes.append("more than 8 bits a sample: they are reduced to 8")
        colors, alpha = _split(picture)
    if shown is not None and shown != (0, 0, *picture.size):
        # Around the first picture of an animation there is nothing yet.
        inside = np.zeros(picture.size[::-1], np.uint8)
        inside[shown[1] : shown[3], shown[0] : shown[2]] = 255
        alpha = inside if alpha is None else np.minimum(alpha, inside)
    turned = _rest_to_turn(picture) if kind == "TIFF" else _orientation(picture.info)
    profile = profile or picture.info.get("icc_profile")
    if kind == "PNG" and not profile and "srgb" not in picture.info:
        gamma, primaries = (picture.info.get(name) for name in ("gamma", "chromaticity"))
        pixels = colors if isinstance(colors, np.ndarray) else np.asarray(colors)
        colors, note = from_gamma(pixels, gamma, primaries)
        notes += [note] if note else []
    if _is_animated(picture):
        notes.append("several pictures: its first is taken")
    return _finished(colors, alpha, profile, turned, notes)


def _in_icon(file: Path) -> bool:
    with _Reader(file) as stream:
        return stream.read(4) == b"\0\0\1\0"


_GRAY_16 = ("I;16", "I;16B", "I;16L", "I;16N")
#: Of Pillow's formats, those that show one picture after the other.
_ANIMATED = ("GIF", "PNG", "WEBP", "AVIF")


def _is_reduced(picture: Any) -> bool:
    """Return whether Pillow keeps 8 bits of more."""
    for tile in picture.tile:
        most = tile[3][-1] if tile[0] == "ppm" else 0
        if ";16" in _raw_mode(tile) or tile[0] == "SGI16" or (isinstance(most, int) and most > 255):
            return picture.mode not in (*_GRAY_16, "I", "F")
    return False


def _is_animated(picture: Any) -> bool:
    try:
        return picture.format in _ANIMATED and bool(getattr(picture, "is_animated", False))
    except Exception:  # a damaged second picture, which is not asked for
        return False


def _of_deep_png(
    samples: NDArray[np.uint16], transparent: Any
) -> tuple[NDArray[np.uint16], NDArray[np.uint16] | None]:
    """Return the colors and the opacity of a PNG of 16 bits, not gray alone."""
    if samples.shape[2] == 2:
        return samples[..., 0], samples[..., 1]
    if samples.shape[2] == 4:
        return samples[..., :3], samples[..., 3]
    if isinstance(transparent, tuple):
        return samples, np.any(samples != transparent, axis=2) * np.uint16(65535)
    return samples, None


def _split(picture: Any) -> tuple[Any, NDArray[Any] | None]:
    """Return colors, and opacity if there is any, of a Pillow image.

    Colors are an image of mode L, RGB, CMYK or LAB, or an array of 16-bit or float gray.
    """
    tile = _raw_mode(picture.tile[0]) if picture.tile else ""
    picture.load()
    transparent = picture.info.get("transparency")
    if picture.mode in (*_GRAY_16, "I"):
        if picture.mode == "I" and picture.format not in ("PNG", "PPM"):
            raise ValueError("its samples are signed or of more than 16 bits")
        gray = np.clip(np.asarray(picture), 0, 65535).astype(np.uint16)
        if picture.format == "PNG" and isinstance(transparent, int):
            return gray, (gray != transparent) * np.uint16(65535)
        return gray, None
    if picture.mode == "F":
        return np.asarray(picture), None
    if picture.mode in ("CMYK", "LAB"):
        return picture, None
    if picture.mode in ("1", "L"):
        gray = picture.convert("L")
        if not isinstance(transparent, int):
            return gray, None
        # PNG counts in the levels that are stored, Pillow in 256.
        transparent *= {"L;2": 85, "L;4": 17}.get(tile, 1)
        return gray, (np.asarray(gray) != transparent) * np.uint8(255)
    if picture.mode == "RGB" and isinstance(transparent, tuple):
        return picture, np.any(np.asarray(picture) != transparent, axis=2) * np.uint8(255)
    if picture.mode in ("LA", "La", "PA", "RGBA", "RGBa") or (
        picture.mode == "P" and transparent is not None
    ):
        whole = picture.convert("LA") if picture.mode == "La" else picture
        whole = whole.convert("RGBA")
        return whole.convert("RGB"), np.asarray(whole.getchannel("A"))
    return picture.convert("RGB"), None


def _orientation(info: dict[Any, Any]) -> int:
    """Return how a picture lies, as its Exif tells, or its XMP."""
    exif = info.get("exif")
    raw = info.get("Raw profile type exif")
    if not exif and isinstance(raw, str):  # older versions of ImageMagick
        exif = bytes.fromhex("".join(raw.split("\n")[3:]))
    if isinstance(exif, bytes):
        turned = tags.exif_orientation(exif)
        if turned != 1:
            return turned
    xmp = info.get("xmp") or info.get("XML:com.adobe.xmp") or b""
    found = _XMP_ORIENTATION.search(xmp.encode() if isinstance(xmp, str) else bytes(xmp))
    return int(found[1]) if found else 1


def _finished(
    colors: Any, alpha: NDArray[Any] | None, profile: bytes | None, turned: int, notes: list[str]
) -> Decoded:
    """Return sRGB with opacity, as it is looked at.

    Parameters
    ----------
    colors : PIL.Image.Image or array
        Of mode L, RGB, CMYK or LAB; (H, W), (H, W, 3) or (H, W, 4), the last being CMYK.
    alpha : (H, W) array, optional
    profile : bytes, optional
    turned : int
        As Exif counts.
    notes : list of str
    """
    if isinstance(colors, np.ndarray):
        if profile and not is_srgb(profile) and _in_range(colors):
            if colors.dtype != np.uint8:
                notes = [*notes, "a color profile: 8 bits of its samples are kept to apply it"]
            colors, note = to_srgb(_as_picture(colors), profile)
            notes = [*notes, note] if note else notes
        elif colors.shape[2:] == (4,):
            colors = tiff.ink_to_rgb(colors)
    else:
        colors, note = to_srgb(colors, profile)
        notes = [*notes, note] if note else notes
    if alpha is not None:
        if colors.dtype != alpha.dtype:
            colors, alpha = _as_float(colors), _as_float(alpha)
        colors = np.dstack(
            (np.broadcast_to(colors.reshape(*alpha.shape, -1), (*alpha.shape, 3)), alpha)
        )
    return _turned(colors, turned), notes


def _in_range(colors: NDArray[Any]) -> bool:
    """Return whether floats are in [0, 1]; others are refused later."""
    return colors.dtype.kind == "u" or bool(np.all((colors >= 0) & (colors <= 1)))


def _as_float(values: NDArray[Any]) -> NDArray[Any]:
    return values if values.dtype.kind == "f" else values / float(np.iinfo(values.dtype).max)


def _as_picture(colors: NDArray[Any]) -> Any:
    """Return an array of samples as a Pillow image of 8 bits: L, RGB or CMYK."""
    from PIL import Image

    if colors.dtype != np.uint8:
        colors = np.round(_as_float(colors) * 255).astype(np.uint8)
    mode = "L" if colors.ndim == 2 else {3: "RGB", 4: "CMYK"}[colors.shape[2]]
    return Image.frombytes(mode, colors.shape[1::-1], np.ascontiguousarray(colors).tobytes())


def _turned(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return pixels as they are looked at, by Exif's number of how they lie."""
    if orientation in (5, 6, 7, 8):  # rows are columns
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels
