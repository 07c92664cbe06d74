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
        """Draw the frames one by one.

        Parameters
        ----------
        first : int
            Number of the first frame.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> images = np.zeros((2, 6, 6, 3))
        >>> leg = clmorph.mix(images, [1, 1], n_frames=3, backend="numpy").path("ab")[0]
        >>> [frame.shape for frame in leg.iter_frames()]
        [(6, 6, 3), (6, 6, 3), (6, 6, 3)]
        """
        return (self.draw((1 - t) * self.start + t * self.end) for t in self.times[first:])
