"""Animated WebP and PNG, with opacity, frame by frame."""

from pathlib import Path
from typing import TYPE_CHECKING

from clmorph._shared.progress import Report, Share, tracked
from clmorph.output.formats.apng import write_frames
from clmorph.output.formats.limits import check_sides, encoding
from clmorph.output.framing import Framing, Look, in_time
from clmorph.output.playback import whole_units
from clmorph.output.provenance import as_exif, as_png_info
from clmorph.output.recording import Film

if TYPE_CHECKING:
    from PIL.Image import Image

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 384
#: Of lossy WebP, 0 to 100.
WEBP_QUALITY = 90
#: WebP's longest side, in pixels: it has 14 bits.
WEBP_MOST = 16383


def _framing(film: Film, look: Look) -> Framing:
    return Framing(look, in_time(film.shapes, film.times), film.pixelated, SIDE)


def _milliseconds(film: Film) -> list[int]:
    return whole_units([seconds for _, seconds in film.played()], 1000)


@encoding("WebP")
def write_webp(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write an animated WebP, lossy unless the look says otherwise."""
    count = len(film.played())
    framing = _framing(film, look)
    check_sides(framing.size, WEBP_MOST, "WebP")
    _reel(film, framing, report).save(
        file, format="WEBP", save_all=True, duration=_milliseconds(film),
        loop=int(film.motion.loop == "once"), lossless=look.lossless, exact=look.lossless,
        quality=80 if look.lossless else WEBP_QUALITY, method=4, exif=as_exif(film.parameters),
    )  # fmt: skip
    report(Share(1.0, f"{count} of {count}"))


def _reel(film: Film, framing: Framing, report: Report) -> "Image":
    """Return an image of many frames, of which one is there at a time.

    Pillow makes a list of images that are to be appended, but asks one of many frames for one
    after the other. When it asks for the next, those before are written.
    """
    from PIL import Image

    order = [index for index, _ in film.played()]
    reel = Image.new("RGBA" if framing.clear else "RGB", framing.size)
    shown = -1

    def seek(number: int) -> None:
        nonlocal shown
        # Afterwards Pillow winds back to the first, for which there is no use.
        if number != shown + 1:
            return
        if number > 0:
            report(Share(number / len(order), f"{number} of {len(order)}"))
        reel.paste(framing(film.picture(order[number])))
        shown = number

    reel.__dict__.update(n_frames=len(order), seek=seek)
    return reel


@encoding("animated PNG")
def write_apng(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write an animated PNG."""
    framing = _framing(film, look)
    durations = _milliseconds(film)
    shown = [(index, time) for (index, _), time in zip(film.played(), durations, strict=True)]
    frames = ((framing(film.picture(index)), time) for index, time in tracked(shown, report))
    with file.open("wb") as stream:
        plays = int(film.motion.loop == "once")
        write_frames(stream, frames, durations, plays, as_png_info(film.parameters))
