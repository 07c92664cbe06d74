"""Frames whose fine detail comes from the images themselves, carried along the mean motion.

The particles of a plan average the colors of many pixels, so a frame halfway is soft. Here the
particles give a frame's lower band alone: they are drawn with a kernel as wide as `band_width`.
What the images have above it is sampled where the motion halfway (`halfway`) says, and mixed:

    frame = (1 - c) particles + c [(1 - t) low A + t low B] + g [(1 - k) high A + k high B]

- k is t where both details are equally strong; elsewhere the stronger one prevails, so that fewer
  outlines lie upon one another.
- g lowers the local standard deviation of the mixture to that of both details mixed by t, and
  `CRISPNESS` of it: without g a detail that prevails would not fade.
- To the particles is added what they lack of the lower band at either end; it is sampled as the
  detail is, and fades towards the middle with `endpoints.share`.
- c is near 1 where both lower bands agree along the motion, so that a picture and its own smooth
  deformation need nothing of the particles.

All but both details is smooth, and is computed on a coarse canvas (`coarse_canvas`).

Where pixels have labels, each label has a motion of its own, that of its own particles, and a frame
is the mean of these mixtures, weighted by how much of each label is at a place: so no detail
crosses the borders of labels.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.enlarging import enlarged
from clmorph.backends.interface import Operations
from clmorph.frames.bands import ALL_ROWS, Bands, color_unit, kernel_width, mixed
from clmorph.frames.canvas import Canvas
from clmorph.frames.endpoints import share
from clmorph.frames.ends import End
from clmorph.frames.halfway import Halfway, mean_displacement, register, sampled
from clmorph.frames.particles import Particles
from clmorph.images.color import to_space

Array = NDArray[np.float64]

#: Least share of both images from which the motion of a label is registered, and largest number of
#: labels whose detail is carried: each costs a registration, and a share of each frame.
REGISTERED, MOST_LABELS = 0.1, 16


class CarriedDetail:
    """The bands of both images and the motion between them.

    Parameters
    ----------
    ends : (source, target)
        Opaque pictures. If particles have labels, they have one for each pixel of these.
    particles : Particles
        The particles of their plan.
    canvases : three of Canvas
        At t = 0, 1/2 and 1.
    shown : (source's, target's)
        What the particles show at t = 0 and t = 1 on the coarse canvas, drawn with `band_width`:
        (h, w, 3) arrays in the space of the path.
    operations : Operations, optional
        The backend that samples the detail of large images; NumPy by default.
    """

    def __init__(
        self,
        ends: tuple[End, End],
        particles: Particles,
        canvases: tuple[Canvas, Canvas, Canvas],
        shown: tuple[Array, Array],
        operations: Operations | None = None,
    ) -> None:
        start, middle, end = canvases
        colors = [picture.colors for picture in ends]
        first, second = (to_space(image, "oklab")[..., 0] for image in colors)
        #: The motion of each label, and where its pixels are in both images.
        self._layers: list[_Layer] = []
        for part, masks in _labeled(particles, ends):
            displacement, grid = mean_displacement(part, middle)
            # What surrounds a small label would decide its registration.
            large = masks is None or min(float(mask.mean()) for mask in masks) >= REGISTERED
            motion = Halfway(displacement, grid)
            if large:
                motion = register((first, second), (start, end), displacement, grid)
            self._layers.append(_Layer(motion, masks))
        self._bands = [
            Bands.of(to_space(image, particles.path_space), canvas, low, operations)
            for image, canvas, low in zip(colors, (start, end), shown, strict=True)
        ]
        self._unit = color_unit(particles.path_space)

    @property
    def motion(self) -> Halfway:
        """The motion between images without labels; of several labels, that of the first."""
        return self._layers[0].motion

    def kernel_width(self, t: float, canvas: Canvas) -> float:
        """Return the kernel width with which particles are drawn at time t on the coarse canvas.

        Parameters
        ----------
        t : float
        canvas : Canvas
            The canvas at t.

        Returns
        -------
        float
            In pixels of the coarse canvas.
        """
        return kernel_width(self._bands, (1 - t, t), canvas)

    def frame(self, t: float, canvas: Canvas, colors: Array) -> Array:
        """Return a frame in the space of the path: (H, W, 3) array.

        Parameters
        ----------
        t : float
        canvas : Canvas
            The canvas at t.
        colors : (h, w, 3) array
            What the particles show on the coarse canvas, drawn with `kernel_width`.
        """
        if len(self._layers) == 1:
            return self._along(self._displacement(self._layers[0], t, canvas), t, canvas, colors)
        whole, weights = np.zeros((*canvas.shape, 3)), np.zeros((*canvas.shape, 1))
        for layer in self._layers:
            displacement = self._displacement(layer, t, canvas)
            weight = self._weight(layer, t, canvas, displacement)
            rows = np.flatnonzero(weight.any(axis=(1, 2)))
            if len(rows):
                part = slice(int(rows[0]), int(rows[-1]) + 1)
                whole[part] += weight[part] * self._along(displacement, t, canvas, colors, part)
                weights += weight
        # Where no label arrives, particles alone are seen.
        bare = np.maximum(0.0, 1.0 - weights)
        shown = enlarged(colors, canvas.shape) if bare.any() else 0.0
        return np.asarray((whole + bare * shown) / (weights + bare), dtype=np.float64)

    def _displacement(self, layer: "_Layer", t: float, canvas: Canvas) -> Array:
        """Return the displacement at a frame's places; it is smooth, so a coarse grid is enough."""
        grid = canvas.reduced(max(layer.motion.displacement.shape))
        return layer.motion.at(t, grid.positions())

    def _weight(self, layer: "_Layer", t: float, canvas: Canvas, displacement: Array) -> Array:
        """Return how much of a label is at each point of a frame: (H, W, 1) array."""
        assert layer.masks is not None  # there are several layers
        positions, motion = canvas.positions(), enlarged(displacement, canvas.shape)
        first, second = (
            sampled(mask, bands.canvas.places(positions + share_of_path * motion))
            for mask, bands, share_of_path in zip(
                layer.masks, self._bands, (-t, 1 - t), strict=True
            )
        )
        return np.asarray((1 - t) * first + t * second)

    def _along(
        self,
        displacement: Array,
        t: float,
        canvas: Canvas,
        colors: Array,
        part: slice = ALL_ROWS,
    ) -> Array:
        """Return some rows of a frame along one motion, all by default: (rows, W, 3) array."""
        motions = -t * displacement, (1 - t) * displacement
        return mixed(self._bands, (1 - t, t), motions, canvas, colors, share(t), self._unit, part)


class _Layer(NamedTuple):
    """The motion of one label, and its pixels in both images, or None for all: (H, W, 1) arrays."""

    motion: Halfway
    masks: tuple[Array, Array] | None


def labels_to_carry(particles: Particles) -> NDArray[np.int64]:
    """Return the labels of particles; none if they have none."""
    labels = particles.labels
    return np.zeros(0, np.int64) if labels is None else np.union1d(*labels)


def _labeled(
    particles: Particles, ends: tuple[End, End]
) -> list[tuple[Particles, tuple[Array, Array] | None]]:
    """Return the particles of each label, and its pixels in both images; or all particles."""
    labels, names = particles.labels, labels_to_carry(particles)
    if labels is None or len(names) < 2:
        return [(particles, None)]
    # A particle starts or ends at a pixel of an image, or both; the rows of its label come first.
    rows = np.concatenate(labels)
    links = particles.links.astype(np.int64)
    known = np.where(links[:, 0] < len(rows), links[:, 0], links[:, 1])
    own = rows[known]
    found: list[tuple[Particles, tuple[Array, Array] | None]] = []
    for name in names:
        mine = own == name
        masks = [
            (each == name).astype(float).reshape(*end.shape, 1)
            for each, end in zip(labels, ends, strict=True)
        ]
        part = replace(particles, links=particles.links[mine], weights=particles.weights[mine])
        found.append((part, (masks[0], masks[1])))
    return found
