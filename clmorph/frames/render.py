"""Frames by Nadaraya-Watson regression from particles (paper, 3.3, Eq. 3 and 4)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from clmorph.backends.interface import Operations
from clmorph.frames.canvas import Canvas
from clmorph.frames.filling import Filling

#: Where the Gaussian is cut, in kernel widths: what lies beyond is at most
#: exp(-4.5^2 / 2) = 4e-5 of the particles' mass.
CUT = 4.5

#: Width, in pixels, of the window in which "local" widths look for neighbors.
PILOT = 1.0

#: Share of a color that 8 bits do not show.
UNSEEN = 1 / 1024
#: Factor by which the kernel widens until a hole is filled.
WIDENING = 2.0


class Widths(NamedTuple):
    """Kernel widths at one time.

    Attributes
    ----------
    sigma : float
        Pixels; 0 gives each particle to its nearest pixel.
    local : bool
        If so, every particle has its own width: the larger of sigma times its own spacing and
        of half the distance to its neighbors where it stands (Eq. 3, locally).
    closed : bool
        Whether pixels that are torn out of their surroundings even so are given the narrowest
        kernel that covers them.
    """

    sigma: float
    local: bool = False
    closed: bool = False


class Sums(NamedTuple):
    """A frame before it is a picture.

    Attributes
    ----------
    colors : (H, W, 3) array
        In the space of the path; holes are filled.
    coverage : (H, W) array
        Kernel mass of each pixel as a share of a uniform spread's; before empty pixels are
        filled, but after torn ones are closed, if they are.
    density : (H, W) array
        Kernel mass of each pixel, after filling, per kernel's sum: mass per pixel.
    """

    colors: NDArray[np.float64]
    coverage: NDArray[np.float64]
    density: NDArray[np.float64]


def render(
    operations: Operations,
    particles: Any,
    mass: float,
    t: float,
    canvas: Canvas,
    widths: Widths,
    *,
    fill: bool | NDArray[np.bool_] = True,
) -> Sums:
    """Reconstruct one frame from particles (Nadaraya-Watson regression, 3.3).

    A pixel whose coverage is at least `filling.HOLE_COVERAGE` has that mean as its color;
    if torn pixels are closed, its coverage must also be `CLOSED_SHARE` of what surrounds it. Below
    half of these thresholds wider kernels decide its color, and in between the color is a mixture
    of both: neither rounding nor pairs that a plan has dropped tip a pixel from one color to
    another.

    Parameters
    ----------
    operations : Operations
    particles
        What `operations.upload_particles` returned.
    mass : float
        The particles' total mass at time t.
    t : float
    canvas : Canvas
    widths : Widths
        Without a kernel, pixels without a particle are 0; with one, pixels in holes are filled
        by widening it there.
    fill : bool or (H, W) array of bool
        Whether, and where, they are.

    Returns
    -------
    Sums
    """
    splats = operations.advect(particles, t, canvas.scale, canvas.center)
    sigma = widths.sigma
    shaped = splats
    if widths.local:
        distances = neighbor_distances(operations, splats, canvas)
        shaped = operations.adapt_widths(splats, distances, sigma)
    numerator, denominator = operations.splat(shaped, canvas.shape, sigma, CUT * sigma)
    coverage = denominator / uniform_density(mass, canvas, sigma)
    filling = Filling(coverage, widths.closed, fill)
    colors = _mean(numerator, denominator)
    density = denominator / kernel_sum(sigma)
    sums = np.dstack((colors, density)) * (1.0 - filling.wanted)[..., None]
    own, width = np.dstack((colors, density)), sigma
    while sigma > 0 and width < max(canvas.shape) and filling.missing > UNSEEN:
        width *= WIDENING
        wider_numerator, wider = operations.splat(splats, canvas.shape, width, CUT * width)
        share = wider / uniform_density(mass, canvas, width)
        # Of the last that is tried, whatever there is.
        whole = wider > 0 if width >= max(canvas.shape) else None
        before = filling.wanted
        given = filling.fill(share, whole)
        colors, density = _mean(wider_numerator, wider), wider / kernel_sum(width)
        sums += given[..., None] * np.dstack((colors, density))
        sums -= (filling.wanted - before)[..., None] * own
    # What no kernel could fill keeps what it has.
    sums += filling.left[..., None] * own
    return Sums(sums[..., :3], filling.coverage, sums[..., 3])


def _mean(numerator: NDArray[np.float64], denominator: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return numerator / denominator, 0 where there is nothing."""
    tiny = np.finfo(np.float64).tiny
    return np.asarray(numerator / np.maximum(denominator, tiny)[..., None])


def neighbor_distances(operations: Operations, splats: Any, canvas: Canvas) -> NDArray[np.float64]:
    """Estimate how far apart particles are around every pixel: (H, W), in pixels.

    From sums over a window of Kish's effective number (sum w)^2 / sum w^2 for each pixel; of
    one lone particle at most sqrt(2 pi) window widths.
    """
    from scipy.ndimage import gaussian_filter

    # Into pixels first: then the window costs the same for any number of particles.
    mass, squares = (
        gaussian_filter(part, PILOT, mode="reflect")
        for part in operations.deposit(splats, canvas.shape)
    )
    farthest = float(np.sqrt(2 * np.pi) * PILOT)
    distances = np.full(canvas.shape, farthest)
    np.divide(np.sqrt(squares), mass, out=distances, where=mass > 1e-12 * mass.max())
    return np.minimum(distances, farthest)


def kernel_sum(sigma: float) -> float:
    """Sum of a kernel over all pixels."""
    return float(2 * np.pi * sigma**2) if sigma > 0 else 1.0


def uniform_density(mass: float, canvas: Canvas, sigma: float) -> NDArray[np.float64]:
    """Return the kernel mass that each pixel would have were the particles spread evenly.

    Less towards the border, where kernels stick out of the canvas: (H, W) array.
    """
    along = []
    for side in canvas.shape:
        if sigma == 0:
            along.append(np.ones(side))
            continue
        borders = np.array([[side - 0.5], [-0.5]]) - np.arange(side)
        above, below = ndtr(borders / sigma)
        along.append(above - below)
    share = along[0][:, None] * along[1]
    return np.asarray(mass * kernel_sum(sigma) / (canvas.shape[0] * canvas.shape[1]) * share)
