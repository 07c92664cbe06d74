"""The displacement of pixels on a domain halfway between both images, refined by registration.

The plan sends the mass of a pixel to many places, so that particles average their colors. Their
*mean* displacement at t = 1/2, smoothed, is one vector a point: a coarse map between the images.
Registration of the two images along this map (Lucas and Kanade, 1981, as iterated by Le Besnerais
and Champagnat, ICIP 2005) then brings details of both images together. A domain halfway between
the images treats both alike (Liao et al., "Automating image morphing using structural similarity
on a halfway domain", ACM Transactions on Graphics 33(5), 2014).
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clmorph.frames.canvas import Canvas
from clmorph.frames.particles import Particles
from clmorph.images.pixels import resized

Array = NDArray[np.float64]
_Real = TypeVar("_Real", bound=np.floating)

#: The longer side of the grid on which images are registered, in grid points.
GRID_SIDE = 256
#: The displacement is kept on a grid with this many times fewer points along a side, if that is
#: more than 128 points long: it is smooth.
STRIDE = 2
#: Width of the Gaussian that smooths displacements, as a share of the grid's longer side.
SMOOTHING = 0.045
#: Mass below this share of the largest, after smoothing, does not decide the displacement.
FAINT = 1e-3
#: Number of particles that are added up at once.
CHUNK = 1 << 17
#: Registration: rounds, radius of its window in grid points, width in grid points of the Gaussian
#: that smooths its result, and the longest correction as a share of the grid's longer side.
ROUNDS, RADIUS, SOFTENING, LONGEST = 2, 7, 2.0, 0.045
#: Images with a side below this number of grid points are not registered.
FEWEST = 16
#: Local contrast is measured over this number of grid points, and contrast below this lightness
#: (Oklab) is treated as noise.
CONTRAST_WIDTH, NOISE = 4.0, 0.02
#: Steps of the iteration that inverts the motion.
STEPS = 8


class Halfway:
    """One displacement for each point halfway between two images.

    A point that is at m at t = 1/2 is at m + (t - 1/2) D(m) at time t.

    Parameters
    ----------
    canvas : Canvas
        The canvas at t = 1/2.
    displacement : (H, W, 2) array
        D on the grid over this canvas, in units of the common frame.
    grid : Canvas
        A canvas with fewer pixels, one for each point of the grid.
    """

    def __init__(self, displacement: Array, grid: Canvas) -> None:
        self.displacement, self._grid = displacement, grid

    def at(self, t: float, positions: Array) -> Array:
        """Return the displacement of what is at some positions at time t: array like positions.

        The place m of each point at t = 1/2 solves m + (t - 1/2) D(m) = position. The iteration
        need not converge where D is torn: what is sampled at position - t D and at
        position + (1 - t) D is right at both ends for any D.
        """
        found = self._sampled(positions)
        if t != 0.5:
            for _ in range(STEPS):
                found = 0.5 * (found + self._sampled(positions - (t - 0.5) * found))
        return found

    def _sampled(self, positions: Array) -> Array:
        return sampled(self.displacement, self._grid.places(positions), order=1)


def sampled(image: NDArray[_Real], places: Array, order: int) -> NDArray[_Real]:
    """Interpolate an image that is continued by reflection at its border.

    Parameters
    ----------
    image : (H, W, C) array
        Values, or with order 3 the coefficients of a cubic spline (`scipy.ndimage.spline_filter`).
    places : (2, ...) array
        Pixel coordinates (row, column).
    order : {1, 3}

    Returns
    -------
    (..., C) array
    """
    from scipy.ndimage import map_coordinates

    found = np.empty((image.shape[2], *places.shape[1:]), image.dtype)
    for channel in range(image.shape[2]):
        map_coordinates(
            image[..., channel], places, output=found[channel], order=order, mode="mirror",
            prefilter=False,
        )  # type: ignore[call-overload]  # fmt: skip
    return np.moveaxis(found, 0, -1)


def mean_displacement(particles: Particles, canvas: Canvas) -> tuple[Array, Canvas]:
    """Return the smoothed mean displacement of particles at t = 1/2.

    Parameters
    ----------
    particles : Particles
        Their mass at t = 1/2 is the weight of their displacement; mass that rests counts with the
        displacement 0.
    canvas : Canvas
        The canvas at t = 1/2.

    Returns
    -------
    displacement : (H, W, 2) array
        In units of the common frame.
    grid : Canvas
        A canvas with one pixel for each point of the displacement.
    """
    from scipy.ndimage import gaussian_filter

    grid = canvas.reduced(GRID_SIDE)
    height, width = grid.shape
    sums = np.zeros((3, height * width))
    for first in range(0, len(particles.links), CHUNK):
        part = slice(first, first + CHUNK)
        here, there = particles.table[:, :2][particles.links[part].T]
        mass = particles.weights[part].mean(axis=1)
        row, column = (
            np.clip(np.rint(place).astype(np.int64), 0, side - 1)
            for place, side in zip(grid.places(0.5 * (here + there)), grid.shape, strict=True)
        )
        bins = row * width + column
        for total, weights in zip(sums, (mass, *(mass * (there - here).T)), strict=True):
            total += np.bincount(bins, weights, height * width)
    total, *moments = (
        gaussian_filter(
            part.reshape(height, width), SMOOTHING * max(grid.shape), mode="nearest"
        )
        for part in sums
    )  # fmt: skip
    # Far from all mass the displacement falls to zero.
    floor = FAINT * max(float(total.max()), np.finfo(np.float64).tiny)
    return np.stack([moment / (total + floor) for moment in moments], axis=-1), grid


def register(
    lightness: tuple[Array, Array], ends: tuple[Canvas, Canvas], displacement: Array, grid: Canvas
) -> Halfway:
    """Refine a displacement until details of both images lie on one another.

    Parameters
    ----------
    lightness : two (H, W) arrays
        Lightness of the source and of the target.
    ends : two of Canvas
        Their canvases.
    displacement : (H, W, 2) array
        Displacement on the grid, in units of the common frame.
    grid : Canvas
        The grid of the displacement, see `mean_displacement`.

    Returns
    -------
    Halfway
    """
    from scipy.ndimage import gaussian_filter
    from skimage.registration import optical_flow_ilk

    grids = [canvas.reduced(GRID_SIDE) for canvas in ends]
    small = [
        resized(image[..., None], over.shape) for image, over in zip(lightness, grids, strict=True)
    ]
    points = grid.positions()
    if min(grid.shape) >= FEWEST:
        longest = LONGEST * max(grid.shape)
        for _ in range(ROUNDS):
            first, second = (
                _contrast(sampled(image, over.places(points + share * displacement), 1)[..., 0])
                for image, over, share in zip(small, grids, (-0.5, 0.5), strict=True)
            )
            flow = optical_flow_ilk(first, second, radius=RADIUS, num_warp=6)
            flow *= np.minimum(1.0, longest / np.maximum(np.hypot(*flow), 1e-9))
            soft = [gaussian_filter(part, SOFTENING, mode="nearest") for part in flow[::-1]]
            moved = [part / max(scale, 1e-9) for part, scale in zip(soft, grid.scale, strict=True)]
            displacement = displacement + np.stack(moved, axis=-1)
    kept = grid.reduced(max(1, GRID_SIDE // STRIDE))
    return Halfway(sampled(displacement, grid.places(kept.positions()), order=1), kept)


def _contrast(lightness: Array) -> Array:
    """Return lightness less its local mean, divided by its local standard deviation."""
    from scipy.ndimage import gaussian_filter

    detail = lightness - gaussian_filter(lightness, CONTRAST_WIDTH, mode="nearest")
    power = gaussian_filter(detail**2, CONTRAST_WIDTH, mode="nearest")
    return np.asarray(detail / np.sqrt(power + NOISE**2))
