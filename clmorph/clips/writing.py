"""Write a film frame by frame, with sound that is copied, by the FFmpeg inside PyAV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import reason_of
from clmorph.clips.tags import BT709, FULL, LIMITED, MATRICES, SRGB_CURVE, ColorTags
from clmorph.errors import OutputError


class Container(NamedTuple):
    """A container of video, and the encoder for it."""

    #: FFmpeg's name of the encoder.
    codec: str
    #: The encoder's options, for constant quality that is visually close to lossless.
    settings: dict[str, str]
    #: The options that are other ones for clips, whose frames are many and large.
    fast: dict[str, str]
    #: The container's options.
    options: dict[str, str]
    #: The name of the encoding, for people.
    words: str
    #: The encoder's longest side, in pixels.
    longest_side: int
    #: Whether the container can hold opacity.
    opacity: bool
    #: FFmpeg's name of the encoder of sound that is mixed.
    sound: str


#: Every container by FFmpeg's name of it.
CONTAINERS = {
    "mp4": Container(
        # x264's macroblock tree reads uninitialized memory, so the bytes of files would differ.
        "libx264", {"crf": "14", "preset": "medium", "mbtree": "0"}, {"preset": "veryfast"},
        # The index stands first, so that a page plays the file while it loads.
        {"movflags": "+faststart+use_metadata_tags"}, "H.264", 16384, opacity=False, sound="aac",
    ),
    "webm": Container(
        "libvpx-vp9", {"crf": "16", "b": "0", "deadline": "good", "cpu-used": "3"},
        {"deadline": "realtime", "cpu-used": "6", "row-mt": "1"},
        {}, "VP9", 65536, opacity=True, sound="libopus",
    ),
}  # fmt: skip
#: Samples a second of sound that is mixed.
SOUND_RATE = 48_000
#: The colors of films that clmorph makes.
OWN_TAGS = ColorTags(BT709, LIMITED, BT709, SRGB_CURVE)


class ClipWriter:
    """A film that is being written; a context manager, which closes it.

    The `size` (width, height) of frames is even; `rate` is in frames a second, and `time_base` the
    unit of their times in seconds. `sounds` are `Clip.sounds` whose packets are copied, and `mixed`
    tells that there is sound which `write_sound` encodes. With `deep` pictures have 10 bits a
    channel. `changes` are options of the encoder in place of the container's.
    """

    def __init__(
        self,
        file: Path,
        container: str,
        size: tuple[int, int],
        rate: Fraction,
        time_base: Fraction,
        tags: ColorTags = OWN_TAGS,
        matrix: int = BT709,
        *,
        aspect: Fraction = Fraction(1),
        comment: str = "",
        clear: bool = False,
        deep: bool = False,
        sounds: Sequence[Any] = (),
        mixed: bool = False,
        changes: Mapping[str, str] | None = None,
    ) -> None:
        import av
        from av.video.reformatter import VideoReformatter

        kind = CONTAINERS[container]
        # One for all frames: it makes tables on its first use.
        self._reformatter = VideoReformatter()
        # The file omits the encoder's version and a random number, so that the same frames give
        # the same bytes.
        options = kind.options | {"fflags": "+bitexact"}
        with ExitStack() as stack:
            self._movie: Any = stack.enter_context(
                av.open(str(file), "w", format=container, options=options)
            )
            self._movie.metadata["comment"] = comment
            settings = kind.settings | dict(changes or {})
            stream: Any = self._movie.add_stream(kind.codec, rate=rate, options=settings)
            self._stream, self._time_base = stream, time_base
            self._matrix, self._range = matrix, FULL if tags.range == FULL else LIMITED
            self._pixels = "yuva420p" if clear else "yuv420p10le" if deep else "yuv420p"
            self._mode = "rgba" if clear else "gbrp16le" if deep else "rgb24"
            stream.width, stream.height = size
            stream.pix_fmt = self._pixels
            stream.time_base = time_base
            context = stream.codec_context
            context.time_base = time_base
            context.sample_aspect_ratio = aspect
            if clear:
                stream.metadata["alpha_mode"] = "1"
            context.color_range = self._range
            context.colorspace = tags.matrix if tags.matrix in MATRICES else matrix
            context.color_primaries, context.color_trc = tags.primaries, tags.transfer
            self._sounds = {each.index: self._copy_of(each, kind.words) for each in sounds}
            self._mixed: Any = None
            if mixed:
                self._mixed = self._movie.add_stream(kind.sound, rate=SOUND_RATE, layout="stereo")
                self._samples = 0
            self._stack = stack.pop_all()

    def _copy_of(self, sound: Any, words: str) -> Any:
        try:
            return self._movie.add_stream_from_template(sound)
        except ValueError as error:
            raise OutputError(
                f"sound of the kind {sound.codec_context.name} cannot be copied beside {words} "
                f"({reason_of(error)}); convert it first, or choose another ending"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def write(self, pixels: NDArray[Any], times: Sequence[int], interpolation: Any = None) -> None:
        """Write a frame, (H, W, 3 or 4), at ascending times in units of `time_base`."""
        import av
        from av.video.reformatter import Interpolation

        given = av.VideoFrame.from_ndarray(pixels, self._mode)
        image = self._reformatter.reformat(
            given, format=self._pixels, dst_colorspace=self._matrix, src_color_range=FULL,
            dst_color_range=self._range,
            interpolation=interpolation or (
                Interpolation.BILINEAR | Interpolation.ACCURATE_RND
                | Interpolation.FULL_CHR_H_INP | Interpolation.BITEXACT
            ),
        )  # fmt: skip
        image.time_base = self._time_base
        for time in times:
            image.pts = time
            self._movie.mux(self._stream.encode(image))

    def copy(self, packet: Any) -> None:
        """Write a packet of sound of the clip whose `sounds` were given."""
        packet.stream = self._sounds[packet.stream.index]
        self._movie.mux(packet)

    def write_sound(self, samples: NDArray[np.float32]) -> None:
        """Write the next samples of stereo sound, (2, n) in [-1, 1], `SOUND_RATE` a second."""
        import av

        sound = av.AudioFrame.from_ndarray(
            np.ascontiguousarray(samples), format="fltp", layout="stereo"
        )
        sound.sample_rate, sound.time_base = SOUND_RATE, Fraction(1, SOUND_RATE)
        sound.pts, self._samples = self._samples, self._samples + samples.shape[1]
        self._movie.mux(self._mixed.encode(sound))

    def finish(self) -> None:
        """Write what the encoders still hold; nothing can be written afterwards."""
        self._movie.mux(self._stream.encode(None))
        if self._mixed is not None:
            self._movie.mux(self._mixed.encode(None))


def even(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return a frame with even sides, whose last row and column are repeated."""
    odd = [(0, side % 2) for side in pixels.shape[:2]]
    return np.pad(pixels, (*odd, (0, 0)), mode="edge") if any(map(max, odd)) else pixels
