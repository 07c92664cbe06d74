"""Decode image files from untrusted sources to arrays of sRGB, in bounded time and memory.

No file changes the global state of the process, and `clmorph.images.reading.opening` checks sizes.
"""

import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray
from clmorph.images.reading import tiff
from clmorph.images.reading.deep import (
    GRAY_16,
    divided,
    is_reduced,
    own_samples,
    raw_mode,
    tiles_of,
)
from clmorph.images.reading.opening import Reader, open_picture, xmp_orientation
from clmorph.images.reading.profiles import is_srgb, to_srgb
from clmorph.images.reading.spaces import Description, described, from_space

Decoded = tuple[AnyArray, list[str]]


def decode(file: Path, max_pixels: int) -> Decoded:
    """Decode the first picture to sRGB that `as_pixels` takes; notes continue "<file> has"."""
    with Reader(file) as stream:
        if stream.read(4) in tiff.SIGNATURES:
            return _decode_tiff(file, max_pixels)
        picture = open_picture(file, stream, max_pixels)
        with picture:
            return _decode_picture(file, picture)


def _decode_tiff(file: Path, max_pixels: int) -> Decoded:
    """Decode the first full picture of a TIFF."""
    stored = tiff.read_tiff(file, max_pixels)
    notes = ["several pages: its first is taken"] if stored.more else []
    colors, alpha = tiff.interpret(str(file), stored)
    known = stored.layout
    return _finished(colors, alpha, Description(known.profile), known.orientation, notes)


def _decode_picture(file: Path, picture: Any) -> Decoded:
    """Decode an image that Pillow has opened."""
    notes = []
    kind = picture.format
    shown = picture.tile[0][1] if kind == "GIF" and picture.tile else None
    reduced = is_reduced(picture)
    description = described(picture, file)
    samples = own_samples(picture, file)
    if samples is not None:
        colors, alpha = (samples, None) if picture.mode == "CMYK" else divided(samples)
    else:
        if reduced:
            notes.append("more than 8 bits a sample: they are reduced to 8")
        colors, alpha = _split(picture)
    if shown is not None and shown != (0, 0, *picture.size):
        # The area around the first picture of an animation is transparent.
        inside = np.zeros(picture.size[::-1], np.uint8)
        inside[shown[1] : shown[3], shown[0] : shown[2]] = 255
        alpha = inside if alpha is None else np.minimum(alpha, inside)
    if _is_animated(picture):
        notes.append("several pictures: its first is taken")
    return _finished(colors, alpha, description, _orientation(picture.info), notes)


#: Pillow's formats that can hold an animation.
_ANIMATED = ("GIF", "PNG", "WEBP", "AVIF")


def _is_animated(picture: Any) -> bool:
    try:
        return picture.format in _ANIMATED and bool(getattr(picture, "is_animated", False))
    except Exception:  # a damaged second picture, which is not needed
        return False


def _split(picture: Any) -> tuple[Any, AnyArray | None]:
    """Return an image's colors (mode L, RGB, CMYK, LAB, or deep gray), and its opacity or None."""
    tile = next(map(raw_mode, tiles_of(picture)), "")
    picture.load()
    transparent = picture.info.get("transparency")
    if picture.mode in (*GRAY_16, "I"):
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
        # PNG states the transparent color in stored levels; Pillow's pixels have 256 levels.
        transparent *= {"L;2": 85, "L;4": 17}.get(tile, 1)
        return gray, (np.asarray(gray) != transparent) * np.uint8(255)
    if picture.mode == "RGB" and isinstance(transparent, tuple):
        return picture, np.any(np.asarray(picture) != transparent, axis=2) * np.uint8(255)
    if picture.mode in ("LA", "La"):
        whole = picture.convert("LA")
        return whole.getchannel("L"), np.asarray(whole.getchannel("A"))
    if picture.mode in ("PA", "RGBA", "RGBa") or (picture.mode == "P" and transparent is not None):
        whole = picture.convert("RGBA")
        return whole.convert("RGB"), np.asarray(whole.getchannel("A"))
    return picture.convert("RGB"), None


def _orientation(info: dict[Any, Any]) -> int:
    """Return the orientation of a picture from its Exif data, or else from its XMP data."""
    exif = info.get("exif")
    raw = info.get("Raw profile type exif")
    if not exif and isinstance(raw, str):  # older versions of ImageMagick write text
        try:
            exif = bytes.fromhex("".join(raw.split("\n")[3:]))
        except ValueError:  # damaged metadata; the pixels can still be valid
            exif = None
    turned = _exif_orientation(exif) if isinstance(exif, bytes) else None
    # Programs that rotate a picture update Exif and often leave the copy in XMP unchanged.
    if turned is not None:
        return turned
    xmp = info.get("xmp") or info.get("XML:com.adobe.xmp") or b""
    return xmp_orientation(xmp.encode() if isinstance(xmp, str) else bytes(xmp))


def _exif_orientation(exif: bytes) -> int | None:
    """Return the orientation in Exif data, 1 to 8, or None: Pillow would warn of damaged ones."""
    exif = exif.removeprefix(b"Exif\0\0")
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(exif[:4])
    if order is None:
        return None
    with suppress(struct.error):
        (start,) = struct.unpack_from(f"{order}I", exif, 4)
        (count,) = struct.unpack_from(f"{order}H", exif, start)
        for place in range(start + 2, start + 2 + 12 * count, 12):
            tag, kind = struct.unpack_from(f"{order}HH", exif, place)
            if tag == 274 and kind in (3, 4):
                (turned,) = struct.unpack_from(order + "HI"[kind - 3], exif, place + 8)
                return turned if 1 <= turned <= 8 else 1
    return None


def _finished(
    colors: Any, alpha: AnyArray | None, description: Description, turned: int, notes: list[str]
) -> Decoded:
    """Return sRGB, with opacity, as it is viewed; colors are gray, RGB, CMYK or LAB."""
    profile, space, note = description
    notes = [*notes, note] if note else notes
    profile = None if profile and is_srgb(profile) else profile
    if space is not None and getattr(colors, "mode", "") not in ("CMYK", "LAB"):
        colors = from_space(np.asarray(colors), space)
    if isinstance(colors, np.ndarray):
        # Floats outside [0, 1] are refused by `as_pixels` later.
        within = colors.dtype.kind == "u" or bool(np.all((colors >= 0) & (colors <= 1)))
        if profile and within:
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


def _as_float(values: AnyArray) -> AnyArray:
    return values if values.dtype.kind == "f" else values / float(np.iinfo(values.dtype).max)


def _as_picture(colors: AnyArray) -> Any:
    """Return an array of samples as a Pillow image of 8 bits: L, RGB or CMYK."""
    from PIL import Image

    if colors.dtype != np.uint8:
        colors = np.round(_as_float(colors) * 255).astype(np.uint8)
    mode = "L" if colors.ndim == 2 else {3: "RGB", 4: "CMYK"}[colors.shape[2]]
    return Image.frombytes(mode, colors.shape[1::-1], np.ascontiguousarray(colors).tobytes())


def _turned(pixels: AnyArray, orientation: int) -> AnyArray:
    """Return pixels in the orientation in which they are viewed, by Exif's orientation number."""
    if orientation in (5, 6, 7, 8):  # rows and columns are swapped
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels
