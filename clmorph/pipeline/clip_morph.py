"""Morph a still into a clip, a clip into a still, or a clip into a clip, while both play."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import closing
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import Share, StageProgress
from clmorph._shared.typing import AnyArray, ArrayLike
from clmorph._shared.validation import (
    check_max_pixels,
    check_number,
    check_progress,
    is_path,
    shown,
)
from clmorph.backends.select import Backend, get_backend
from clmorph.clips.reading import Clip
from clmorph.errors import InputError
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import ends_of
from clmorph.frames.layers import Layers, Moment
from clmorph.images.pixels import MAX_PIXELS, as_rgb, as_samples, reduced_shape
from clmorph.images.resizing import resized
from clmorph.output.playback import eased
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.morph import ImagePair
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO

#: Seconds between two pairs of frames whose transport is solved.
EVERY = 0.25
#: (width, height) in pixels.
Size = tuple[int, int]
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
    named: dict[str, Any] = dict(given)
    rate = named.pop("fps", None)
    if options is None:
        options = MorphOptions(**{"size": None} | named)
    else:
        options = MorphOptions.of_call(options, named, "blur=0.05")
    film = ClipFilm(source, target, options, rate, every, max_pixels, backend, progress)
    return (frame for _, frame in film.parts())


class Frames:
    """Pictures of one size: a `still`, or those of a clip, once, at a `rate` that can be None."""

    def __init__(self, name: str, given: Any, max_pixels: int) -> None:
        self._name, self._max_pixels = name, max_pixels
        self.path: Path | None = None
        self.still: AnyArray | None = None
        self.rate: Fraction | None = None
        if is_path(given):
            self.path = Path(given)
            with Clip(self.path, max_pixels) as clip:
                self.size, self.rate, self._tags = clip.size, clip.rate, clip.tags
            return
        if isinstance(given, np.ndarray) and given.ndim in (2, 3):
            self.still = as_samples(given, name, max_pixels=max_pixels)
            self.size = self.still.shape[1], self.still.shape[0]
            return
        scalar = isinstance(given, str) or (isinstance(given, np.ndarray) and given.ndim == 0)
        if scalar or not isinstance(given, Iterable):
            raise InputError(
                f"{name}={shown(given)}: expected a picture, the path of a clip, or its frames"
            )
        frames = iter(given)
        first = next(frames, None)
        if first is None:
            raise InputError(f"{name}: the clip has no frames; expected at least one")
        height, width = as_samples(first, f"{name}, frame 0", max_pixels=max_pixels).shape[:2]
        self.size = width, height
        self._given = itertools.chain([first], frames)

    def pixels(self, rate: Fraction) -> Iterator[AnyArray]:
        """Yield a clip's frames, with the values that it has, at an even rate; a still for ever."""
        if self.still is not None:
            yield from itertools.repeat(self.still)
        if self.path is None:
            for number, frame in enumerate(self._given):
                found = as_samples(frame, f"{self._name}, frame {number}")
                if (found.shape[1], found.shape[0]) != self.size:
                    raise InputError(
                        f"{self._name}, frame {number} has {found.shape[1]} x {found.shape[0]} "
                        f"pixels: expected {self.size[0]} x {self.size[1]} as the first one has"
                    )
                yield found
            return
        with Clip(self.path, self._max_pixels) as clip, closing(clip.frames()) as frames:  # type: ignore[type-var]
            start, count = None, 0
            for frame, after in itertools.pairwise(itertools.chain(frames, [None])):
                assert frame is not None
                start = frame.time if start is None else start
                end = frame.time + 1 / clip.rate if after is None else after.time
                # The frame that is shown in the middle of the time of each frame of the film.
                while (count + Fraction(1, 2)) / rate < end - start:
                    yield frame.pixels
                    count += 1

    def shown(self, pixels: AnyArray, size: Size) -> NDArray[np.float64]:
        """Return a frame as sRGB (H, W, 3) of a size: scaled to fit into it, with black bars."""
        colors = as_rgb(pixels)
        if self.path is not None:
            colors = self._tags.to_srgb(colors)
        height, width = colors.shape[:2]
        if (width, height) == size:
            return np.ascontiguousarray(colors)
        share = min(size[0] / width, size[1] / height)
        inner = max(1, round(share * height)), max(1, round(share * width))
        scaled = np.clip(resized(colors, inner), 0.0, 1.0)
        page = np.zeros((size[1], size[0], 3))
        top, left = (size[1] - inner[0]) // 2, (size[0] - inner[1]) // 2
        page[top : top + inner[0], left : left + inner[1]] = scaled
        return page


class ClipFilm:
    """A film in which a source becomes a target while both play; the parameters of `morph_clip`.

    `rate` takes the place of the first clip's.
    """

    def __init__(
        self,
        source: Any,
        target: Any,
        options: MorphOptions,
        rate: float | None,
        every: float,
        max_pixels: int,
        backend: Backend,
        progress: StageProgress | None,
    ) -> None:
        self.every = check_number("every", every, 0.0, LONGEST, open_low=True)
        if options.detail != "layers":
            raise InputError(
                f"detail={options.detail!r} is for stills: expected 'layers' for a clip, as in the "
                "preset 'photo'"
            )
        if options.endpoints == "paper" or options.sigma is not None:
            raise InputError(
                "endpoints='paper' and sigma are for stills: leave them out for a clip"
            )
        if options.landmarks == AUTO:
            options = options.replace(landmarks=None)
        self.seconds = options.duration or SECONDS
        if self.seconds > LONGEST:
            raise InputError(
                f"duration={self.seconds:g}: expected at most {LONGEST:g} s for a transition, "
                "whose frames are held in memory"
            )
        max_pixels = check_max_pixels(max_pixels)
        self.ends = Frames("source", source, max_pixels), Frames("target", target, max_pixels)
        if all(end.still is not None for end in self.ends):
            raise InputError("source and target are stills: expected a clip; see clmorph.morph")
        rates = [end.rate for end in self.ends if end.rate is not None]
        if rate is not None:
            rates = [Fraction(check_number("fps", rate, 0.1, 240.0)).limit_denominator(1001)]
        clip = next(end for end in self.ends if end.still is None)
        height, width = reduced_shape(clip.size[::-1], options.size or max(clip.size))
        self.size: Size = width, height
        self.rate, self.options = rates[0] if rates else Fraction(25), options
        #: The number of frames of the transition.
        self.count = max(2, round(self.seconds * self.rate))
        self.operations, self.progress = get_backend(backend), check_progress(progress)

    def parts(self) -> Iterator[tuple[float, NDArray[np.float32]]]:
        """Yield how far the transition is, from 0 to 1, and the frame."""
        source, target = self.ends
        firsts: deque[AnyArray] = deque()
        if source.still is not None:
            yield 0.0, self._single(source, source.still)
            firsts.extend(itertools.islice(source.pixels(self.rate), self.count))
        else:
            for pixels in source.pixels(self.rate):
                firsts.append(pixels)
                if len(firsts) > self.count:
                    yield 0.0, self._single(source, firsts.popleft())
            if len(firsts) < self.count:
                raise self._too_short("source", source, len(firsts))
        stream = target.pixels(self.rate)
        for number, frame in enumerate(self._transition(list(firsts), stream), 1):
            yield number / (self.count + 1), frame
        for pixels in stream if target.still is None else [target.still]:
            yield 1.0, self._single(target, pixels)

    def _single(self, end: Frames, pixels: AnyArray) -> NDArray[np.float32]:
        return end.shown(pixels, self.size).astype(np.float32)

    def _too_short(self, name: str, end: Frames, found: int) -> InputError:
        return InputError(
            f"{end.path or name} lasts {float(found / self.rate):.2f} s, and the transition "
            f"{self.count / float(self.rate):.2f} s (duration): expected a clip "
            "that lasts at least as long; lower it"
        )

    def _transition(
        self, firsts: list[AnyArray], stream: Iterator[AnyArray]
    ) -> Iterator[NDArray[np.float32]]:
        """Yield the frames in which one becomes the other."""
        source, target = self.ends
        count = self.count
        times = eased(np.linspace(0.0, 1.0, count + 2), self.options.ease)[1:-1].tolist()
        step = max(1, round(self.every * self.rate))
        others: deque[AnyArray] = deque()

        def pair(number: int, second: AnyArray) -> tuple[Any, Any]:
            return source.shown(firsts[number], self.size), target.shown(second, self.size)

        def drawn(carried: Moment, number: int) -> NDArray[np.float32]:
            frame = carried.frame(
                times[number], pair(number, others.popleft()), canvas, extent,
                self.options.path_space, self.operations,
            )  # fmt: skip
            self.progress("frames", Share((number + 1) / count, f"{number + 1} of {count}"))
            return frame.astype(np.float32)

        def solved(key: int, done: int) -> tuple[Moment, Canvas, str]:
            others.extend(itertools.islice(stream, key + 1 - done - len(others)))
            if len(others) <= key - done:
                raise self._too_short("target", target, done + len(others))
            return self._solved(pair(key, others[-1]))

        before, canvas, extent = solved(0, 0)
        for last, key in itertools.pairwise(sorted({*range(0, count - 1, step), count - 1})):
            after, canvas, extent = solved(key, last)
            for number in range(last, key):
                yield drawn(before.towards(after, (number - last) / (key - last)), number)
            before = after
        yield drawn(before, count - 1)

    def _solved(self, pictures: tuple[Any, Any]) -> tuple[Moment, Canvas, str]:
        """Solve the transport between two frames; return what carries them, and their canvas."""
        pair = ImagePair(pictures, self.options)
        found = pair.morph(self.operations, self.progress)
        measures = found.source, found.target
        ends = ends_of(measures, found.pictures)
        layers = Layers(ends, measures, found.particles, self.operations, outlined=False)
        moment = Moment(tuple(layers.fields), layers.agreement, layers.times)
        return moment, ends[0].canvas, ends[0].extent
