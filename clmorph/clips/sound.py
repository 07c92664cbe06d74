"""The sound of a clip as samples, in step with its frames."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import reason_of
from clmorph.clips.reading import DEMUXERS
from clmorph.clips.writing import SOUND_RATE
from clmorph.errors import FileError

Samples = NDArray[np.float32]


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
