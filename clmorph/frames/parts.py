"""Densities and mean colors of groups of particles.

The launches of a small group take longer than its sums. So small groups are moved in NumPy, one
below the other with a gap that no kernel bridges, and one splat draws many of them. A large group
is moved and drawn by itself.
"""

from collections.abc import Iterator
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.numpy.handles import Splats
from clmorph.frames.canvas import Canvas
from clmorph.frames.particles import Particles
from clmorph.frames.render import CUT, kernel_mean, kernel_sum

Array = NDArray[np.float64]
_Drawn = Iterator[tuple[Array, Array]]

#: The number of particles from which a group is drawn by itself.
LARGE = 2**12
#: Pixels and rows that one splat draws at most, if several groups share it: positions are float32,
#: and are exact to 2^-12 pixels in so many rows.
LARGEST_SPLAT, MOST_ROWS = 2**22, 2**12


class Parts:
    """Groups of a morph's particles, by their numbers, with ends in a `table` (P, 6)."""

    def __init__(
        self,
        operations: Operations,
        particles: Particles,
        table: Array,
        groups: list[NDArray[np.int64]],
    ) -> None:
        self._operations, self._table = operations, table
        self._links, self._weights = particles.links, particles.weights
        self._large = [group for group in groups if len(group) >= LARGE]
        self._small = [group for group in groups if len(group) < LARGE]
        #: All particles' mass at both ends, with which densities are compared.
        self._mass = particles.weights.sum(axis=0)

    def on(self, operations: Operations) -> "Parts":
        """Return the same groups for another device."""
        other = copy(self)
        other._operations = operations
        other.__dict__.pop("_uploaded", None)
        return other

    def drawn(self, t: float, canvas: Canvas, sigma: float) -> _Drawn:
        """Yield each group's mean color, (H, W, 3), and density, (H, W), at time t.

        The density is relative to an even spread of all mass; `sigma` is in pixels.
        """
        even = np.dot((1 - t, t), self._mass) * kernel_sum(sigma) / np.prod(canvas.shape)
        for handle in self._uploaded:
            splats = self._operations.advect(handle, t, canvas.scale, canvas.center)
            sums = self._operations.splat(splats, canvas.shape, sigma, CUT * sigma)
            yield kernel_mean(*sums), sums[1] / even
        if self._small:
            for sums in self._side_by_side(t, canvas, sigma):
                yield kernel_mean(*sums), sums[1] / even

    @cached_property
    def _uploaded(self) -> list[Any]:
        return [
            self._operations.upload_particles(self._table, self._links[group], self._weights[group])
            for group in self._large
        ]

    def _side_by_side(self, t: float, canvas: Canvas, sigma: float) -> _Drawn:
        """Yield the numerator and the denominator of each small group."""
        moving = NumPyOperations()
        order = np.concatenate(self._small)
        particles = moving.upload_particles(self._table, self._links[order], self._weights[order])
        splats = moving.advect(particles, t, canvas.scale, canvas.center)
        height, width = canvas.shape
        # Beyond the radius plus a kernel width nothing counts, see `Operations.splat`.
        reach = (CUT + 1) * sigma
        pitch = height + int(np.ceil(reach)) + 1
        near = np.all(
            (splats.positions > -reach) & (splats.positions < np.array([width, height]) + reach),
            axis=1,
        )
        group_of = np.repeat(np.arange(len(self._small)), [len(group) for group in self._small])
        at_once = max(1, min(LARGEST_SPLAT // width, MOST_ROWS) // pitch)
        for first in range(0, len(self._small), at_once):
            count = min(at_once, len(self._small) - first)
            kept = near & (group_of >= first) & (group_of < first + count)
            down = pitch * (group_of[kept] - first)
            sums = self._sums(splats, kept, down, (count * pitch, width), sigma)
            for row in range(0, count * pitch, pitch):
                yield sums[0][row : row + height], sums[1][row : row + height]

    def _sums(
        self,
        splats: Splats,
        kept: NDArray[np.bool_],
        down: NDArray[np.int64],
        shape: tuple[int, int],
        sigma: float,
    ) -> tuple[Array, Array]:
        """Return the sums of some splats, moved down by some pixels."""
        if not kept.any():
            return np.zeros((*shape, 3)), np.zeros(shape)
        positions = splats.positions[kept]
        positions[:, 1] += down
        handle = self._operations.upload_splats(
            positions.astype(np.float32),
            splats.colors[kept].astype(np.float32),
            splats.weights[kept].astype(np.float32),
        )
        return self._operations.splat(handle, shape, sigma, CUT * sigma)
