"""The storage layout of a picture in a TIFF file, from its tags, and whether it is supported."""

from typing import IO, NamedTuple

from clmorph.errors import FileError
from clmorph.images.reading import tags
from clmorph.images.reading.opening import UnsupportedError
from clmorph.images.reading.tags import Directory

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


def read_layout(directory: Directory) -> Layout:
    """Return the storage layout of a picture, or raise ValueError or UnsupportedError."""
    width, height = directory.number(tags.WIDTH, 0), directory.number(tags.HEIGHT, 0)
    if width < 1 or height < 1:
        raise ValueError("its tags give no size")
    compression = directory.number(tags.COMPRESSION, 1)
    samples = directory.number(tags.SAMPLES, 1)
    bits = directory.numbers(tags.BITS) or (1,)
    formats = directory.numbers(tags.SAMPLE_FORMAT) or (1,)
    kind = {1: "u", 2: "i", 3: "f", 4: "u"}.get(formats[0])
    if len(set(bits)) > 1 or len(set(formats)) > 1 or kind is None or bits[0] > 64:
        raise UnsupportedError("has samples of several kinds, or of one that is not read")
    if bits[0] < 1 or samples < 1:
        raise ValueError("its tags give no samples")
    photometric = directory.number(tags.PHOTOMETRIC, RGB if samples > 2 else BLACK_IS_ZERO)
    extra = directory.numbers(tags.EXTRA_SAMPLES)
    if not extra and samples == COLOR_SAMPLES.get(photometric, samples) + 1:
        extra = (UNASSOCIATED,)
    tiled = tags.TILE_WIDTH in directory.tags
    piece = (
        (directory.number(tags.TILE_WIDTH, 0), directory.number(tags.TILE_HEIGHT, 0))
        if tiled
        else (width, max(1, min(directory.number(tags.ROWS_PER_STRIP, height), height)))
    )
    if min(piece) < 1:
        raise ValueError("its tiles have no size")
    profile = directory.tags.get(tags.ICC_PROFILE)
    return Layout(
        width, height, bits[0], kind, samples, photometric, compression,
        directory.number(tags.ORIENTATION, tags.xmp_orientation(directory.octets(tags.XMP))),
        directory.number(tags.PLANAR, 1) == 2,
        extra, piece, directory.numbers(tags.SUBSAMPLING)[:2] != (1, 1),
        profile if isinstance(profile, bytes) else None,
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


def open_page(stream: IO[bytes]) -> tuple[Layout, int, bool]:
    """Return the layout of the picture to be read, its page from 0, and whether another follows."""
    directory, page, more = tags.first_full_page(stream)
    return read_layout(directory), page, more
