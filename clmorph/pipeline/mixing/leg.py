"""The frames between two stops of a path through mixes."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

from clmorph._shared.typing import Array
from clmorph.frames.sequence import Frame


@dataclass(frozen=True)
class Leg:
    """The frames of a path from one mix to another one.

    Attributes
    ----------
    draw : callable
        Draws a mix by its weights.
    start, end : (K,) arrays
        Weights at both ends.
    times : (n,) array
        Times of the frames, from 0 to 1; weights change linearly with time.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> images = np.zeros((3, 6, 6, 3))
    >>> mixes = clmorph.mix(images, [1, 1, 1], n_frames=3, backend="numpy")
    >>> leg = mixes.path("ab")[0]
    >>> len(leg), next(leg.iter_frames()).shape
    (3, (6, 6, 3))
    """

    draw: Callable[[Array], Frame]
    start: Array
    end: Array
    times: Array

    def __len__(self) -> int:
        return len(self.times)

    def iter_frames(self, first: int = 0) -> Generator[Frame, None, None]:
        """Draw the frames one by one, from number `first` on."""
        return (self.draw((1 - t) * self.start + t * self.end) for t in self.times[first:])
