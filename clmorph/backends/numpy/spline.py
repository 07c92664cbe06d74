"""Pictures sampled where a smooth motion says, in NumPy."""

import numpy as np

from clmorph._shared.enlarging import enlarged
from clmorph.backends.records import Float32, Motion


def sample_spline(spline: Float32, motion: Motion, first: int, stop: int) -> Float32:
    """Sample a picture; see `clmorph.backends.interface.Operations`."""
    from scipy.ndimage import map_coordinates

    rows, columns = np.mgrid[first:stop, : motion.shape[1]].astype(float)
    places = np.moveaxis(enlarged(motion.displacements, motion.shape, first, stop), -1, 0).copy()
    places[0] += motion.origin[0] + motion.step[0] * rows
    places[1] += motion.origin[1] + motion.step[1] * columns
    found = np.empty((3, stop - first, motion.shape[1]), np.float32)
    for channel in range(3):
        map_coordinates(
            spline[..., channel], places, output=found[channel], order=3, mode="mirror",
            prefilter=False,
        )  # fmt: skip
    return np.moveaxis(found, 0, -1)
