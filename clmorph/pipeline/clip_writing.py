"""Write a film of clips, with their sounds, which fade while one becomes the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import atomic_paths
from clmorph.clips.reading import SoundTrack
from clmorph.clips.writing import CONTAINERS, SOUND_RATE, ClipWriter, even
from clmorph.errors import OutputError
from clmorph.images.pixels import to_bytes
from clmorph.output.formats.format import check_sides, encoding
from clmorph.output.metadata import as_text
from clmorph.output.save import Output
from clmorph.pipeline.clip_morph import ClipFilm


def check_clip_outputs(outputs: Sequence[Output]) -> None:
    """Raise OutputError if an output cannot hold a film of clips."""
    for output in outputs:
        if output.name not in CONTAINERS:
            raise OutputError(
                f"{output.path}: a film of clips is written frame by frame: expected "
                f"{' or '.join(f'.{name}' for name in CONTAINERS)}"
            )


def write_clip_film(
    film: ClipFilm,
    outputs: Sequence[Output],
    parameters: Mapping[str, Any],
    texts: Mapping[Path, str] | None = None,
) -> int:
    """Write a film, and texts by their paths: all of them whole, or none; return its frames."""
    import av

    beside = dict(texts or {})
    with ExitStack() as stack:
        tracks = [
            None if end.path is None else stack.enter_context(SoundTrack(end.path))
            for end in film.ends
        ]
        sounding = any(track is not None and not track.silent for track in tracks)
        made = stack.enter_context(atomic_paths([*(output.place for output in outputs), *beside]))
        for path, text in zip(made[len(outputs) :], beside.values(), strict=True):
            path.write_text(text, "utf-8")
        size = film.size[0] + film.size[0] % 2, film.size[1] + film.size[1] % 2
        # The writers are closed before the files replace others.
        with ExitStack() as writing:
            writing.enter_context(encoding("the film", av.error.FFmpegError))
            writers = []
            for output, path in zip(outputs, made, strict=False):
                kind = CONTAINERS[output.name]
                check_sides(size, kind.longest_side, kind.words)
                writers.append(
                    writing.enter_context(
                        ClipWriter(
                            path, output.name, size, film.rate, 1 / film.rate,
                            comment=as_text(parameters), mixed=sounding, changes=kind.fast,
                        )
                    )
                )  # fmt: skip
            return _write(film, writers, tracks if sounding else [])


def _write(
    film: ClipFilm, writers: Sequence[ClipWriter], tracks: Sequence[SoundTrack | None]
) -> int:
    count, before = 0, 0.0
    for share, frame in film.parts():
        pixels = even(to_bytes(frame))
        for writer in writers:
            writer.write(pixels, [count])
        if tracks:
            begin, end = (round(Fraction(k) / film.rate * SOUND_RATE) for k in (count, count + 1))
            sound = _mixed(tracks, before, share, end - begin)
            for writer in writers:
                writer.write_sound(sound)
        count, before = count + 1, share
    for writer in writers:
        writer.finish()
    return count


def _mixed(
    tracks: Sequence[SoundTrack | None], before: float, share: float, count: int
) -> NDArray[np.float32]:
    """Return the next samples while the second sound, which begins there, takes over."""
    second = np.linspace(before, share, count, endpoint=False, dtype=np.float32)
    found = np.zeros((2, count), np.float32)
    first_track, second_track = tracks
    if first_track is not None and before < 1:
        found += (1 - second) * first_track.take(count)
    if second_track is not None and share > 0:
        found += second * second_track.take(count)
    return np.clip(found, -1.0, 1.0)
