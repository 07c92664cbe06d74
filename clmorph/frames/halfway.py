"""The displacement of pixels on a domain halfway between both images, refined by registration.

The plan sends the mass of a pixel to many places, so that particles average their colors. Their
*mean* displacement at t = 1/2, smoothed, is one vector a point: a coarse map between the images.
Registration of the two images along this map (Lucas and Kanade, 1981, as iterated by Le Besnerais
and Champagnat, ICIP 2005) then brings details of both images together. A domain halfway between
the images treats both alike (Liao et al., "Automating image morphing using structural similarity
on a halfway domain", ACM Transactions on Graphics 33(5), 2014).
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

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


class Round(NamedTuple):
    """One round of registration, in grid points."""

    #: Width of the Gaussian over which local contrast is measured.
    contrast_width: float
    #: Radius of the window in which displacements are estimated.
    radius: int


#: A round that compares details, and one that compares what is about three times as large, so that
#: a line of text is not taken for the next one.
FINE, COARSE = Round(4.0, 7), Round(12.0, 16)
#: Registration is tried with each of these sequences of rounds.
TRIALS = ((FINE, FINE), (COARSE, FINE, FINE))
#: The trial that differs least is taken at each point. Differences are averaged under a Gaussian of
#: this share of the grid's longer side; the choice is smoothed by a Gaussian of this many points.
COMPARED, CHOICE_WIDTH = 0.05, 6.0
#: Registration counts in full where it lowers the difference to the first share or less, and not at
#: all above the second: there the images have nothing in common, and it would only bend outlines.
COMMON, FOREIGN = 0.6, 0.85
#: Width in grid points of the Gaussian that smooths the result of a round, and the longest
#: correction as a share of the grid's longer side.
SOFTENING, LONGEST = 2.0, 0.045
#: Images with a side below this number of grid points are not registered.
FEWEST = 16
#: Contrast below this lightness (Oklab) is treated as noise.
NOISE = 0.02
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
        return sampled(self.displacement, self._grid.places(positions))


def sampled(image: NDArray[_Real], places: Array) -> NDArray[_Real]:
    """Interpolate an image linearly; it is continued by reflection at its border.

    Parameters
    ----------
    image : (H, W, C) array
    places : (2, ...) array
        Pixel coordinates (row, column).

    Returns
    -------
    (..., C) array
    """
    from scipy.ndimage import map_coordinates

    found = np.empty((image.shape[2], *places.shape[1:]), image.dtype)
    for channel in range(image.shape[2]):
        map_coordinates(
            image[..., channel], places, output=found[channel], order=1, mode="mirror",
            prefilter=False,
        )  # fmt: skip
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
    grids = [canvas.reduced(GRID_SIDE) for canvas in ends]
    small = [
        resized(image[..., None], over.shape) for image, over in zip(lightness, grids, strict=True)
    ]
    if min(grid.shape) >= FEWEST:
        images = _Images(small, grids, grid)
        with ThreadPoolExecutor(len(TRIALS)) as pool:
            trials = list(pool.map(lambda rounds: images.moved(displacement, rounds), TRIALS))
        refined = images.moved(images.best(trials), (FINE,))
        displacement = images.trusted(displacement, refined)
    kept = grid.reduced(max(1, GRID_SIDE // STRIDE))
    return Halfway(sampled(displacement, grid.places(kept.positions())), kept)


class _Images(NamedTuple):
    """Two images, and the grid halfway between them on which they are compared."""

    images: list[Array]  # (H, W, 1)
    canvases: list[Canvas]
    grid: Canvas

    def contrasts(self, displacement: Array, width: float) -> list[Array]:
        """Return the local contrast of both images along a displacement, on the grid."""
        points = self.grid.positions()
        return [
            _contrast(sampled(image, over.places(points + share * displacement))[..., 0], width)
            for image, over, share in zip(self.images, self.canvases, (-0.5, 0.5), strict=True)
        ]

    def moved(self, displacement: Array, rounds: tuple[Round, ...]) -> Array:
        """Return a displacement after some rounds of registration."""
        from scipy.ndimage import gaussian_filter
        from skimage.registration import optical_flow_ilk

        longest = LONGEST * max(self.grid.shape)
        for each in rounds:
            first, second = self.contrasts(displacement, each.contrast_width)
            flow = optical_flow_ilk(first, second, radius=each.radius, num_warp=6)
            flow *= np.minimum(1.0, longest / np.maximum(np.hypot(*flow), 1e-9))
            soft = [gaussian_filter(part, SOFTENING, mode="nearest") for part in flow[::-1]]
            displacement = displacement + np.stack(soft, axis=-1) / np.maximum(
                self.grid.scale, 1e-9
            )
        return displacement

    def best(self, trials: list[Array]) -> Array:
        """Return at each point the displacement along which the images differ least there."""
        from scipy.ndimage import gaussian_filter

        chosen, least = trials[0], self._difference(trials[0])
        for trial in trials[1:]:
            difference = self._difference(trial)
            better = np.asarray(difference < least, np.float64)
            share = gaussian_filter(better, CHOICE_WIDTH, mode="nearest")[..., None]
            chosen = chosen + share * (trial - chosen)
            least = np.minimum(least, difference)
        return chosen

    def trusted(self, displacement: Array, refined: Array) -> Array:
        """Return the refined displacement where it makes the images agree, the other elsewhere."""
        from scipy.ndimage import gaussian_filter

        left = self._difference(refined) / np.maximum(self._difference(displacement), 1e-9)
        trust = np.clip((FOREIGN - left) / (FOREIGN - COMMON), 0.0, 1.0)
        share = gaussian_filter(trust, CHOICE_WIDTH, mode="nearest")[..., None]
        return np.asarray(displacement + share * (refined - displacement))

    def _difference(self, displacement: Array) -> Array:
        """Return how much the images' contrasts differ around each point of the grid."""
        from scipy.ndimage import gaussian_filter

        first, second = self.contrasts(displacement, FINE.contrast_width)
        width = COMPARED * max(self.grid.shape)
        return np.asarray(gaussian_filter(np.abs(first - second), width, mode="nearest"))


def _contrast(lightness: Array, width: float) -> Array:
    """Return lightness less its local mean, divided by its local standard deviation."""
    from scipy.ndimage import gaussian_filter

    detail = lightness - gaussian_filter(lightness, width, mode="nearest")
    power = gaussian_filter(detail**2, width, mode="nearest")
    return np.asarray(detail / np.sqrt(power + NOISE**2))
