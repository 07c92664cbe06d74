"""Draw mixtures of several images with detail that is carried along their mean motions.

What the frame of a mixture shows at y of image i is at the place s of that image with

    s + sum_j w_j D_ij(s) = y,

where D_ij is the displacement from image i to image j, as their morph found it by transport and
registration (`clmorph.frames.halfway`). With two images this is the motion of their morph.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.frames.bands import (
    Bands,
    coarse_band_width,
    coarse_canvas,
    color_unit,
    kernel_width,
    mixed,
)
from clmorph.frames.canvas import Canvas, canvas_at
from clmorph.frames.ends import End
from clmorph.frames.halfway import GRID_SIDE, STEPS, STRIDE, Halfway, sampled
from clmorph.frames.mixes.particles import MixedParticles, upload
from clmorph.frames.render import Widths, render
from clmorph.images.color import from_space, to_space

Array = NDArray[np.float64]


def mixed_canvas(pictures: Sequence[End], weights: Sequence[float]) -> Canvas:
    """Return the canvas of a mixture, whose sides are the weighted means of those of the images."""
    # The small number keeps rounding from turning an integer into the one below.
    sides = np.array([picture.shape for picture in pictures])
    height, width = np.floor(np.array(weights) @ sides + 1e-9).astype(int).tolist()
    if pictures[0].extent == "unit":
        return Canvas((height, width), (width - 1.0, height - 1.0))
    per_unit = float(np.array(weights) @ (sides.max(axis=1) - 1))
    return Canvas((height, width), (per_unit, per_unit))


def mixed_share(weights: Sequence[float]) -> float:
    """Return how near a mixture is to an image, from 0 to 1; `endpoints.share` of several images.

    It is 0 where no weight prevails: with sum_k w_k^2 <= 1/2.
    """
    near = max(0.0, 2.0 * sum(weight**2 for weight in weights) - 1.0)
    return float(np.sin(0.5 * np.pi * np.sqrt(near)) ** 2)


class MixRenderer:
    """Draws mixtures of opaque images.

    Parameters
    ----------
    pictures : sequence of End
        The images, which can have more pixels than the measures of the particles.
    particles : MixedParticles
    motions : mapping of (i, j) to Halfway
        The motion between each pair of images, i < j.
    path_space : str
    operations : Operations
    """

    def __init__(
        self,
        pictures: Sequence[End],
        particles: MixedParticles,
        motions: Mapping[tuple[int, int], Halfway],
        path_space: str,
        operations: Operations,
    ) -> None:
        self._pictures, self._particles, self._space = pictures, particles, path_space
        self._operations = operations
        self._canvases = [
            canvas_at(0.0, each.shape, each.shape, each.extent) for each in pictures
        ]  # fmt: skip
        self._grids = [canvas.reduced(GRID_SIDE // STRIDE) for canvas in self._canvases]
        #: The displacement from image i to image j, on the grid of image i.
        self._ways: dict[tuple[int, int], Array] = {}
        for (i, j), motion in motions.items():
            self._ways[i, j] = motion.at(0.0, self._grids[i].positions())
            self._ways[j, i] = -motion.at(1.0, self._grids[j].positions())

    def frame(self, weights: Sequence[float]) -> Array:
        """Draw a mixture: (H, W, 3) array of sRGB.

        Parameters
        ----------
        weights : sequence of float
            The weight of each image, with the sum 1.
        """
        canvas = mixed_canvas(self._pictures, weights)
        shown = [i for i, weight in enumerate(weights) if weight > 0]
        bands, shares = [self._bands[i] for i in shown], [weights[i] for i in shown]
        coarse = coarse_canvas(canvas)
        colors = self._colors(weights, coarse, kernel_width(bands, shares, canvas))
        places = canvas.reduced(GRID_SIDE // STRIDE).positions()
        motions = [self._motion(i, weights, places) for i in shown]
        picture = mixed(
            bands, shares, motions, canvas, colors, mixed_share(weights), color_unit(self._space)
        )
        return np.clip(from_space(picture, self._space), 0.0, 1.0)

    def _colors(self, weights: Sequence[float], canvas: Canvas, width: float) -> Array:
        """Return what particles show on a canvas, in the space of the path."""
        table, mass = self._particles.at(weights)
        uploaded = upload(self._operations, table, mass)
        return render(
            self._operations, uploaded, float(mass.sum()), 0.0, canvas, Widths(width)
        ).colors

    def _motion(self, i: int, weights: Sequence[float], places: Array) -> Array:
        """Return where image i is seen at places of the frame, less these places."""
        others = [j for j, weight in enumerate(weights) if weight > 0 and j != i]
        if not others:
            return np.zeros_like(places)
        way = np.sum([weights[j] * self._ways[i, j] for j in others], axis=0)
        found = np.zeros_like(places)
        # As in `Halfway.at`, the mean of two steps settles where a step alone would swing.
        for _ in range(2 * STEPS):
            step = -sampled(way, self._grids[i].places(places + found))
            found = 0.5 * (found + step)
        return found

    @cached_property
    def _bands(self) -> list[Bands]:
        found = []
        for i, (picture, canvas) in enumerate(zip(self._pictures, self._canvases, strict=True)):
            alone = [float(i == k) for k in range(len(self._pictures))]
            shown = self._colors(alone, coarse_canvas(canvas), coarse_band_width(canvas))
            image = to_space(picture.colors, self._space)
            found.append(Bands.of(image, canvas, shown, self._operations))
        return found
