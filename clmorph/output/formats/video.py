"""``.mp4`` (H.264) and ``.webm`` (VP9), encoded by the FFmpeg inside PyAV."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.clips.writing import CONTAINERS, ClipWriter
from clmorph.errors import OutputError
from clmorph.output.formats.animation import timed_frames
from clmorph.output.formats.format import Format, check_sides, encoding
from clmorph.output.metadata import as_text
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 720


def check_video() -> None:
    """Raise OutputError if the library that writes videos is missing."""
    if find_spec("av") is None:
        raise OutputError(
            'video files need the extra "video": pip install "clmorph[video]"; or write .gif, '
            ".webp or .apng"
        )


def _write(
    container: str, recording: Recording, style: FrameStyle, file: Path, report: Report
) -> None:
    """Write a video, which has opacity if the frames have it and the container can hold it."""
    import av

    kind = CONTAINERS[container]
    framing = recording.framing(style, SIDE, even=True, opacity=kind.opacity)
    check_sides(framing.size, kind.longest_side, kind.words)
    rate = recording.motion.rate_for([seconds for _, seconds in recording.played()])
    shown = timed_frames(recording, rate)
    with (
        encoding(kind.words, av.error.FFmpegError),
        ClipWriter(
            file, container, framing.size, rate, 1 / rate, comment=as_text(recording.parameters),
            clear=framing.clear,
        ) as movie,
    ):  # fmt: skip
        number, last = 0, sum(repeats for _, repeats in shown)
        for index, repeats in tracked(shown, report):
            # A frame that is held is written repeatedly.
            times = range(number, number + repeats)
            movie.write(np.asarray(framing(recording.picture(index))), times, "LANCZOS")
            number += repeats
            if number == last:
                # The encoder is flushed before the last report, because it still holds frames.
                movie.finish()


def _read_metadata(container: str, path: Path) -> str:
    """Return the metadata text of a video: its comment."""
    if find_spec("av") is None:
        raise ValueError('videos need the extra "video": pip install "clmorph[video]"')
    import av

    try:
        # FFmpeg gets an open stream and one container, so that the file cannot make it open others.
        with path.open("rb") as file, av.open(file, format=container) as movie:
            tags = {name.lower(): value for name, value in movie.metadata.items()}
    except av.error.FFmpegError as error:
        raise ValueError(error.strerror or error) from None
    return tags.get("comment", "")


FORMATS = tuple(
    Format(
        name=name, endings=(f".{name}",), write=partial(_write, name),
        read_metadata=partial(_read_metadata, name), signatures=(signature,), animated=True,
        check=check_video,
    )
    # In MP4 four bytes of length stand before the signature.
    for name, signature in (("mp4", (4, b"ftyp")), ("webm", (0, b"\x1aE\xdf\xa3")))
)  # fmt: skip
