"""Reading of 16 bits a sample by Pillow, which itself keeps only the upper 8 bits of colors."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.images.reading.opening import Reader

#: Modes of Pillow that hold 16 bits of gray.
GRAY_16 = ("I;16", "I;16B", "I;16L", "I;16N")
#: Raw modes of 16 bits a sample of which Pillow keeps the upper 8, with the letter of the byte
#: order at the end.
_DEEP = re.compile(r"(RGBX?|RGBA|RGBa|CMYK);16([BLN])")


def deep_samples(picture: Any, file: Path, page: int = 0) -> NDArray[np.uint16] | None:
    """Decode 16 bits a sample where Pillow would keep 8; return None where this does not apply.

    The letter of the byte order decides which byte of each sample Pillow keeps. Decoding a second
    time with the other letter yields the other byte.

    Parameters
    ----------
    picture : PIL.ImageFile.ImageFile
        The picture, not decoded yet.
    file : Path
        Its file, which is opened a second time.
    page : int
        Number of the picture in the file.

    Returns
    -------
    (H, W, 2 to 4) array or None
    """
    tiles = [raw_mode(tile) for tile in tiles_of(picture)]
    if tiles == ["LA;16B"]:  # four bytes a pixel, as in RGBA
        picture.tile = [_with_raw_mode(tile, "RGBA") for tile in picture.tile]
        bytes_ = np.asarray(picture).astype(np.uint16)
        return np.asarray(bytes_[..., ::2] << 8 | bytes_[..., 1::2], np.uint16)
    if not tiles or not all(_DEEP.fullmatch(tile) for tile in tiles):
        return None
    upper = tiles[0][-1]
    upper = {"little": "L", "big": "B"}[sys.byteorder] if upper == "N" else upper
    with Reader(file) as stream, type(picture)(stream, str(file)) as again:
        again.seek(page)
        halves = []
        for opened, letter in ((picture, upper), (again, "L" if upper == "B" else "B")):
            # Pillow would divide RGBa by its opacity, each byte separately.
            opened.tile = [
                _with_raw_mode(tile, f"{raw_mode(tile)[:-1].upper()}{letter}")
                for tile in opened.tile
            ]
            halves.append(np.asarray(opened).astype(np.uint16))
    return np.asarray(halves[0] << 8 | halves[1], np.uint16)


def tiles_of(picture: Any) -> Any:
    """Return the tiles of a file that Pillow has not decoded yet."""
    return getattr(picture, "tile", ())


def raw_mode(tile: Any) -> str:
    """Return the raw mode of a tile, which describes the storage of the tile to the decoder."""
    args = tile[3][0] if isinstance(tile[3], tuple) and tile[3] else tile[3]
    return args if isinstance(args, str) else ""


def _with_raw_mode(tile: Any, mode: str) -> Any:
    """Return a tile with another raw mode."""
    args = (mode, *tile[3][1:]) if isinstance(tile[3], tuple) else mode
    changed = (*tile[:3], args)
    return tile._make(changed) if hasattr(tile, "_make") else changed


def is_reduced(picture: Any) -> bool:
    """Return whether Pillow keeps only 8 bits of samples that have more."""
    for tile in tiles_of(picture):
        most = tile[3][-1] if tile[0] == "ppm" else 0
        if ";16" in raw_mode(tile) or tile[0] == "SGI16" or (isinstance(most, int) and most > 255):
            return picture.mode not in (*GRAY_16, "I", "F")
    return False


def of_deep_png(
    samples: NDArray[np.uint16], transparent: Any
) -> tuple[NDArray[np.uint16], NDArray[np.uint16] | None]:
    """Return the colors and the opacity of a PNG of 16 bits that is not gray without opacity."""
    if samples.shape[2] == 2:
        return samples[..., 0], samples[..., 1]
    if samples.shape[2] == 4:
        return samples[..., :3], samples[..., 3]
    if isinstance(transparent, tuple):
        return samples, np.any(samples != transparent, axis=2) * np.uint16(65535)
    return samples, None
