"""The clouds, particles and splats of `NumPyOperations`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.records import Float64


class Cloud(NamedTuple):
    """A weighted cloud: (N, D) points, the logarithms of its (N,) masses, cost offsets."""

    points: Float64
    log_weights: Float64
    offsets: Float64


class ParticleSet(NamedTuple):
    """Particles that move, as given to `NumPyOperations.upload_particles`."""

    table: Float64
    links: NDArray[np.uint32]
    weights: Float64


class Splats(NamedTuple):
    """Particles at rest: (K, 2) pixel positions, (K, 3) colors, (K,) masses and spacings."""

    positions: Float64
    colors: Float64
    weights: Float64
    spacings: Float64
    width_levels: NDArray[np.int64] | None = None  # if widths differ
