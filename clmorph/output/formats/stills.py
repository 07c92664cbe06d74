"""Frames as separate pictures: ``.tif`` with many pages, and folders of PNG or TIFF files."""

import math
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.output.formats.format import SIZES, Format
from clmorph.output.formats.limits import encoding
from clmorph.output.metadata import IMAGE_DESCRIPTION, as_png_info, as_text, image_head, read_png
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

if TYPE_CHECKING:
    from PIL.Image import Image

#: A lossless compression that every reader of TIFF knows.
DEFLATE = "tiff_adobe_deflate"


def _pictures(recording: Recording, style: FrameStyle, report: Report) -> Iterator["Image"]:
    """Return the frames, each at its own size unless the style names a size."""
    framing = recording.framing(style)
    for index in tracked(range(len(recording)), report):
        frame = recording.picture(index)
        yield framing.unscaled(frame) if style.canvas == "dynamic" else framing(frame)


def _names(recording: Recording) -> Iterator[str]:
    digits = max(4, len(str(len(recording) - 1)))
    return (f"frame-{number:0{digits}d}" for number in range(len(recording)))


@encoding("PNG")
def write_png_folder(recording: Recording, style: FrameStyle, folder: Path, report: Report) -> None:
    """Write a new folder of PNG files."""
    folder.mkdir()
    info = as_png_info(recording.parameters)
    for name, picture in zip(_names(recording), _pictures(recording, style, report), strict=True):
        picture.save(folder / f"{name}.png", pnginfo=info)


@encoding("TIFF")
def write_tiff_folder(
    recording: Recording, style: FrameStyle, folder: Path, report: Report
) -> None:
    """Write a new folder of TIFF files."""
    folder.mkdir()
    text = as_text(recording.parameters)
    for name, picture in zip(_names(recording), _pictures(recording, style, report), strict=True):
        # The file is encoded in memory, because libtiff prints a message of its own on a full disk.
        file = BytesIO()
        picture.save(file, format="TIFF", compression=DEFLATE, description=text)
        (folder / f"{name}.tif").write_bytes(file.getvalue())


@encoding("TIFF")
def write_tiff(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write one TIFF with a page for each frame."""
    import tifffile

    text = as_text(recording.parameters)
    # Offsets of 32 bits address at most 4 GiB; deflate hardly lengthens any data.
    large = sum(math.prod(shape) + 2 * len(text) for shape in recording.shapes) > 2**32 - 2**24
    # Pillow's own writer keeps all pages in memory until it has the last one.
    with tifffile.TiffWriter(file, bigtiff=large) as tiff:
        for picture in _pictures(recording, style, report):
            tiff.write(
                np.asarray(picture), photometric="rgb", planarconfig="contig",
                extrasamples=["unassalpha"] if picture.mode == "RGBA" else None,
                compression="zlib", description=text, software=False, metadata=None,
            )  # fmt: skip


def read_tiff(path: Path) -> str:
    """Return the metadata text of a TIFF: the description of its first page."""
    from PIL.TiffImagePlugin import TiffImageFile

    with image_head(TiffImageFile, path) as image:
        return str(image.getexif().get(IMAGE_DESCRIPTION, ""))


#: The first bytes of a TIFF, for either byte order and for offsets of 32 or 64 bits.
TIFF_SIGNATURES = tuple((0, start) for start in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"))
FORMATS = (
    Format(
        name="tiff", endings=(".tif", ".tiff"), write=write_tiff, read_metadata=read_tiff,
        signatures=TIFF_SIGNATURES, relevant_options=SIZES,
    ),
    Format(
        name="png-folder", endings=("",), write=write_png_folder, read_metadata=read_png,
        signatures=((0, b"\x89PNG"),), folder=True, relevant_options=SIZES,
    ),
    Format(
        name="tiff-folder", endings=(), write=write_tiff_folder, read_metadata=read_tiff,
        signatures=TIFF_SIGNATURES, folder=True, relevant_options=SIZES,
    ),
)  # fmt: skip
