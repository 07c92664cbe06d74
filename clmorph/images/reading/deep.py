"""Decoding where Pillow keeps only 8 of more bits a sample, or takes microseconds a pixel."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray
from clmorph.images.reading.boxes import boxes
from clmorph.images.reading.opening import Reader, UnsupportedError

#: Modes of Pillow that hold 16 bits of gray.
GRAY_16 = ("I;16", "I;16B", "I;16L", "I;16N")
#: The markers with which the data of a JPEG 2000 picture begin, and the places of its size and of
#: the first depth.
_JPEG_2000, _SIZE, _DEPTH = b"\xff\x4f\xff\x51", 8, 42
#: The number of bytes before the samples of an uncompressed DDS.
_DDS_HEADER = 128
#: The number by which JPEG 2000 names YCbCr.
_SYCC = b"\1\0\0\0\0\0\x12"


def own_samples(picture: Any, file: Path) -> AnyArray | None:
    """Return uint8 or uint16 of what Pillow would reduce to 8 bits or decode slowly; else None."""
    if picture.format not in (*_BITS, "QOI", "DDS"):
        return None
    if picture.format == "PNG" and not is_reduced(picture):  # most files, some of them large
        return None
    with Reader(file) as stream:
        data = stream.read()
    if picture.format == "DDS":
        return _of_masks(picture, data)
    bits = 8 if picture.format == "QOI" else _BITS[picture.format](picture, data)
    if bits <= 8 and picture.format != "QOI":
        return None
    import imagecodecs

    decode = {
        "QOI": imagecodecs.qoi_decode,
        "PNG": imagecodecs.png_decode,
        "AVIF": imagecodecs.avif_decode,
        "JPEG2000": imagecodecs.jpeg2k_decode,
    }[picture.format]
    samples: AnyArray = np.asarray(decode(data))
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


def tiles_of(picture: Any) -> Any:
    """Return the tiles of a file that Pillow has not decoded yet."""
    return getattr(picture, "tile", ())


def raw_mode(tile: Any) -> str:
    """Return the raw mode of a tile, which describes the storage of the tile to the decoder."""
    args = tile[3][0] if isinstance(tile[3], tuple) and tile[3] else tile[3]
    return args if isinstance(args, str) else ""


def is_reduced(picture: Any) -> bool:
    """Return whether Pillow keeps only 8 bits of samples that have more."""
    if picture.mode in (*GRAY_16, "I", "F"):
        return False
    for tile in tiles_of(picture):
        most = tile[3][-1] if tile[0] == "ppm" else 0
        deep_png = picture.format == "PNG" and ";16" in raw_mode(tile)
        if deep_png or tile[0] == "SGI16" or (isinstance(most, int) and most > 255):
            return True
    return False


def divided(samples: AnyArray) -> tuple[AnyArray, AnyArray | None]:
    """Return the colors and the opacity of gray or RGB."""
    if samples.ndim == 2 or samples.shape[2] == 3:
        return samples, None
    return (samples[..., 0] if samples.shape[2] == 2 else samples[..., :3]), samples[..., -1]
