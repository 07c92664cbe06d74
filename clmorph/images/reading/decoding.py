"""Decode image files from untrusted sources to arrays of sRGB, in bounded time and memory.

No file changes the global state of the process, and `clmorph.images.reading.opening` checks sizes.
"""

import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from clmorph._shared.typing import AnyArray
from clmorph.images.reading import tiff
from clmorph.images.reading.boxes import Reader, boxes
from clmorph.images.reading.opening import UnsupportedError, open_picture, xmp_orientation
from clmorph.images.reading.profiles import is_srgb, to_srgb
from clmorph.images.reading.spaces import Description, described, from_space

Decoded = tuple[AnyArray, list[str]]
#: Modes of Pillow that hold 16 bits of gray.
GRAY_16 = ("I;16", "I;16B", "I;16L", "I;16N")
#: Pillow's formats that can hold an animation.
_ANIMATED = ("GIF", "PNG", "WEBP", "AVIF")
#: The markers with which the data of a JPEG 2000 picture begin, and the places of its size and of
#: the first depth.
_JPEG_2000, _SIZE, _DEPTH = b"\xff\x4f\xff\x51", 8, 42
#: The number of bytes before the samples of an uncompressed DDS.
_DDS_HEADER = 128
#: The number by which JPEG 2000 names YCbCr.
_SYCC = b"\1\0\0\0\0\0\x12"


def decode(file: Path, max_pixels: int) -> Decoded:
    """Decode the first picture to sRGB that `as_pixels` takes; notes continue "<file> has"."""
    with Reader(file) as stream:
        if stream.read(4) in tiff.SIGNATURES:
            return _decode_tiff(file, max_pixels)
        with open_picture(file, stream, max_pixels) as picture:
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
    reduced = _is_reduced(picture)
    description = described(picture, file)
    samples = _own_samples(picture, file)
    if samples is not None:
        colors, alpha = (samples, None) if picture.mode == "CMYK" else _divided(samples)
    else:
        if reduced:
            notes.append("more than 8 bits a sample: they are reduced to 8")
        colors, alpha = _split(picture)
    if shown is not None and shown != (0, 0, *picture.size):
        # The area around the first picture of an animation is transparent.
        inside = np.zeros(picture.size[::-1], np.uint8)
        inside[shown[1] : shown[3], shown[0] : shown[2]] = 255
        alpha = inside if alpha is None else np.minimum(alpha, inside)
    with suppress(Exception):  # a damaged second picture, which is not needed
        if kind in _ANIMATED and getattr(picture, "is_animated", False):
            notes.append("several pictures: its first is taken")
    return _finished(colors, alpha, description, _orientation(picture.info), notes)


def _split(picture: Any) -> tuple[Any, AnyArray | None]:
    """Return an image's colors (mode L, RGB, CMYK, LAB, or deep gray), and its opacity or None."""
    tile = next(map(_raw_mode, getattr(picture, "tile", ())), "")
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
        colors = np.broadcast_to(colors.reshape(*alpha.shape, -1), (*alpha.shape, 3))
        colors = np.dstack((colors, alpha))
    return _turned(colors, turned), notes


def _as_float(values: AnyArray) -> AnyArray:
    return values if values.dtype.kind == "f" else values / float(np.iinfo(values.dtype).max)


def _as_picture(colors: AnyArray) -> Any:
    """Return an array of samples as a Pillow image of 8 bits: L, RGB or CMYK."""
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


# --- where Pillow keeps only 8 of more bits a sample, or takes microseconds a pixel --------------


def _own_samples(picture: Any, file: Path) -> AnyArray | None:
    """Return uint8 or uint16 of what Pillow would reduce to 8 bits or decode slowly; else None."""
    if picture.format not in (*_BITS, "QOI", "DDS"):
        return None
    if picture.format == "PNG" and not _is_reduced(picture):  # most files, some of them large
        return None
    with Reader(file) as stream:
        data = stream.read()
    if picture.format == "DDS":
        return _of_masks(picture, data)
    bits = 8 if picture.format == "QOI" else _BITS[picture.format](picture, data)
    if bits <= 8 and picture.format != "QOI":
        return None
    import imagecodecs

    name = "jpeg2k" if picture.format == "JPEG2000" else picture.format.lower()
    samples: AnyArray = np.asarray(getattr(imagecodecs, f"{name}_decode")(data))
    if samples.ndim == 4:  # an animation
        samples = samples[0]
    if samples.shape[:2] != picture.size[::-1] or samples.shape[2:] not in ((), (2,), (3,), (4,)):
        raise UnsupportedError("has samples of several kinds, or of one that is not read")
    if bits in (8, 16):
        return samples.astype(np.dtype(f"u{bits // 8}"), copy=False)
    largest = (1 << bits) - 1
    levels = np.round(np.arange(largest + 1) * (65535 / largest)).astype(np.uint16)
    return np.asarray(levels[np.minimum(samples, largest)])


def _of_masks(picture: Any, data: bytes) -> AnyArray | None:
    """Return the samples of an uncompressed DDS, whose channels are bits of numbers."""
    tile = picture.tile[0]
    if tile[0] != "dds_rgb":
        return None
    bits, masks = tile[3]
    width, height = picture.size
    size = bits // 8
    rows = np.frombuffer(data, np.uint8, width * height * size, _DDS_HEADER).reshape(-1, size)
    numbers = sum(rows[:, place].astype(np.uint32) << np.uint32(8 * place) for place in range(size))
    found = np.empty((width * height, len(masks)), np.uint8)
    for channel, mask in enumerate(masks):
        lowest = mask & -mask
        levels = (numbers & np.uint32(mask)) / max(1, lowest)
        opaque = 255 if channel == 3 else 0
        found[:, channel] = np.round(levels * (255 * lowest / mask)) if mask else opaque
    return found.reshape(height, width, len(masks))


def _avif_bits(picture: Any, data: bytes) -> int:
    """Return the depth in the configuration of AV1, of which the first is that of the colors."""
    for kind, content in boxes(data):
        if kind == b"av1C" and len(content) > 2:
            return (8, 8, 10, 12)[content[2] >> 5 & 3]
    return 8


def _jpeg_2000_bits(picture: Any, data: bytes) -> int:
    """Return the depth of the first component, or 8 where Pillow decodes all of them."""
    place = data.find(_JPEG_2000)
    if place < 0 or place + _DEPTH >= len(data) or picture.mode in ("P", "PA"):
        return 8  # damaged, or a palette
    # The decoder believes these numbers, and the size that was checked is that of a box.
    right, bottom, left, top = struct.unpack_from(">4I", data, place + _SIZE)
    if (right - left, bottom - top) != picture.size:
        raise ValueError("its headers contradict each other")
    depth = data[place + _DEPTH]
    if depth & 0x80:
        raise UnsupportedError("has signed samples")
    bits = (depth & 0x7F) + 1
    ycbcr = any(kind == b"colr" and content.startswith(_SYCC) for kind, content in boxes(data))
    if bits > 16 or (bits > 8 and ycbcr):
        raise UnsupportedError(f"has {'YCbCr' if ycbcr else 'samples'} of {bits} bits")
    return bits


#: A PNG in an icon is not decoded apart from it.
_BITS = {
    "PNG": lambda picture, data: 16 if data.startswith(b"\x89PNG") else 8, "AVIF": _avif_bits,
    "JPEG2000": _jpeg_2000_bits,
}  # fmt: skip


def _raw_mode(tile: Any) -> str:
    """Return the raw mode of a tile, which describes the storage of the tile to the decoder."""
    args = tile[3][0] if isinstance(tile[3], tuple) and tile[3] else tile[3]
    return args if isinstance(args, str) else ""


def _is_reduced(picture: Any) -> bool:
    """Return whether Pillow keeps only 8 bits of samples that have more."""
    if picture.mode in (*GRAY_16, "I", "F"):
        return False
    for tile in getattr(picture, "tile", ()):  # those that are not decoded yet
        most = tile[3][-1] if tile[0] == "ppm" else 0
        deep_png = picture.format == "PNG" and ";16" in _raw_mode(tile)
        if deep_png or tile[0] == "SGI16" or (isinstance(most, int) and most > 255):
            return True
    return False


def _divided(samples: AnyArray) -> tuple[AnyArray, AnyArray | None]:
    """Return the colors and the opacity of gray or RGB."""
    if samples.ndim == 2 or samples.shape[2] == 3:
        return samples, None
    return (samples[..., 0] if samples.shape[2] == 2 else samples[..., :3]), samples[..., -1]
