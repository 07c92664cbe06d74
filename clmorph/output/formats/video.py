"""MP4 (H.264) and WebM (VP9), by the FFmpeg that PyAV brings."""

from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.progress import Report, tracked
from clmorph.errors import OutputError
from clmorph.output.formats.limits import check_sides, encoding
from clmorph.output.framing import FrameStyle, Framing, in_time
from clmorph.output.playback import whole_units
from clmorph.output.provenance import as_text
from clmorph.output.recording import Recording

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 720
#: Each container's codec and its options: constant quality, visually near to lossless.
CODECS: dict[str, tuple[str, dict[str, str]]] = {
    # x264's macroblock tree reads memory that nothing was written to, so bytes would differ.
    "mp4": ("libx264", {"crf": "14", "preset": "medium", "mbtree": "0"}),
    "webm": ("libvpx-vp9", {"crf": "16", "b": "0", "deadline": "good", "cpu-used": "3"}),
}
#: What they are called, and their encoders' longest side, in pixels.
LIMITS = {"mp4": ("H.264", 16384), "webm": ("VP9", 65536)}
#: ITU-T H.273 code points: the matrix and primaries of BT.709, the transfer curve of sRGB.
BT709, SRGB_CURVE = 1, 13


def check_video() -> None:
    """Raise OutputError if the library that writes videos is not there."""
    if find_spec("av") is None:
        raise OutputError(
            'video files need the extra "video": pip install "clmorph[video]"; or write .gif, '
            ".webp or .apng"
        )


def write_mp4(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write H.264 in an MP4 that plays while it loads."""
    _write(recording, style, file, report, "mp4", {"movflags": "+faststart+use_metadata_tags"})


def write_webm(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write VP9 in a WebM; with opacity if the frames have it."""
    _write(recording, style, file, report, "webm", {})


def _write(
    recording: Recording,
    style: FrameStyle,
    file: Path,
    report: Report,
    container: str,
    options: dict[str, str],
) -> None:
    import av
    from av.video.reformatter import ColorRange, Colorspace

    framing = Framing(
        style, in_time(recording.shapes, recording.times), recording.pixelated, SIDE, even=True,
        opacity=container == "webm",
    )  # fmt: skip
    words, most = LIMITS[container]
    check_sides(framing.size, most, words)
    pixels = "yuva420p" if framing.clear else "yuv420p"
    codec, settings = CODECS[container]
    played = recording.played()
    lengths = [seconds for _, seconds in played]
    rate = recording.motion.rate_for(lengths)
    # Without the encoder's version and a random number: the same recording gives the same bytes.
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
            # A picture that holds is a frame that is repeated.
            for _ in range(repeats):
                image.pts, image.time_base = number, Fraction(1) / rate
                movie.mux(stream.encode(image))
                number += 1
            if number == sum(lasting):
                # Before the last report: what the encoder has looked ahead at is still to come.
                movie.mux(stream.encode(None))
