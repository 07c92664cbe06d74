"""The frames between two stops of a path through mixes."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

from clmorph._shared.typing import Array
from clmorph.frames.sequence import Frame


@dataclass(frozen=True)
class Leg:
    """The frames of a path from one mix to another one, whose weights change linearly."""

    #: Draws a mix by its weights.
    draw: Callable[[Array], Frame]
    #: (K,) weights at both ends.
    start: Array
    end: Array
    #: (n,) times of the frames, from 0 to 1.
    times: Array

    def __len__(self) -> int:
        return len(self.times)

    def iter_frames(self, first: int = 0) -> Generator[Frame, None, None]:
        """Draw the frames one by one, from number `first` on."""
        return (self.draw((1 - t) * self.start + t * self.end) for t in self.times[first:])
