"""Read the samples of TIFF files by tifffile, and convert them to colors by their tags."""

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import AnyArray, Array
from clmorph.errors import FileError
from clmorph.images.reading.opening import check_size
from clmorph.images.reading.tiff_layout import (
    ASSOCIATED,
    BLACK_IS_ZERO,
    CIELAB,
    COLOR_SAMPLES,
    JPEG,
    MAX_DIRECTORIES,
    MAX_PIECES,
    PALETTE,
    RGB,
    UNASSOCIATED,
    WEBP,
    WHITE_IS_ZERO,
    YCBCR,
    Layout,
    check_layout,
    not_read,
    read_layout,
)


class Stored(NamedTuple):
    """The first full picture of a file, as it is stored."""

    #: (H, W, samples).
    samples: AnyArray
    #: Colors of a palette, (2 ** bits, 3) uint8, or None.
    palette: AnyArray | None
    layout: Layout
    #: Whether another full picture follows.
    more: bool


def read_tiff(file: Path, max_pixels: int, *, signed: bool = False) -> Stored:
    """Decode the first full picture by tifffile, which may raise any exception."""
    from tifffile import TiffFile

    with _quiet(), TiffFile(file) as tiff:
        page, more = _first_full_page(tiff)
        layout = read_layout(page)
        check_size(file, (layout.width, layout.height), max_pixels)
        check_layout(str(file), layout._replace(kind="u") if signed else layout, max_pixels)
        _check_pieces(file, tiff.filehandle, page, layout)
        # Separate samples, depth, height, width, samples together: nothing larger is decoded.
        apart, depth, height, width, together = page.shaped
        if depth != 1:
            raise ValueError("it has depth")
        if (height, width, apart * together) != (layout.height, layout.width, layout.samples):
            raise ValueError("its tags contradict each other")
        samples: AnyArray = np.asarray(page.asarray()).reshape(apart, height, width, together)
        palette = _palette(page) if layout.photometric == PALETTE else None
    samples = samples.astype(np.uint8) if samples.dtype == np.bool_ else samples
    samples = np.moveaxis(samples, 0, -1).reshape(height, width, layout.samples)
    return Stored(samples, palette, layout, more)


def _first_full_page(tiff: Any) -> tuple[Any, bool]:
    """Return the first page that is no reduced copy and no mask, and whether another follows."""
    pages: list[Any] = []
    full: list[Any] = []
    while len(pages) < MAX_DIRECTORIES and len(full) < 2:
        try:
            pages.append(tiff.pages[len(pages)])
        except Exception:  # there are no more, or the next one is damaged
            break
        # Bit 0 marks a reduced copy, bit 2 a transparency mask.
        full = [page for page in pages if not int(page.subfiletype) & 0b101]
    if not pages:
        raise ValueError("its directory is damaged")
    return (full or pages)[0], len(full) == 2


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Python from printing what tifffile logs about odd tags, if nobody else handles it."""
    log, handler = logging.getLogger("tifffile"), logging.NullHandler()
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


def _palette(page: Any) -> AnyArray:
    """Return the colors of a palette, in 8 bits as nearly every writer means them."""
    if page.colormap is None:
        raise ValueError("its palette is missing")
    colors = np.moveaxis(np.asarray(page.colormap), 0, -1)
    # Some writers store 8 bits where the standard demands 16; others leave the lower 8 bits zero.
    return np.asarray(colors if colors.max() < 256 else colors >> 8, np.uint8)


def _full_range(samples: AnyArray, bits: int) -> AnyArray:
    """Return samples of which the largest number of their dtype is full light, or floats."""
    if samples.dtype == np.float16:  # too imprecise to be subtracted from 1
        return samples.astype(np.float32)
    if samples.dtype.kind == "f" or bits in (8, 16):
        return samples
    largest = (1 << bits) - 1
    if bits <= 8 and 255 % largest == 0:
        return np.asarray(samples * np.uint8(255 // largest))
    return np.asarray(samples / float(largest))


def _check_pieces(file: Path, stream: Any, page: Any, layout: Layout) -> None:
    """Raise an error if a strip or tile is incomplete, or is a picture larger than its size."""
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.WebPImagePlugin import WebPImageFile

    if len(page.dataoffsets) > MAX_PIECES:
        raise ValueError("it has too many strips or tiles")
    if len(page.dataoffsets) != len(page.databytecounts):
        raise ValueError("its tags contradict each other")
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count == 0 and offset == 0:
            raise FileError(
                f"{file} leaves out some of its strips or tiles, as GDAL does in sparse files: "
                "expected all of them; write it anew with SPARSE_OK=FALSE"
            )
        if count < 1 or offset + count > stream.size:
            raise ValueError("a part of it is missing")
        # These decoders believe the size in their own data; the others fill the size of the piece.
        if layout.compression in (*JPEG, WEBP):
            stream.seek(offset)
            data = (page.jpegheader or b"") + stream.read(count)
            with (WebPImageFile if layout.compression == WEBP else JpegImageFile)(
                io.BytesIO(data)
            ) as part:
                if part.width > layout.piece[0] or part.height > layout.piece[1]:
                    raise ValueError("a part of it holds more than its tags say")


def interpret(file: str, stored: Stored) -> tuple[Any, AnyArray | None]:
    """Return colors (gray, RGB, CMYK or an image of mode LAB), and opacity (H, W) or None."""
    samples, palette, layout, _ = stored
    if palette is None:
        samples = _full_range(samples, layout.bits)
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
    if palette is not None:
        return palette[colors[..., 0]], alpha
    if layout.photometric in (YCBCR, CIELAB):
        return _by_pillow(file, colors, layout), alpha
    if layout.photometric == WHITE_IS_ZERO:
        colors = largest - colors
    return (colors[..., 0] if count == 1 else colors), alpha


def _by_pillow(file: str, colors: AnyArray, layout: Layout) -> Any:
    """Return RGB of YCbCr, or an image of the mode LAB."""
    from PIL import Image

    if colors.dtype != np.uint8:
        raise not_read(file, layout)
    if layout.compression in (*JPEG, WEBP):  # tifffile has converted YCbCr already
        return colors
    mode = "YCbCr" if layout.photometric == YCBCR else "LAB"
    size, data = colors.shape[1::-1], np.ascontiguousarray(colors).tobytes()
    picture = Image.frombytes(mode, size, data, "raw", mode)
    return picture if mode == "LAB" else np.asarray(picture.convert("RGB"))


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
