"""Animated WebP and PNG, with opacity."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from clmorph.film import Film
from clmorph.formats.embedding import as_exif, as_png_info
from clmorph.framing import Framing, Look, in_time
from clmorph.motion import whole_units
from clmorph.progress import Report, tracked

if TYPE_CHECKING:
    from PIL.Image import Image

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 384
#: Of lossy WebP, 0 to 100.
WEBP_QUALITY = 90


class _Pictures:
    """The pictures as they are played, made anew whenever they are gone through."""

    def __init__(self, film: Film, look: Look, report: Report) -> None:
        self._film, self._report = film, report
        self._framing = Framing(look, in_time(film.shapes, film.times), film.pixelated, SIDE)
        self._order = [index for index, _ in film.played()]

    @property
    def first(self) -> "Image":
        return self._framing(self._film.picture(self._order[0]))

    def __iter__(self) -> Iterator["Image"]:
        """Return all but the first."""
        for index in tracked(self._order[1:], self._report):
            yield self._framing(self._film.picture(index))


def _milliseconds(film: Film) -> list[int]:
    return whole_units([seconds for _, seconds in film.played()], 1000)


def write_webp(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write an animated WebP, lossy unless the look says otherwise."""
    pictures = _Pictures(film, look, report)
    pictures.first.save(
        file, format="WEBP", save_all=True, append_images=pictures, duration=_milliseconds(film),
        loop=int(film.motion.loop == "once"), lossless=look.lossless, exact=look.lossless,
        quality=80 if look.lossless else WEBP_QUALITY, method=4, exif=as_exif(film.parameters),
    )  # fmt: skip


def write_apng(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write an animated PNG."""
    # Pillow goes through them twice here: for their modes, then for their pixels.
    pictures = _Pictures(film, look, report)
    pictures.first.save(
        file, format="PNG", save_all=True, append_images=pictures, duration=_milliseconds(film),
        loop=int(film.motion.loop == "once"), pnginfo=as_png_info(film.parameters),
    )  # fmt: skip
