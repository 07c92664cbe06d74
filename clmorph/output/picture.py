"""Single pictures: ``.png``, ``.jpg``, ``.webp`` and ``.tif``, with the options that made them."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.files import NO_ENDING, atomic_path, check_named_place, is_standard_output
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import is_path
from clmorph.errors import OutputError
from clmorph.images.pixels import as_pixels, as_rgb, to_bytes
from clmorph.output.formats.format import check_sides, encoding
from clmorph.output.formats.webp import LONGEST_SIDE, LOSSLESS_EFFORT, as_exif
from clmorph.output.metadata import (
    IMAGE_DESCRIPTION,
    as_png_info,
    as_text,
    checked_parameters,
    image_head,
)

#: The first bytes of a JPEG, and its longest side in pixels: the field has 16 bits.
JPEG_START, JPEG_SIDE = b"\xff\xd8\xff", 65500
#: Quality of JPEG, from 0 to 100; its colors are not subsampled.
JPEG_QUALITY = 95


#: The encoder of each ending. JPEG has no opacity: its pictures are laid on white.
ENCODERS = {
    ".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WebP", ".tif": "TIFF", ".tiff": "TIFF"
}  # fmt: skip
#: Options of Pillow's encoders.
_OPTIONS: dict[str, dict[str, Any]] = {
    "PNG": {"optimize": False},
    "JPEG": {"quality": JPEG_QUALITY, "subsampling": 0},
    "WebP": {"lossless": True, "exact": True, "quality": LOSSLESS_EFFORT, "method": 4},
}


def check_picture_place(path: str | PathLike[str], format: str | None = None) -> Path:
    """Return the path of a picture to be written, or raise OutputError if it cannot be written."""
    if format is None and is_path(path) and is_standard_output(path):
        raise OutputError(NO_ENDING)
    expected = f"{', '.join(ENCODERS)} for a single picture"
    return check_named_place(path, ENCODERS, "out.png", expected, format and f".{format}")


def write_picture(
    pixels: Array, parameters: Mapping[str, Any], file: Path, format: str | None = None
) -> None:
    """Write sRGB (H, W, 3 or 4) in [0, 1] and metadata to a new file in the ending's format."""
    from PIL import Image

    kind = ENCODERS[file.suffix.lower() if format is None else f".{format}"]
    with encoding(kind):
        if kind == "TIFF":
            import tifffile

            tifffile.imwrite(
                file, np.rint(65535.0 * pixels).astype(np.uint16), photometric="rgb",
                planarconfig="contig", compression="zlib", software=False, metadata=None,
                extrasamples=["unassalpha"] if pixels.shape[2] == 4 else None,
                description=as_text(parameters),
            )  # fmt: skip
            return
        if kind != "PNG":
            most = JPEG_SIDE if kind == "JPEG" else LONGEST_SIDE
            check_sides((pixels.shape[1], pixels.shape[0]), most, kind)
        known: Any = (
            {"pnginfo": as_png_info(parameters)} if kind == "PNG" else {"exif": as_exif(parameters)}
        )
        image = Image.fromarray(to_bytes(as_rgb(pixels) if kind == "JPEG" else pixels))
        image.save(file, format=kind.upper(), **_OPTIONS[kind], **known)


def write_image(
    path: str | PathLike[str], image: ArrayLike, *, parameters: Mapping[str, Any] | None = None
) -> None:
    """Write an image to a file, the counterpart of `clmorph.read_image`.

    Parameters
    ----------
    path : path
        ``.png``, ``.jpg`` (without opacity, on white), ``.webp`` (without loss), or ``.tif``, which
        has 16 bits a channel; the others have 8. An existing file is replaced.
    image : (H, W), (H, W, 3) or (H, W, 4) array
        See `clmorph.images.pixels.as_pixels`.
    parameters : mapping, optional
        Metadata of the file, as values that JSON can represent.

    Raises
    ------
    InputError
        If an argument cannot be used.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> import clmorph
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "gray.png")
    ...     clmorph.write_image(file, np.full((2, 2, 3), 0.6))
    ...     clmorph.read_image(file)[0, 0].tolist()
    [0.6, 0.6, 0.6]
    """
    place = check_picture_place(path)
    metadata = checked_parameters({} if parameters is None else parameters)
    pixels = as_pixels(image)
    with atomic_path(place) as file:
        write_picture(pixels, metadata, file)


def read_jpeg(path: Path) -> str:
    """Return the metadata text of a JPEG: the description in its Exif."""
    from PIL.JpegImagePlugin import JpegImageFile

    with image_head(JpegImageFile, path) as image:
        return str(image.getexif().get(IMAGE_DESCRIPTION, ""))
