"""What a film of clips is made of: a still, a clip in a file, or frames in memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import AnyArray
from clmorph._shared.validation import is_path, shown
from clmorph.clips.reading import Clip
from clmorph.errors import InputError
from clmorph.images.pixels import as_rgb, as_samples
from clmorph.images.resizing import resized

#: (width, height) in pixels.
Size = tuple[int, int]


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
        array = given if isinstance(given, np.ndarray) else None
        if array is not None and array.ndim in (2, 3):
            self.still = as_samples(array, name, max_pixels=max_pixels)
            self.size = self.still.shape[1], self.still.shape[0]
            return
        if not isinstance(given, Iterable) or isinstance(given, str):
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
        """Yield the frames of a clip at an even rate, with the values that it has."""
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
            last, start, count, end = None, Fraction(0), 0, Fraction(0)
            for frame in frames:
                if last is None:
                    start = frame.time
                # The frame that is shown in the middle of the time of each frame of the film.
                while last is not None and (count + Fraction(1, 2)) / rate < frame.time - start:
                    yield last
                    count += 1
                last, end = frame.pixels, frame.time - start + 1 / clip.rate
            while last is not None and (count + Fraction(1, 2)) / rate < end:
                yield last
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
