"""Read the samples of TIFF files and convert them to colors.

Pillow decodes samples of up to 8 bits, and compressed ones of 16; tifffile decodes the others,
uncompressed or deflated. For both, the tags (`tiff_layout`) decide here what the samples mean.
"""

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array
from clmorph.errors import FileError
from clmorph.images.reading.tiff_layout import (
    ASSOCIATED,
    BLACK_IS_ZERO,
    COLOR_SAMPLES,
    DEFLATE,
    MAX_PIECES,
    RGB,
    UNASSOCIATED,
    WHITE_IS_ZERO,
    Layout,
    not_read,
)

#: Largest number of bytes to which one byte of Deflate data can expand.
_DEFLATE_RATIO = 1032
#: Decompressed size in bytes that is accepted for any strip or tile.
_HARMLESS = 32 << 20


def read_samples(file: Path, page: int, layout: Layout) -> AnyArray:
    """Decode a picture by tifffile.

    Parameters
    ----------
    file : Path
    page : int
        Number of the picture in the file, from 0.
    layout : Layout
        The layout of that picture.

    Returns
    -------
    (H, W, samples) array

    Raises
    ------
    FileError
        If the file intentionally omits strips or tiles.
    Exception
        Any exception of tifffile, if the file is damaged.
    """
    from tifffile import TiffFile

    with TiffFile(file) as tiff:
        found: Any = tiff.pages[page]
        _check_pieces(file, tiff.filehandle, found, layout)
        samples = np.asarray(found.asarray()).reshape(found.shaped)
    if samples.shape[1] != 1:
        raise ValueError("it has depth")
    # (separate samples, depth, height, width, samples together)
    samples = np.moveaxis(samples[:, 0], 0, -1).reshape(
        *samples.shape[2:4], samples.shape[0] * samples.shape[4]
    )
    if samples.shape != (layout.height, layout.width, layout.samples):
        raise ValueError("its tags contradict each other")
    return samples


def _check_pieces(file: Path, stream: Any, page: Any, layout: Layout) -> None:
    """Raise an error if a strip or tile is incomplete, or decompresses to more than its size."""
    if len(page.dataoffsets) > MAX_PIECES:
        raise ValueError("it has too many strips or tiles")
    if len(page.dataoffsets) != len(page.databytecounts):
        raise ValueError("its tags contradict each other")
    # Strips of planar files hold one sample each; for them the limit is larger than necessary.
    most = layout.piece[0] * layout.piece[1] * layout.samples * layout.dtype.itemsize
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count == 0 and offset == 0:
            raise FileError(
                f"{file} leaves out some of its strips or tiles, as GDAL does in sparse files: "
                "expected all of them; write it anew with SPARSE_OK=FALSE"
            )
        if count < 1 or offset + count > stream.size:
            raise ValueError("a part of it is missing")
        # Only strips and tiles that could expand too far are decompressed twice.
        if layout.compression in DEFLATE and count * _DEFLATE_RATIO > max(most, _HARMLESS):
            stream.seek(offset)
            data = stream.read(count)
            if len(zlib.decompressobj().decompress(data, most + 1)) > most:
                raise ValueError("a part of it holds more than its tags say")


def interpret(file: str, samples: AnyArray, layout: Layout) -> tuple[AnyArray, AnyArray | None]:
    """Return the colors and the opacity that samples stand for.

    Parameters
    ----------
    file : str
        Name of the file in error messages.
    samples : (H, W, samples) array
    layout : Layout

    Returns
    -------
    (H, W), (H, W, 3) or (H, W, 4) array
        Gray, RGB or CMYK. Larger numbers mean more light or, for CMYK, more ink.
    (H, W) array or None
        Opacity.

    Raises
    ------
    FileError
        If samples of this kind are not supported.
    """
    if samples.dtype.kind == "u" and samples.dtype.itemsize > 2:
        samples = samples / float(np.iinfo(samples.dtype).max)
    elif samples.dtype == np.float16:  # too imprecise to be subtracted from 1
        samples = samples.astype(np.float32)
    count = COLOR_SAMPLES.get(layout.photometric, 0)
    if not count or samples.shape[2] < count:
        raise not_read(file, layout)
    largest = 1 if samples.dtype.kind == "f" else np.iinfo(samples.dtype).max
    colors, alpha = samples[..., :count], None
    for index, meaning in enumerate(layout.extra, start=count):
        if meaning in (ASSOCIATED, UNASSOCIATED) and index < samples.shape[2]:
            alpha = samples[..., index]
            if meaning == ASSOCIATED and not np.all(alpha == largest):
                if layout.photometric not in (BLACK_IS_ZERO, RGB):
                    raise FileError(
                        f"{file} has ink or inverted colors multiplied by opacity, which is not "
                        "read; save it as RGB"
                    )
                colors = _divided(colors, alpha, largest)
            break
    if layout.photometric == WHITE_IS_ZERO:
        colors = largest - colors
    return (colors[..., 0] if count == 1 else colors), alpha


def _divided(colors: AnyArray, alpha: AnyArray, largest: float) -> Array:
    """Divide premultiplied colors by opacity, in [0, 1]; fully transparent pixels become black."""
    opacity = alpha[..., None].astype(float)
    divided = np.divide(colors, opacity, out=np.zeros(colors.shape), where=opacity > 0)
    # Rounding can make a premultiplied color slightly larger than its opacity.
    return np.asarray(np.minimum(divided, 1.0))


def ink_to_rgb(ink: AnyArray) -> Array:
    """Return RGB in [0, 1] of CMYK (H, W, 4), without a profile: ink on white."""
    largest = 1 if ink.dtype.kind == "f" else np.iinfo(ink.dtype).max
    light = 1.0 - ink / float(largest)
    return np.asarray(light[..., :3] * light[..., 3:])
