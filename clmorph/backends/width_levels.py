"""The possible widths of splats with individual widths."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class WidthLevels:
    """Widths in a geometric sequence around a base width sigma."""

    #: Number of levels, at most 256: devices keep a level in a byte.
    count: int
    #: The level whose width is sigma.
    base: int
    #: Number of levels from a width to its double.
    per_octave: int

    def factor(self, level: NDArray[np.integer] | int) -> NDArray[np.float64]:
        """Return the width of a level, from 0 to `count` - 1, in units of sigma."""
        return np.asarray(2.0 ** ((np.asarray(level) - self.base) / self.per_octave))


#: The levels for widths from sigma / 4 to 45 sigma.
WIDTH_LEVELS = WidthLevels(count=16, base=4, per_octave=2)
