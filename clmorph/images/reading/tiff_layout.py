"""The storage layout of a picture in a TIFF file, from its tags, and whether it is supported."""

from typing import Any, NamedTuple

from clmorph.errors import FileError
from clmorph.images.reading.opening import UnsupportedError, xmp_orientation

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
