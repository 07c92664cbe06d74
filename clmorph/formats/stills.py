"""Frames as pictures of their own: folders of PNG or TIFF, and a TIFF of many pages."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from clmorph.film import Film
from clmorph.formats.embedding import as_png_info, as_text
from clmorph.framing import Framing, Look, in_time
from clmorph.progress import Report, tracked

if TYPE_CHECKING:
    from PIL.Image import Image

#: Compression that every reader of TIFF knows, without loss.
DEFLATE = "tiff_adobe_deflate"


def _pictures(film: Film, look: Look, report: Report) -> Iterator["Image"]:
    """Return the frames as they are, each at its own size, unless the look names one."""
    framing = Framing(look, in_time(film.shapes, film.times), film.pixelated)
    for index in tracked(range(len(film)), report):
        frame = film.picture(index)
        yield framing.unscaled(frame) if look.canvas == "dynamic" else framing(frame)


def _names(film: Film) -> Iterator[str]:
    digits = max(4, len(str(len(film) - 1)))
    return (f"frame-{number:0{digits}d}" for number in range(len(film)))


def write_png_folder(film: Film, look: Look, folder: Path, report: Report) -> None:
    """Write a new folder of PNG files."""
    folder.mkdir()
    info = as_png_info(film.parameters)
    for name, picture in zip(_names(film), _pictures(film, look, report), strict=True):
        picture.save(folder / f"{name}.png", pnginfo=info)


def write_tiff_folder(film: Film, look: Look, folder: Path, report: Report) -> None:
    """Write a new folder of TIFF files."""
    folder.mkdir()
    text = as_text(film.parameters)
    for name, picture in zip(_names(film), _pictures(film, look, report), strict=True):
        picture.save(folder / f"{name}.tif", compression=DEFLATE, description=text)


def write_tiff(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write one TIFF with a page for each frame."""
    pictures = _pictures(film, look, report)
    next(pictures).save(
        file, format="TIFF", save_all=True, append_images=pictures, compression=DEFLATE,
        description=as_text(film.parameters),
    )  # fmt: skip
