"""Read the samples of TIFF files by tifffile, and convert them to colors by their tags."""

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from clmorph._shared.typing import AnyArray, Array
from clmorph.errors import FileError
from clmorph.images.reading.opening import UnsupportedError, check_size, xmp_orientation

#: First bytes of a TIFF or BigTIFF, in either byte order.
SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
#: Values of PhotometricInterpretation.
WHITE_IS_ZERO, BLACK_IS_ZERO, RGB, PALETTE, CMYK, YCBCR, CIELAB = 0, 1, 2, 3, 5, 6, 8
#: Number of samples of a pixel that are colors.
COLOR_SAMPLES = {
    WHITE_IS_ZERO: 1, BLACK_IS_ZERO: 1, RGB: 3, PALETTE: 1, CMYK: 4, YCBCR: 3, CIELAB: 3
}  # fmt: skip
#: Values of Compression: JPEG of the old and the new kind, and WebP.
JPEG, WEBP = (6, 7), 50001
#: Values of Compression: the three kinds of fax.
FAX = (2, 3, 4)
#: Values of Compression that are read: also none, three kinds of fax, LZW, Deflate by two numbers,
#: PackBits, LZMA and Zstandard. None of their decoders exceeds the size that it is told.
COMPRESSIONS = frozenset((1, *FAX, 5, *JPEG, 8, 32946, 32773, 34925, 50000, WEBP))
#: Values of ExtraSamples: opacity with premultiplied colors, and with unmultiplied colors.
ASSOCIATED, UNASSOCIATED = 1, 2
#: Numbers of tags.
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _ORIENTATION = 256, 257, 258, 259, 262, 274
_SAMPLES, _ROWS_PER_STRIP, _PLANAR, _TILE_WIDTH, _TILE_HEIGHT = 277, 278, 284, 322, 323
_EXTRA_SAMPLES, _SAMPLE_FORMAT, _SUBSAMPLING, _XMP, _ICC_PROFILE = 338, 339, 530, 700, 34675
#: Largest number of directories that are read; hardly any file has its main image further back.
MAX_DIRECTORIES = 16
#: Largest number of pieces (strips or tiles) of one picture.
MAX_PIECES = 1 << 16
#: Largest number of pixels of pieces outside the picture; a small picture can lie in a large tile.
_PADDING = 1 << 22
#: Largest number of bytes of a pixel: four samples of 64 bits, and an extra one.
_MAX_BYTES = 40


class Layout(NamedTuple):
    """The storage layout of one picture of a TIFF."""

    width: int
    height: int
    #: Bits of each sample.
    bits: int
    #: Kind of the samples: "u", "i" or "f".
    kind: str
    samples: int
    #: The value of this tag in the file, like the next two.
    photometric: int
    compression: int
    orientation: int
    #: Whether each channel is stored separately.
    planar: bool
    #: Meaning of each sample after the colors, by the values of ExtraSamples.
    extra: tuple[int, ...]
    #: Width and height of a strip or tile.
    piece: tuple[int, int]
    #: Whether chroma has fewer samples than luma.
    subsampled: bool
    profile: bytes | None


def read_layout(page: Any) -> Layout:
    """Return the storage layout of a page of tifffile, or raise ValueError or UnsupportedError."""

    def numbers(tag: int, *usual: int) -> tuple[int, ...]:
        value = page.tags.valueof(tag)
        if value is None or isinstance(value, str | bytes):
            return usual
        return tuple(map(int, value if isinstance(value, tuple) else (value,))) or usual

    def octets(tag: int) -> bytes:
        value = page.tags.valueof(tag)
        return value if isinstance(value, bytes) else b""

    (width, *_), (height, *_) = numbers(_WIDTH, 0), numbers(_HEIGHT, 0)
    if width < 1 or height < 1:
        raise ValueError("its tags give no size")
    compression, samples = numbers(_COMPRESSION, 1)[0], numbers(_SAMPLES, 1)[0]
    bits, formats = numbers(_BITS, 1), numbers(_SAMPLE_FORMAT, 1)
    kind = {1: "u", 2: "i", 3: "f", 4: "u"}.get(formats[0])
    if len(set(bits)) > 1 or len(set(formats)) > 1 or kind is None or bits[0] > 64:
        raise UnsupportedError("has samples of several kinds, or of one that is not read")
    if bits[0] < 1 or samples < 1:
        raise ValueError("its tags give no samples")
    photometric = numbers(_PHOTOMETRIC, RGB if samples > 2 else BLACK_IS_ZERO)[0]
    extra = numbers(_EXTRA_SAMPLES)
    if not extra and samples == COLOR_SAMPLES.get(photometric, samples) + 1:
        extra = (UNASSOCIATED,)
    piece = (
        (numbers(_TILE_WIDTH, 0)[0], numbers(_TILE_HEIGHT, 0)[0])
        if _TILE_WIDTH in page.tags
        else (width, max(1, min(numbers(_ROWS_PER_STRIP, height)[0], height)))
    )
    if min(piece) < 1:
        raise ValueError("its tiles have no size")
    return Layout(
        width, height, bits[0], kind, samples, photometric, compression,
        numbers(_ORIENTATION, xmp_orientation(octets(_XMP)))[0], numbers(_PLANAR, 1)[0] == 2,
        extra, piece, numbers(_SUBSAMPLING)[:2] != (1, 1), octets(_ICC_PROFILE) or None,
    )  # fmt: skip


def check_layout(file: str, layout: Layout, max_pixels: int) -> None:
    """Refuse a picture that would be misread, or whose pieces exceed it by too much."""
    across, down = -(-layout.width // layout.piece[0]), -(-layout.height // layout.piece[1])
    pieces = across * down * (layout.samples if layout.planar else 1)
    padded = across * down * layout.piece[0] * layout.piece[1]
    most = max(2 * max_pixels, _PADDING)
    if pieces > MAX_PIECES or padded > most:
        raise FileError(
            f"{file} is stored in {pieces} piece{'s' * (pieces != 1)} of {layout.piece[0]} x "
            f"{layout.piece[1]} pixels: expected at most {MAX_PIECES} pieces and {most} pixels, "
            "those around the picture included; save it anew, in strips"
        )
    if layout.bits * layout.samples > 8 * _MAX_BYTES:
        raise FileError(
            f"{file} has {layout.samples} samples of {layout.bits} bits a pixel: expected gray, "
            "RGB or CMYK, with opacity or without; save it as one of these"
        )
    if layout.kind == "i":
        raise FileError(
            f"{file} has signed samples, which are not supported: convert it to unsigned "
            "samples, or to floats in [0, 1]"
        )
    if layout.compression not in COMPRESSIONS or layout.photometric not in COLOR_SAMPLES:
        raise not_read(file, layout)
    if layout.compression in FAX and not reads_fax():
        raise FileError(f"{file} is compressed as fax, which needs imagecodecs 2026.3.6 or newer")
    if layout.photometric == YCBCR and layout.compression not in JPEG and layout.subsampled:
        raise FileError(
            f"{file} holds uncompressed YCbCr with fewer samples of color than of light, which is "
            "not read; save it as RGB"
        )


def reads_fax() -> bool:
    """Return whether imagecodecs decodes fax. NumPy 1.26 has no version that does."""
    import imagecodecs

    return all(
        hasattr(imagecodecs, name) and getattr(imagecodecs, name).available
        for name in ("CCITTRLE", "CCITTFAX3", "CCITTFAX4")
    )


def not_read(file: str, layout: Layout) -> FileError:
    """Return the error of a picture whose samples are of a kind that is not read."""
    return FileError(
        f"{file} stores its colors in an unsupported way (photometric {layout.photometric}, "
        f"compression {layout.compression}, {layout.samples} samples of {layout.bits} bits); "
        "save it as RGB of 8 or 16 bits, uncompressed or with Deflate"
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
