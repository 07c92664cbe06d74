"""Common parts of the writers of animated images: sizes, durations, changes between frames."""

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from clmorph._shared.typing import BoolArray
from clmorph.output.playback import whole_units
from clmorph.output.recording import Recording

if TYPE_CHECKING:
    from PIL.Image import Image

#: Longer side, in pixels, to which small frames are enlarged.
SIDE = 384

#: The highest frame rate of files with milliseconds; browsers show a frame of 10 ms for 100 ms.
FASTEST = 90.0

#: Left, top, right and bottom in pixels; right and bottom are exclusive.
Box = tuple[int, int, int, int]


def timed_frames(recording: Recording, per_second: int | Fraction) -> list[tuple[int, int]]:
    """Return each frame's index and duration, in units of 1 / `per_second` s, in one round."""
    played = recording.played()
    units = whole_units([seconds for _, seconds in played], per_second)
    return [(index, duration) for (index, _), duration in zip(played, units, strict=True)]


def box_of(where: BoolArray) -> Box:
    """Return the smallest box around the True pixels of (H, W), of one pixel at least."""
    rows, columns = np.flatnonzero(where.any(axis=1)), np.flatnonzero(where.any(axis=0))
    if len(rows) == 0:
        return 0, 0, 1, 1
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def changed(before: "Image | None", after: "Image") -> Box:
    """Return the box outside which two pictures of one size and mode are the same."""
    if before is None:
        return 0, 0, after.width, after.height
    differs = np.asarray(before) != np.asarray(after)
    return box_of(differs if differs.ndim == 2 else differs.any(axis=2))


def pieces(units: int, most: int) -> list[int]:
    """Return a duration as a sum of durations of at most `most`, all in a file's units."""
    whole, rest = divmod(units, most)
    return [most] * whole + [rest] * (rest > 0)
