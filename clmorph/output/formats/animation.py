"""Animated WebP and PNG, with opacity, frame by frame."""

from pathlib import Path
from typing import TYPE_CHECKING

from clmorph._shared.progress import Report, Share, tracked
from clmorph.output.formats.apng import write_frames
from clmorph.output.formats.limits import check_sides, encoding
from clmorph.output.framing import FrameStyle, Framing, in_time
from clmorph.output.playback import whole_units
from clmorph.output.provenance import as_exif, as_png_info
from clmorph.output.recording import Recording

if TYPE_CHECKING:
    from PIL.Image import Image

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 384
#: Of lossy WebP, 0 to 100.
WEBP_QUALITY = 90
#: WebP's longest side, in pixels: it has 14 bits.
WEBP_MOST = 16383


def _framing(recording: Recording, style: FrameStyle) -> Framing:
    return Framing(style, in_time(recording.shapes, recording.times), recording.pixelated, SIDE)


def _milliseconds(recording: Recording) -> list[int]:
    return whole_units([seconds for _, seconds in recording.played()], 1000)


@encoding("WebP")
def write_webp(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write an animated WebP, lossy unless the style says otherwise."""
    count = len(recording.played())
    framing = _framing(recording, style)
    check_sides(framing.size, WEBP_MOST, "WebP")
    _reel(recording, framing, report).save(
        file, format="WEBP", save_all=True, duration=_milliseconds(recording),
        loop=int(recording.motion.loop == "once"), lossless=style.lossless, exact=style.lossless,
        quality=80 if style.lossless else WEBP_QUALITY, method=4,
        exif=as_exif(recording.parameters),
    )  # fmt: skip
    report(Share(1.0, f"{count} of {count}"))


def _reel(recording: Recording, framing: Framing, report: Report) -> "Image":
    """Return an image of many frames, of which one is there at a time.

    Pillow makes a list of images that are to be appended, but asks one of many frames for one
    after the other. When it asks for the next, those before are written.
    """
    from PIL import Image

    order = [index for index, _ in recording.played()]
    reel = Image.new("RGBA" if framing.clear else "RGB", framing.size)
    shown = -1

    def seek(number: int) -> None:
        nonlocal shown
        # Afterwards Pillow winds back to the first, for which there is no use.
        if number != shown + 1:
            return
        if number > 0:
            report(Share(number / len(order), f"{number} of {len(order)}"))
        reel.paste(framing(recording.picture(order[number])))
        shown = number

    reel.__dict__.update(n_frames=len(order), seek=seek)
    return reel


@encoding("animated PNG")
def write_apng(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write an animated PNG."""
    framing = _framing(recording, style)
    durations = _milliseconds(recording)
    shown = [(index, time) for (index, _), time in zip(recording.played(), durations, strict=True)]
    frames = ((framing(recording.picture(index)), time) for index, time in tracked(shown, report))
    with file.open("wb") as stream:
        plays = int(recording.motion.loop == "once")
        write_frames(stream, frames, durations, plays, as_png_info(recording.parameters))
