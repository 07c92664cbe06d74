"""Read a clip frame by frame, with its sound as it is stored or as samples, by FFmpeg in PyAV."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from fractions import Fraction
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import reason_of
from clmorph.clips.tags import FULL, LIMITED, UNKNOWN, ColorTags
from clmorph.clips.writing import SOUND_RATE
from clmorph.errors import FileError
from clmorph.images.pixels import MAX_PIXELS
from clmorph.images.reading.opening import check_size

#: Containers that are read. Lists of other files are not among them: a clip opens no other file.
DEMUXERS = "mov,matroska,avi,mpegts,mpeg,flv,ogg,asf,mxf,gif,mp3,wav,flac,aac"
#: Frames a second of a clip that does not say, and the most that are believed.
USUAL_RATE, FASTEST = Fraction(25), Fraction(1000)
#: Seconds, and frames, that may be missing at the end of a clip that is not damaged.
MISSING, MISSING_FRAMES = 0.25, 3
#: Degrees of a quarter of a turn.
QUARTER = 90
Samples = NDArray[np.float32]


class Frame(NamedTuple):
    """One frame of a clip, upright."""

    #: (H, W, 3) array of the clip's own R'G'B', uint8 or (of more than 8 bits a channel) uint16.
    pixels: NDArray[Any]
    #: When it is shown, in seconds.
    time: Fraction


class Sound(NamedTuple):
    """A packet of sound, in the order of the file, which `ClipWriter.copy` takes."""

    packet: Any


class _Decoded(NamedTuple):
    """A frame as FFmpeg has it, None after the last one, and the packets of sound before it."""

    frame: Any
    time: Fraction
    sounds: list[Any]


class Clip:
    """A clip that is read from its beginning to its end; also a context manager, which closes it.

    Attributes are set on opening: `size` (width, height) of upright frames in pixels, `rate` (mean
    frames a second), `time_base` (seconds, the unit of times), `duration` (seconds, None if the
    file does not tell), `tags` (of its colors), `deep` (whether it has more than 8 bits a channel),
    `aspect` (of a pixel), and `sounds`, the streams that `ClipWriter` takes as a template.

    Raises FileError if the file cannot be read, has no moving picture, or is of a kind that cannot
    be shown, such as one of high dynamic range.
    """

    def __init__(self, path: str | PathLike[str], max_pixels: int = MAX_PIXELS) -> None:
        self.path, self._max_pixels = Path(path), max_pixels
        if find_spec("av") is None:
            raise FileError(f'{path}: clips need the extra "video": pip install "clmorph[video]"')
        import av
        from av.video.reformatter import VideoReformatter

        self._errors: Any = av.error.FFmpegError
        # One for all frames: it makes tables on its first use.
        self._reformatter = VideoReformatter()
        with ExitStack() as stack:
            try:
                # FFmpeg gets an open stream, so that the file's name cannot mean anything else.
                file = stack.enter_context(self.path.open("rb"))
                self._container: Any = stack.enter_context(
                    av.open(file, options={"format_whitelist": DEMUXERS}, metadata_errors="replace")
                )
            except self._errors as error:
                raise FileError(
                    f"{self.path}: this is not a readable clip ({reason_of(error)}); expected "
                    "a film such as .mp4, .mov, .mkv or .webm"
                ) from None
            except (OSError, ValueError) as error:
                raise FileError(f"{self.path}: it cannot be read ({reason_of(error)})") from None
            self._open(av)
            self._stack = stack.pop_all()

    def _open(self, av: Any) -> None:
        streams = self._container.streams
        cover = av.stream.Disposition.attached_pic
        pictures = [each for each in streams.video if not each.disposition & cover]
        if not pictures:
            what = "sound without a picture" if streams.audio else "no picture"
            raise FileError(f"{self.path}: this file has {what}; expected a film")
        self._video = stream = pictures[0]
        stream.thread_type = "AUTO"
        self.sounds = list(streams.audio)
        # A recording of a broadcast begins at any time, with the sound.
        self._zero = Fraction(max(0, self._container.start_time or 0), 1_000_000)
        self.time_base = Fraction(stream.time_base or Fraction(1, 1000))
        rate = stream.average_rate or stream.guessed_rate or USUAL_RATE
        self.rate = Fraction(rate) if 0 < rate <= FASTEST else USUAL_RATE
        self.duration = self._duration()
        self._decoded = self._decode()
        self._next = next(self._decoded, None)
        if self._next is None:
            raise FileError(f"{self.path}: the film has no frames; expected at least one")
        frame, context = self._next.frame, stream.codec_context
        names = "colorspace", "color_range", "color_primaries", "color_trc"
        codes = ([int(getattr(each, name)) for each in (frame, context)] for name in names)
        self.tags = ColorTags(*(other if own in UNKNOWN else own for own, other in codes))
        unreadable = self.tags.unreadable()
        if unreadable:
            raise FileError(
                f"{self.path}: {unreadable}, which is not read; convert it to BT.709 first"
            )
        self.deep = any(part.bits > 8 for part in frame.format.components)
        self._turns = round((frame.rotation or 0) / QUARTER) % 4
        self._coded = frame.width, frame.height
        check_size(self.path, self._coded, self._max_pixels)
        self.size = self._coded if self._turns % 2 == 0 else self._coded[::-1]
        aspect = Fraction(stream.sample_aspect_ratio or 1)
        self.aspect = (1 / aspect if self._turns % 2 else aspect) if aspect > 0 else Fraction(1)

    def _duration(self) -> float | None:
        """Return the length of the film in seconds, if the file tells it."""
        stream = self._video
        if stream.duration:
            return float(stream.duration * self.time_base)
        # Matroska's streams have a text.
        parts = str(stream.metadata.get("DURATION", "")).split(":")
        with suppress(ValueError):
            hours, minutes, seconds = map(float, parts)
            return 3600 * hours + 60 * minutes + seconds
        known = self._container.duration
        # The whole may be longer than the film because of its sound.
        return known / 1e6 if known and not self.sounds else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    @property
    def matrix(self) -> int:
        """The matrix by which frames become R'G'B': that of the tags or, without, of the size."""
        return self.tags.scaler_matrix(self._coded[1])

    def parts(self) -> Iterator[Frame | Sound]:
        """Yield frames and packets of sound in order, once; FileError where the file is damaged."""
        while self._next is not None:
            frame, time, sounds = self._next
            yield from map(Sound, sounds)
            if frame is not None:
                yield self._frame(frame, time)
            self._next = next(self._decoded, None)

    def frames(self) -> Iterator[Frame]:
        """Yield frames alone, once."""
        return (part for part in self.parts() if isinstance(part, Frame))

    def numbered(self, number: int) -> Frame | None:
        """Return a frame by its number from 0, in place of all others; None beyond the end."""
        while self._next is not None and number > 0:
            self._next, number = next(self._decoded, None), number - 1
        if self._next is None or self._next.frame is None:
            return None
        return self._frame(self._next.frame, self._next.time)

    def _decode(self) -> Iterator[_Decoded]:
        """Yield frames of FFmpeg, each with the packets of sound before it."""
        sounds: list[Any] = []
        last, count = Fraction(-1), 0
        try:
            for packet in self._container.demux([self._video, *self.sounds]):
                if packet.stream is not self._video:
                    if packet.dts is not None:
                        begin = round(self._zero / packet.time_base)
                        packet.dts -= begin
                        packet.pts = None if packet.pts is None else packet.pts - begin
                        sounds.append(packet)
                    continue
                for frame in packet.decode():
                    if frame.is_corrupt:
                        raise self._damaged(last, "a frame is incomplete")
                    last = self._time(frame, last, count)
                    count += 1
                    yield _Decoded(frame, last, sounds)
                    sounds = []
        except self._errors as error:
            raise self._damaged(last, reason_of(error)) from None
        if count:
            self._check_end(last, count)
            if sounds:
                yield _Decoded(None, last, sounds)

    def _time(self, frame: Any, last: Fraction, count: int) -> Fraction:
        """Return when a frame is shown: later than the last one, by the rate if none is given."""
        if frame.pts is None:
            return last + 1 / self.rate if count else Fraction(0)
        time = frame.pts * Fraction(frame.time_base)
        return time if not count or time > last else last + self.time_base

    def _check_end(self, last: Fraction, count: int) -> None:
        """Raise FileError if frames are missing that the file has announced."""
        announced = self._video.frames
        missing = (announced - count) / float(self.rate)
        if not announced:
            missing = (self.duration or 0.0) - float(last - self._start() + 1 / self.rate)
        if missing > max(MISSING, MISSING_FRAMES / float(self.rate)):
            raise self._damaged(last, f"its last {missing:.1f} s are missing")

    def _start(self) -> Fraction:
        return Fraction((self._video.start_time or 0) * self.time_base)

    def _damaged(self, last: Fraction, reason: str) -> FileError:
        when = max(0.0, float(last - self._start()))
        return FileError(
            f"{self.path}: the film is damaged after {when:.1f} s ({reason}); cut it there, or get "
            "a whole copy"
        )

    def _frame(self, frame: Any, time: Fraction) -> Frame:
        """Return a frame of FFmpeg as R'G'B', upright."""
        from av.video.reformatter import Interpolation

        if (frame.width, frame.height) != self._coded:
            raise FileError(
                f"{self.path}: frames change their size after {float(time):.1f} s, from "
                f"{self._coded[0]} x {self._coded[1]} to {frame.width} x {frame.height} pixels; "
                "expected one size"
            )
        found = self._reformatter.reformat(
            frame, format="gbrp16le" if self.deep else "rgb24",
            src_colorspace=self.matrix,
            src_color_range=FULL if self.tags.range == FULL else LIMITED,
            dst_color_range=FULL,
            interpolation=(
                Interpolation.BILINEAR | Interpolation.ACCURATE_RND
                | Interpolation.FULL_CHR_H_INT | Interpolation.BITEXACT
            ),
        )  # fmt: skip
        pixels: NDArray[Any] = found.to_ndarray()
        if self._turns:
            pixels = np.ascontiguousarray(np.rot90(pixels, self._turns))
        return Frame(pixels, time - self._zero)

    def at(self, time: float) -> Frame | None:
        """Return the frame that is shown at a time in seconds from the start; None beyond the end.

        The clip can no longer be read from its beginning.
        """
        wanted = float(self._start()) + time
        found = None
        try:
            self._container.seek(math.floor(wanted / self.time_base), stream=self._video)
            for frame in self._container.decode(self._video):
                when = self._time(frame, Fraction(-1), 0)
                if float(when) > wanted and found is not None:
                    break
                found = frame, when
        except self._errors as error:
            raise self._damaged(Fraction(wanted), reason_of(error)) from None
        return None if found is None else self._frame(*found)


class SoundTrack:
    """Stereo samples of a clip's first sound from its first frame on; `silent` if it has none."""

    def __init__(self, path: Path) -> None:
        import av

        self._path, self._errors = path, av.error.FFmpegError
        self._file = path.open("rb")
        self._container: Any = av.open(
            self._file, options={"format_whitelist": DEMUXERS}, metadata_errors="replace"
        )
        streams = self._container.streams
        self.silent = not streams.audio
        self._rest: Samples = np.zeros((2, 0), np.float32)
        video = streams.video[0]
        self._start = Fraction(video.start_time or 0) * Fraction(video.time_base or 1)
        self._blocks = iter(()) if self.silent else self._decoded(av)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._container.close()
        self._file.close()

    def take(self, count: int) -> Samples:
        """Return the next samples, (2, count); silence beyond the end."""
        parts, known = [self._rest], self._rest.shape[1]
        while known < count:
            block = next(self._blocks, None)
            if block is None:
                block = np.zeros((2, count - known), np.float32)
            parts.append(block)
            known += block.shape[1]
        whole = np.concatenate(parts, axis=1)
        self._rest = whole[:, count:]
        return whole[:, :count]

    def _decoded(self, av: Any) -> Iterator[Samples]:
        """Yield blocks of samples; gaps between them are silence."""
        resampler = av.AudioResampler(format="fltp", layout="stereo", rate=SOUND_RATE)
        place = 0
        try:
            for frame in self._container.decode(self._container.streams.audio[0]):
                if frame.pts is None:
                    begin = place
                else:
                    when = frame.pts * Fraction(frame.time_base) - self._start
                    begin = round(when * SOUND_RATE)
                for each in resampler.resample(frame):
                    block = each.to_ndarray()
                    # Rounded times of frames that follow one another are no gaps.
                    if abs(begin - place) > SOUND_RATE // 50:
                        if begin > place:
                            yield np.zeros((2, begin - place), np.float32)
                        block, begin = block[:, max(0, place - begin) :], max(place, begin)
                        place = begin
                    yield block
                    place += block.shape[1]
                    begin = place
        except self._errors as error:
            raise FileError(
                f"{self._path}: its sound is damaged ({reason_of(error)}); get a whole copy, or "
                "take the sound out"
            ) from None


#: The first bytes of clips and where they stand, and brands of pictures in the container of MP4.
_SIGNATURES = (
    (4, b"ftyp"), (4, b"moov"), (4, b"mdat"), (0, b"\x1aE\xdf\xa3"), (8, b"AVI LIST"),
    (0, b"FLV\x01"), (0, b"OggS"), (0, b"\0\0\x01\xba"), (0, b"\0\0\x01\xb3"),
    (0, b"0&\xb2u\x8ef\xcf\x11"),
)  # fmt: skip
_PICTURES = (b"avif", b"avis", b"heic", b"heix", b"hevc", b"hevx", b"mif1", b"msf1")
#: Bytes from one packet of an MPEG transport stream to the next, each of which begins with G.
_PACKET = 188


def is_clip(path: Path) -> bool:
    """Return whether a file is a clip by its first bytes; False if it cannot be read."""
    try:
        with path.open("rb") as file:
            start = file.read(2 * _PACKET + 1)
    except (OSError, ValueError):
        return False
    if start[4:8] == b"ftyp" and start[8:12] in _PICTURES:
        return False
    stream = len(start) > 2 * _PACKET and {start[k * _PACKET] for k in range(3)} == {0x47}
    return stream or any(start.startswith(mark, place) for place, mark in _SIGNATURES)
