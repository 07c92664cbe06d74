"""``.mp4`` (H.264) and ``.webm`` (VP9), encoded by the FFmpeg inside PyAV."""

from fractions import Fraction
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.errors import OutputError
from clmorph.output.formats.format import Format
from clmorph.output.formats.limits import check_sides, encoding
from clmorph.output.metadata import as_text
from clmorph.output.options import FrameStyle
from clmorph.output.playback import whole_units
from clmorph.output.recording import Recording

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 720


class Container(NamedTuple):
    """A container of video, and the encoder for it."""

    #: FFmpeg's name of the encoder.
    codec: str
    #: The encoder's options, for constant quality that is visually close to lossless.
    settings: dict[str, str]
    #: The container's options.
    options: dict[str, str]
    #: The name of the encoding, for people.
    words: str
    #: The encoder's longest side, in pixels.
    longest_side: int
    #: Whether the container can hold opacity.
    opacity: bool


#: Every container by FFmpeg's name of it.
CONTAINERS = {
    "mp4": Container(
        # x264's macroblock tree reads uninitialized memory, so the bytes of files would differ.
        "libx264", {"crf": "14", "preset": "medium", "mbtree": "0"},
        # The index stands first, so that a page plays the file while it loads.
        {"movflags": "+faststart+use_metadata_tags"}, "H.264", 16384, opacity=False,
    ),
    "webm": Container(
        "libvpx-vp9", {"crf": "16", "b": "0", "deadline": "good", "cpu-used": "3"},
        {}, "VP9", 65536, opacity=True,
    ),
}  # fmt: skip
#: ITU-T H.273 code points: the matrix and primaries of BT.709, the transfer curve of sRGB.
BT709, SRGB_CURVE = 1, 13


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
    from av.video.reformatter import ColorRange, Colorspace

    codec, settings, options, words, longest_side, opacity = CONTAINERS[container]
    framing = recording.framing(style, SIDE, even=True, opacity=opacity)
    check_sides(framing.size, longest_side, words)
    pixels = "yuva420p" if framing.clear else "yuv420p"
    played = recording.played()
    lengths = [seconds for _, seconds in played]
    rate = recording.motion.rate_for(lengths)
    # The file omits the encoder's version and a random number, so that the same recording gives
    # the same bytes.
    options = options | {"fflags": "+bitexact"}
    with (
        encoding(words, av.error.FFmpegError),
        av.open(str(file), "w", format=container, options=options) as movie,
    ):
        movie.metadata["comment"] = as_text(recording.parameters)
        stream: Any = movie.add_stream(codec, rate=rate, options=settings)
        stream.width, stream.height = framing.size
        stream.pix_fmt = pixels
        stream.time_base = 1 / rate
        stream.codec_context.time_base = 1 / rate
        if framing.clear:
            stream.metadata["alpha_mode"] = "1"
        context = stream.codec_context
        context.color_range = ColorRange.MPEG
        context.colorspace = context.color_primaries = BT709
        context.color_trc = SRGB_CURVE
        mode = "rgba" if framing.clear else "rgb24"
        number = 0
        lasting = whole_units(lengths, rate)
        shown = [(index, repeats) for (index, _), repeats in zip(played, lasting, strict=True)]
        for index, repeats in tracked(shown, report):
            picture: Any = np.asarray(framing(recording.picture(index)))
            image = av.VideoFrame.from_ndarray(picture, mode).reformat(
                format=pixels, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG,
                interpolation="LANCZOS",
            )  # fmt: skip
            # A frame that is held is written repeatedly.
            for _ in range(repeats):
                image.pts, image.time_base = number, Fraction(1) / rate
                movie.mux(stream.encode(image))
                number += 1
            if number == sum(lasting):
                # The encoder is flushed before the last report, because it still holds frames.
                movie.mux(stream.encode(None))


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
