"""Morph a still into a clip, a clip into a still, or a clip into a clip, while both play."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import Share, StageProgress
from clmorph._shared.typing import AnyArray, ArrayLike
from clmorph._shared.validation import check_max_pixels, check_number, check_progress
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import ends_of
from clmorph.frames.layers import Layers, Moment
from clmorph.images.pixels import MAX_PIXELS, reduced_shape
from clmorph.output.playback import eased
from clmorph.pipeline.clip_frames import Frames, Size
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.morph import ImagePair
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO

#: Seconds between two pairs of frames whose transport is solved.
EVERY = 0.25
#: Seconds in which one becomes the other, and the most that are held in memory.
SECONDS, LONGEST = 1.0, 60.0


@documented(MorphOptions)
def morph_clip(
    source: ArrayLike | str | PathLike[str],
    target: ArrayLike | str | PathLike[str],
    options: MorphOptions | None = None,
    *,
    every: float = EVERY,
    max_pixels: int = MAX_PIXELS,
    backend: Backend = "auto",
    progress: StageProgress | None = None,
    **given: Unpack[MorphKeywords],
) -> Iterator[NDArray[np.float32]]:
    """Morph a still into a clip, a clip into a still, or a clip into a clip, while both play.

    The film begins with the source and ends with the target. During the last `duration` seconds of
    the source, the first ones of the target, one becomes the other. The transport is solved
    between pairs of frames `every` so many seconds, and carried from one pair to the next. Frames
    are read and drawn as they are asked for; those of the transition are held in memory.

    Parameters
    ----------
    source, target : array, path or iterable of arrays
        A still (see `clmorph.images.pixels.as_pixels`), the path of a clip, or the frames of one,
        all of one size; at least one is a clip.
    options : MorphOptions, optional
        All options at once; options given by name replace those of this object. `duration` is that
        of the transition, by default one second, and both clips last at least as long. `fps` given
        by name takes the place of the rate of the first clip in a file (25 without one). Frames
        keep their size unless `size` is given, and landmarks are not sought.
    every : float
        Seconds between two pairs of frames that are solved.
    max_pixels : int
        Larger frames are refused.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    progress : callable, optional
        A function that is called with a stage's name and the share of it that is done.
    {options}

    Returns
    -------
    iterator of (H, W, 3) float32 arrays
        sRGB in [0, 1], of the size of the first clip. A still is shown once beside the transition.

    Raises
    ------
    InputError
        If an argument cannot be used, or (FileError) a clip; while frames are read, too.
    DeviceError
        If the device cannot be found or fails.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> clip = np.zeros((6, 8, 8, 3))
    >>> for number, frame in enumerate(clip):
    ...     frame[2:5, number : number + 3] = 1.0
    >>> film = clmorph.morph_clip(clip, np.ones((8, 8)), duration=0.2, fps=20, backend="numpy")
    >>> frames = list(film)
    >>> len(frames), frames[0].shape
    (7, (8, 8, 3))
    """
    named = dict(given)
    rate: Any = named.pop("fps", None)
    return clip_film(
        source, target, options, rate=rate, every=every, max_pixels=max_pixels,
        backend=backend, progress=progress, given=named,
    ).frames()  # fmt: skip


def clip_film(
    source: Any,
    target: Any,
    options: MorphOptions | None,
    *,
    rate: float | None,
    every: float,
    max_pixels: int,
    backend: Backend,
    progress: StageProgress | None,
    given: dict[str, Any],
) -> ClipFilm:
    """Return the film of `morph_clip`, whose arguments are checked."""
    every = check_number("every", every, 0.0, LONGEST, open_low=True)
    chosen = _options(options, given)
    seconds = chosen.duration or SECONDS
    if seconds > LONGEST:
        raise InputError(
            f"duration={seconds:g}: expected at most {LONGEST:g} s for a transition, whose frames "
            "are held in memory"
        )
    max_pixels = check_max_pixels(max_pixels)
    ends = Frames("source", source, max_pixels), Frames("target", target, max_pixels)
    if all(end.still is not None for end in ends):
        raise InputError("source and target are stills: expected a clip; see clmorph.morph")
    rates = [end.rate for end in ends if end.rate is not None]
    if rate is not None:
        rates = [Fraction(check_number("fps", rate, 0.1, 240.0)).limit_denominator(1001)]
    clip = next(end for end in ends if end.still is None)
    height, width = reduced_shape(clip.size[::-1], chosen.size or max(clip.size))
    return ClipFilm(
        ends, seconds, every, rates[0] if rates else Fraction(25), (width, height), chosen,
        get_backend(backend), check_progress(progress),
    )  # fmt: skip


def _options(options: MorphOptions | None, given: dict[str, Any]) -> MorphOptions:
    if options is None:
        chosen = MorphOptions(**{"size": None} | given)
    else:
        chosen = MorphOptions.of_call(options, given, "blur=0.05")
    if chosen.detail != "layers":
        raise InputError(
            f"detail={chosen.detail!r} is for stills: expected 'layers' for a clip, as in the "
            "preset 'photo'"
        )
    if chosen.endpoints == "paper" or chosen.sigma is not None:
        raise InputError("endpoints='paper' and sigma are for stills: leave them out for a clip")
    return chosen.replace(landmarks=None) if chosen.landmarks == AUTO else chosen


@dataclass(frozen=True)
class ClipFilm:
    """A film in which a source becomes a target while both play; see `morph_clip`."""

    ends: tuple[Frames, Frames]
    seconds: float
    every: float
    rate: Fraction
    size: Size
    options: MorphOptions
    operations: Operations
    progress: StageProgress

    @property
    def count(self) -> int:
        """The number of frames of the transition."""
        return max(2, round(self.seconds * self.rate))

    def frames(self) -> Iterator[NDArray[np.float32]]:
        """Yield all frames."""
        return (frame for _, frame in self.parts())

    def parts(self) -> Iterator[tuple[float, NDArray[np.float32]]]:
        """Yield how far the transition is, from 0 to 1, and the frame."""
        source, target = self.ends
        firsts: list[AnyArray] = []
        if source.still is not None:
            yield 0.0, self._single(source, source.still)
            firsts = [source.still] * self.count
        else:
            recent: deque[AnyArray] = deque()
            for pixels in source.pixels(self.rate):
                recent.append(pixels)
                if len(recent) > self.count:
                    yield 0.0, self._single(source, recent.popleft())
            firsts = list(recent)
            self._check_length("source", source, len(firsts))
        stream = None if target.still is not None else target.pixels(self.rate)
        for number, frame in enumerate(self._transition(firsts, stream), 1):
            yield number / (self.count + 1), frame
        if stream is None:
            assert target.still is not None
            yield 1.0, self._single(target, target.still)
        else:
            for pixels in stream:
                yield 1.0, self._single(target, pixels)

    def _single(self, end: Frames, pixels: AnyArray) -> NDArray[np.float32]:
        return end.shown(pixels, self.size).astype(np.float32)

    def _check_length(self, name: str, end: Frames, found: int) -> None:
        if found < self.count:
            raise InputError(
                f"{end.path or name} lasts {float(found / self.rate):.2f} s, and the transition "
                f"{self.count / float(self.rate):.2f} s (duration): expected a clip "
                "that lasts at least as long; lower it"
            )

    def _transition(
        self, firsts: list[AnyArray], stream: Iterator[AnyArray] | None
    ) -> Iterator[NDArray[np.float32]]:
        """Yield the frames in which one becomes the other."""
        source, target = self.ends
        count = self.count
        times = eased(np.linspace(0.0, 1.0, count + 2), self.options.ease)[1:-1]
        step = max(1, round(self.every * self.rate))
        keys = sorted({*range(0, count - 1, step), count - 1})
        others: deque[AnyArray] = deque()
        read = 0

        def pair(first: AnyArray, second: AnyArray) -> tuple[Any, Any]:
            return source.shown(first, self.size), target.shown(second, self.size)

        def drawn(carried: Moment, number: int) -> NDArray[np.float32]:
            shown = pair(firsts[number], others.popleft())
            return carried.frame(
                float(times[number]), shown, canvas, extent, self.options.path_space,
                self.operations,
            ).astype(np.float32)  # fmt: skip

        before: Moment | None = None
        last = 0
        for key in keys:
            while read <= key:
                found = target.still if stream is None else next(stream, None)
                if found is None:
                    self._check_length("target", target, read)
                assert found is not None
                others.append(found)
                read += 1
            moment, canvas, extent = self._solved(pair(firsts[key], others[-1]))
            for number in range(last, key) if before is not None else ():
                assert before is not None
                yield drawn(before.towards(moment, (number - last) / (key - last)), number)
                self.progress("frames", Share((number + 1) / count, f"{number + 1} of {count}"))
            before, last = moment, key
        assert before is not None
        yield drawn(before, count - 1)
        self.progress("frames", Share(1.0, f"{count} of {count}"))

    def _solved(self, pictures: tuple[Any, Any]) -> tuple[Moment, Canvas, str]:
        """Solve the transport between two frames; return what carries them, and their canvas."""
        pair = ImagePair(pictures, self.options)
        found = pair.morph(self.operations, self.progress)
        measures = found.source, found.target
        ends = ends_of(measures, found.pictures)
        canvas = found.canvas(0.0)
        layers = Layers(
            ends, measures, found.particles, (canvas, found.canvas(1.0)), self.operations,
            outlined=False,
        )  # fmt: skip
        return Moment.of(layers), canvas, ends[0].extent
