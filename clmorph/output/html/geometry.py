"""The size of each frame in the common frame, so that the picture does not jump."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The largest distance from a whole number at which a time counts as whole.
WHOLE = 1e-9


def frame_boxes(sizes: Sequence[tuple[int, int]], times: Array, extent: str = "true") -> Array:
    """Return (n, 4): width and height of each frame, borders included, and of the common square."""
    shapes = np.asarray(sizes, np.float64).reshape(-1, 2)
    whole = np.abs(times - np.round(times)) < WHOLE
    whole[[0, -1]] = True
    _, first = np.unique(np.round(times[whole], 9), return_index=True)
    anchors = np.flatnonzero(whole)[first]
    known = times[anchors], shapes[anchors]
    # Canvases grow by whole pixels, but their content moves smoothly.
    smooth = np.column_stack([np.interp(times, known[0], side) for side in known[1].T])
    per_unit = np.interp(times, known[0], known[1].max(axis=1) - 1)
    # Frames whose sizes are not those of a morph keep their own sizes.
    other = np.any(np.abs(smooth - shapes) > 1 + WHOLE, axis=1)
    smooth[other] = shapes[other]
    per_unit[other] = shapes[other].max(axis=1) - 1
    pitch = np.repeat(1 / np.maximum(per_unit, 1.0)[:, None], 2, axis=1)
    if extent == "unit":
        # The centers of the outer pixels stand on the borders of the square, whatever the number
        # of pixels between them.
        pitch *= np.maximum(smooth - 1, 0.0) / np.maximum(shapes - 1, 1.0)
        pitch[shapes == 1] = 1 / np.maximum(per_unit, 1.0)[np.nonzero(shapes == 1)[0]]
        unit = (shapes - 1) * pitch
    else:
        unit = per_unit[:, None] * pitch
    return np.concatenate(((shapes * pitch)[:, ::-1], unit[:, ::-1]), axis=1)
