"""Frames of sprites: whole pixels move, and what stands before a background keeps its outline.

Pixels with mass are the foreground. Particles are divided into parts by the regions of one color in
which they start and end. A frame shows, in each pixel, the part that is densest there, and the
background, which stays and mixes the colors of both, where all parts together are thin: the
foreground's share of the canvas goes linearly from that of the source to that of the target.

The launches of a small part take longer than its sums. So small parts are moved in NumPy, one below
the other with a gap that no kernel bridges, and one splat draws many of them. A large part is moved
and drawn by itself.
"""

from collections.abc import Iterator
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array, BoolArray, IntArray
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.frames.canvas import Canvas
from clmorph.frames.ends import End
from clmorph.frames.figures import mixed_ground, nearest
from clmorph.frames.growth import take_after
from clmorph.frames.particles import Particles
from clmorph.frames.render import CUT, kernel_mean, kernel_sum
from clmorph.images.color import from_space, to_space
from clmorph.images.flat_colors import Regions, flat_regions, foreground
from clmorph.measures.measure import Measure

_Drawn = Iterator[tuple[Array, Array]]

#: Largest number of regions of an image, and kernel width of parts in pixels.
COLORS, WIDTH = 16, 0.45
#: Parts with less mass than this share of a pixel's are left out: they prevail nowhere.
SMALLEST = 0.25
#: Opacity from which a shape counts as opaque.
OPAQUE = 0.999
#: The number of particles from which a part is drawn by itself.
LARGE = 2**12
#: Pixels and rows that one splat draws at most, if several parts share it: positions are float32,
#: and are exact to 2^-12 pixels in so many rows.
LARGEST_SPLAT, MOST_ROWS = 2**22, 2**12


class _Side(NamedTuple):
    """One image: foreground (H, W), its regions, and the background's color and opacity."""

    inside: BoolArray
    regions: Regions
    ground: Array
    ground_alpha: float


class Sprites:
    """The parts of a morph between flat images."""

    def __init__(
        self, measures: tuple[Measure, Measure], particles: Particles, operations: Operations
    ) -> None:
        self._space = particles.path_space
        self._sides = [_side(measure) for measure in measures]
        #: Whether frames have a fourth channel, and whether shapes are translucent somewhere.
        self.clear = any(measure.alpha is not None for measure in measures)
        self._translucent = any(
            side.regions.alpha[side.inside].min() < OPAQUE for side in self._sides
        )
        regions = [side.regions for side in self._sides]
        colors = np.concatenate(
            [to_space(each.colors, self._space).reshape(-1, 3) for each in regions]
        )
        alphas = np.concatenate([each.alpha.ravel() for each in regions])
        flat, opacity = particles.table.copy(), particles.table.copy()
        flat[: len(colors), 2:5] = colors
        opacity[:, 2:5] = 0.0
        opacity[: len(alphas), 2] = alphas
        known = len(flat) - particles.n_grown
        # Mean destinations between pixels have the mean opacity of the target.
        target = self._sides[1]
        opacity[len(alphas) : known, 2] = target.regions.alpha[target.inside].mean()
        links = particles.links.astype(np.int64)
        for table in (flat, opacity):
            take_after(table[:, 2:5], links, known)
        self._parts = Parts(operations, particles, flat, self._divided(measures, particles))
        self._opacities = Parts(operations, particles, opacity, [np.arange(len(links))])

    def on(self, operations: Operations) -> "Sprites":
        """Return the same parts for another device."""
        other = copy(self)
        other._parts, other._opacities = self._parts.on(operations), self._opacities.on(operations)
        return other

    def frame(self, t: float, canvas: Canvas) -> Array:
        """Return a frame: (H, W, 3) array of sRGB, or (H, W, 4) with opacity."""
        density, colors = self._mixed(t, canvas)
        colors = from_space(colors, self._space)
        area = float(np.dot((1 - t, t), [side.inside.mean() for side in self._sides]))
        opaque = _inside(density, area)[..., None]
        if self._translucent:
            opaque = opaque * self._opacity(t, canvas)[..., None]
        grounds = [(side.ground, side.ground_alpha) for side in self._sides]
        ground, alpha = mixed_ground((1 - t, t), grounds, self._space)
        ground = from_space(ground, self._space)
        if not self.clear:
            return np.asarray(opaque * colors + (1 - opaque) * ground)
        behind = (1 - opaque) * alpha
        total = opaque + behind
        mixed = np.where(
            total > 0, (opaque * colors + behind * ground) / np.maximum(total, 1e-12), colors
        )
        return np.concatenate((mixed, total), axis=2)

    def _divided(self, measures: tuple[Measure, Measure], particles: Particles) -> list[IntArray]:
        """Return the particles of each part, by number; particles that rest have their own."""
        n, m = map(len, measures)
        start, end = particles.links.astype(np.int64).T
        first, second = (side.regions.labels.ravel() + 1 for side in self._sides)
        # 0 stands for no region: mass that dies or is born, or that ends between pixels.
        source = np.where(start < n, np.append(first, 0)[np.minimum(start, n)], 0)
        stop = end - n
        ends_in_pixel = (stop >= 0) & (stop < m)
        target = np.where(ends_in_pixel, second[np.clip(stop, 0, m - 1)], 0)
        keys = source * (second.max() + 1) + target
        least = SMALLEST * np.array([1 / side.inside.sum() for side in self._sides])
        whole = particles.weights.sum(axis=0)
        found = [np.flatnonzero(keys == key) for key in np.unique(keys)]
        large = [
            part for part in found
            if np.any(particles.weights[part].sum(axis=0) >= least * whole)
        ]  # fmt: skip
        return large or found

    def _mixed(self, t: float, canvas: Canvas) -> tuple[Array, Array]:
        """Return the density of all parts, and the color of the densest: (H, W), (H, W, 3)."""
        total, share = np.zeros(canvas.shape), np.zeros(canvas.shape)
        colors = np.zeros((*canvas.shape, 3))
        for mean, density in self._parts.drawn(t, canvas, WIDTH):
            total += density
            prevails = density > share
            colors[prevails], share[prevails] = mean[prevails], density[prevails]
        known = share > 0
        return total, colors if known.all() else colors[nearest(known)]

    def _opacity(self, t: float, canvas: Canvas) -> Array:
        """Return the mean opacity of the particles around each pixel: (H, W) array."""
        ((mean, density),) = self._opacities.drawn(t, canvas, WIDTH)
        return np.clip(mean[..., 0][nearest(density > 0)], 0.0, 1.0)


def _side(measure: Measure) -> _Side:
    """Divide an image into background and regions."""
    end, inside = End.of(measure), (measure.weights > 0).reshape(measure.shape)
    alpha = np.ones(end.shape) if end.alpha is None else end.alpha
    if end.alpha is not None:
        # A pixel of an edge belongs to the shape if it is mostly opaque.
        solid = inside & foreground(end.colors, alpha)
        inside = solid if solid.any() else inside
    regions = flat_regions(end.colors, alpha, inside, COLORS)
    if inside.all() or end.alpha is not None:
        return _Side(inside, regions, np.zeros(3), 0.0)
    return _Side(inside, regions, np.median(end.colors[~inside], axis=0), 1.0)


def _inside(density: Array, area: float) -> Array:
    """Return 1 for the densest pixels, which cover an area (a share of the canvas), and else 0."""
    found = np.zeros(density.size)
    densest = np.argsort(-density.ravel(), kind="stable")
    found[densest[: max(1, round(area * density.size))]] = 1.0
    return found.reshape(density.shape)


class Parts:
    """Groups of a morph's particles, by their numbers, with ends in a `table` (P, 6)."""

    def __init__(
        self, operations: Operations, particles: Particles, table: Array, groups: list[IntArray]
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
            shape = count * pitch, width
            sums = np.zeros((*shape, 3)), np.zeros(shape)
            if kept.any():
                positions = splats.positions[kept]
                positions[:, 1] += pitch * (group_of[kept] - first)
                handle = self._operations.upload_splats(
                    positions.astype(np.float32),
                    splats.colors[kept].astype(np.float32),
                    splats.weights[kept].astype(np.float32),
                )
                sums = self._operations.splat(handle, shape, sigma, CUT * sigma)
            for row in range(0, count * pitch, pitch):
                yield sums[0][row : row + height], sums[1][row : row + height]
