"""Frames as separate pictures: ``.tif`` with many pages, and folders of PNG or TIFF files."""

import math
from collections.abc import Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.output.formats.format import SIZES, Format, encoding
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


def _write_folder(
    ending: str, recording: Recording, style: FrameStyle, folder: Path, report: Report
) -> None:
    """Write a new folder of PNG or TIFF files."""
    folder.mkdir()
    digits = max(4, len(str(len(recording) - 1)))
    info, text = as_png_info(recording.parameters), as_text(recording.parameters)
    kind = "PNG" if ending == "png" else "TIFF"
    with encoding(kind):
        for number, picture in enumerate(_pictures(recording, style, report)):
            # It is encoded in memory, because libtiff prints a message of its own on a full disk.
            # Each encoder takes the options that are its own.
            file = BytesIO()
            picture.save(file, kind, pnginfo=info, compression=DEFLATE, description=text)
            (folder / f"frame-{number:0{digits}d}.{ending}").write_bytes(file.getvalue())


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
        name="png-folder", endings=("",), write=partial(_write_folder, "png"),
        read_metadata=read_png, signatures=((0, b"\x89PNG"),), folder=True, relevant_options=SIZES,
    ),
    Format(
        name="tiff-folder", endings=(), write=partial(_write_folder, "tif"),
        read_metadata=read_tiff, signatures=TIFF_SIGNATURES, folder=True, relevant_options=SIZES,
    ),
)  # fmt: skip
