"""TIFF: samples of many kinds, and what its tags say about how they become colors.

Pillow decodes samples of up to 8 bits, and compressed ones of 16; tifffile decodes the others,
uncompressed or deflated. What the numbers mean is decided here, from the tags, for both.
"""

import zlib
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from clmorph._shared.typing import AnyArray, Array
from clmorph.errors import FileError
from clmorph.images.reading import tags
from clmorph.images.reading.tags import Directory

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
WHITE_IS_ZERO, BLACK_IS_ZERO, RGB, CMYK, YCBCR = 0, 1, 2, 5, 6
#: Samples that are colors.
_COLORS = {WHITE_IS_ZERO: 1, BLACK_IS_ZERO: 1, RGB: 3, CMYK: 4}
UNCOMPRESSED, DEFLATE = 1, (8, 32946)
#: Values of ExtraSamples: opacity that colors are multiplied by, and that they are not.
ASSOCIATED, UNASSOCIATED = 1, 2
#: Pieces (strips or tiles) of one picture.
MAX_PIECES = 1 << 16
#: Pixels that pieces may have beside the picture: a small one can lie in one large tile.
_PADDING = 1 << 22
#: Bytes a pixel of the largest kind that is read: four samples of 64 bits, and an extra one.
_MAX_BYTES = 40
#: Bytes that one of Deflate can become, at most.
_DEFLATE_RATIO = 1032
#: Bytes that a piece may become, whatever its size should be.
_HARMLESS = 32 << 20


class Layout(NamedTuple):
    """How one picture of a TIFF is stored.

    Attributes
    ----------
    width, height : int
    bits : int
        Of each sample.
    kind : str
        "u", "i" or "f".
    samples : int
    photometric, compression, orientation, predictor : int
        As in the file.
    planar, subsampled : bool
        Whether samples of one kind lie together; whether there are fewer of color than of light.
    extra : tuple of int
        What the samples after the colors are.
    piece : tuple of int
        Width and height of a strip or tile.
    profile : bytes, optional
    """

    width: int
    height: int
    bits: int
    kind: str
    samples: int
    photometric: int
    compression: int
    orientation: int
    planar: bool
    extra: tuple[int, ...]
    piece: tuple[int, int]
    subsampled: bool
    predictor: int
    profile: bytes | None

    @property
    def dtype(self) -> np.dtype:
        """Of the samples, if NumPy has such."""
        return np.dtype(f"{self.kind}{self.bits // 8}")


def read_layout(directory: Directory) -> Layout:
    """Return how a picture is stored.

    Raises
    ------
    ValueError
        If its tags do not say so, or contradict each other.
    """
    width, height = directory.number(tags.WIDTH, 0), directory.number(tags.HEIGHT, 0)
    if width < 1 or height < 1:
        raise ValueError("its tags give no size")
    compression = directory.number(tags.COMPRESSION, UNCOMPRESSED)
    samples = directory.number(tags.SAMPLES, 3 if compression in (6, 7) else 1)
    bits = directory.numbers(tags.BITS) or (1,)
    formats = directory.numbers(tags.SAMPLE_FORMAT) or (1,)
    if len(set(bits)) > 1 or len(set(formats)) > 1:
        raise ValueError("its samples are not all of one kind")
    kind = {1: "u", 2: "i", 3: "f", 4: "u"}.get(formats[0])
    if kind is None or not 1 <= bits[0] <= 64 or samples < 1:
        raise ValueError("its samples are not of a kind that is read")
    photometric = directory.number(tags.PHOTOMETRIC, RGB if samples > 2 else BLACK_IS_ZERO)
    extra = directory.numbers(tags.EXTRA_SAMPLES)
    if not extra and samples == _COLORS.get(photometric, samples) + 1:
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
        directory.number(tags.PREDICTOR, 1),
        profile if isinstance(profile, bytes) else None,
    )  # fmt: skip


def check_layout(file: str, layout: Layout, max_pixels: int) -> None:
    """Refuse what would be misread, and what its pieces make larger than it says.

    Parameters
    ----------
    file : str
        What messages call it.
    layout : Layout
    max_pixels : int

    Raises
    ------
    FileError
        If it is not read.
    """
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
            f"{file} has signed samples: expected unsigned ones, or floats in [0, 1]; convert it"
        )
    if layout.photometric == YCBCR and layout.compression == UNCOMPRESSED and layout.subsampled:
        raise FileError(
            f"{file} holds uncompressed YCbCr with fewer samples of color than of light, which is "
            "not read; save it as RGB"
        )


def by_tifffile(layout: Layout) -> bool:
    """Return whether tifffile decodes such a picture."""
    return (
        layout.compression in (UNCOMPRESSED, *DEFLATE)
        and layout.photometric in _COLORS
        and layout.predictor in (1, 2)  # 3, for floats, takes imagecodecs
        and layout.bits in ((16, 32, 64) if layout.kind == "f" else (8, 16, 32, 64))
    )


def read_samples(file: Path, page: int, layout: Layout) -> AnyArray:
    """Decode a picture by tifffile.

    Parameters
    ----------
    file : Path
    page : int
        Which one of its pictures.
    layout : Layout
        Of that picture.

    Returns
    -------
    (H, W, samples) array

    Raises
    ------
    FileError
        If parts are left out on purpose.
    Exception
        Of any kind, if the file is damaged.
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
    """Raise an error if a strip or a tile is not all there, or inflates to more than it is."""
    if len(page.dataoffsets) > MAX_PIECES:
        raise ValueError("it has too many strips or tiles")
    if len(page.dataoffsets) != len(page.databytecounts):
        raise ValueError("its tags contradict each other")
    # Strips of planar files are of one sample each; a limit has not to be exact.
    most = layout.piece[0] * layout.piece[1] * layout.samples * layout.dtype.itemsize
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count == 0 and offset == 0:
            raise FileError(
                f"{file} leaves out some of its strips or tiles, as GDAL does in sparse files: "
                "expected all of them; write it anew with SPARSE_OK=FALSE"
            )
        if count < 1 or offset + count > stream.size:
            raise ValueError("a part of it is missing")
        # Few bytes cannot make many: only large pieces are worth being inflated twice.
        if layout.compression in DEFLATE and count * _DEFLATE_RATIO > max(most, _HARMLESS):
            stream.seek(offset)
            data = stream.read(count)
            if len(zlib.decompressobj().decompress(data, most + 1)) > most:
                raise ValueError("a part of it holds more than its tags say")


def not_read(file: str, layout: Layout) -> FileError:
    """Return the error of a picture whose samples are of a kind that is not read."""
    return FileError(
        f"{file} stores its colors in a way that is not read (photometric {layout.photometric}, "
        f"compression {layout.compression}, {layout.samples} samples of {layout.bits} bits); "
        "save it as RGB of 8 or 16 bits, uncompressed or with Deflate"
    )


def interpret(file: str, samples: AnyArray, layout: Layout) -> tuple[AnyArray, AnyArray | None]:
    """Return what samples mean.

    Parameters
    ----------
    file : str
        What messages call it.
    samples : (H, W, samples) array
    layout : Layout

    Returns
    -------
    (H, W), (H, W, 3) or (H, W, 4) array
        Gray, RGB or CMYK, where more is more light, for CMYK more ink.
    (H, W) array or None
        Opacity.

    Raises
    ------
    FileError
        If they are not read as colors.
    """
    if samples.dtype.kind == "u" and samples.dtype.itemsize > 2:
        samples = samples / float(np.iinfo(samples.dtype).max)
    elif samples.dtype == np.float16:  # too short to be subtracted from 1
        samples = samples.astype(np.float32)
    count = _COLORS.get(layout.photometric, 0)
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
    """Return colors that were multiplied by opacity, in [0, 1]; nothing seen is black."""
    opacity = alpha[..., None].astype(float)
    divided = np.divide(colors, opacity, out=np.zeros(colors.shape), where=opacity > 0)
    # Rounding leaves some a little larger than their opacity.
    return np.asarray(np.minimum(divided, 1.0))


def ink_to_rgb(ink: AnyArray) -> Array:
    """Return RGB in [0, 1] of CMYK (H, W, 4), without a profile: ink on white."""
    largest = 1 if ink.dtype.kind == "f" else np.iinfo(ink.dtype).max
    light = 1.0 - ink / float(largest)
    return np.asarray(light[..., :3] * light[..., 3:])


def open_page(stream: IO[bytes]) -> tuple[Layout, int, bool]:
    """Return how the picture of a TIFF that is taken is stored, which page, whether more follow.

    Nothing is said yet about whether it is read: see `check_layout`.

    Raises
    ------
    ValueError
        If it is damaged.
    """
    directory, page, more = tags.first_full_page(stream)
    return read_layout(directory), page, more
