"""Frames by Nadaraya-Watson regression from particles (paper, 3.3, Eq. 3 and 4)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import check_number, shown
from clmorph.backends.interface import Operations
from clmorph.errors import InputError
from clmorph.frames.canvas import Canvas
from clmorph.frames.filling import Filling

#: The radius at which the Gaussian is cut, in kernel widths: the mass beyond it is at most
#: exp(-4.5^2 / 2) = 4e-5 of the particles' mass.
CUT = 4.5

#: Width, in pixels, of the window in which "local" widths look for neighbors.
PILOT = 1.0

#: The share of a color that is invisible in 8 bits.
UNSEEN = 1 / 1024
#: Factor by which the kernel widens until a hole is filled.
WIDENING = 2.0


class Widths(NamedTuple):
    """Kernel widths at one time."""

    #: Width in pixels; 0 gives each particle to its nearest pixel.
    sigma: float
    #: Whether every particle has its own width: the larger of sigma times its spacing and half the
    #: distance to its neighbors at its position (Eq. 3, applied locally).
    local: bool = False
    #: Whether pixels that are torn in spite of these widths are filled by the narrowest kernel that
    #: covers them.
    closed: bool = False


def check_widths(widths: Widths | None) -> Widths | None:
    """Return widths after checking them."""
    if widths is None:
        return None
    if not isinstance(widths, Widths):
        raise InputError(f"widths={shown(widths)}: expected clmorph.frames.render.Widths, or None")
    check_number("widths.sigma", widths.sigma, 0.0, 1e4)
    return widths


class Sums(NamedTuple):
    """The sums of a frame from which its picture is computed."""

    #: Colors in the space of the path, with holes filled: (H, W, 3) array.
    colors: NDArray[np.float64]
    #: Kernel mass of each pixel as a share of that of a uniform spread, before empty pixels are
    #: filled but after torn pixels are closed, if the widths request it: (H, W) array.
    coverage: NDArray[np.float64]
    #: (H, W) Mass per pixel: kernel mass after filling, divided by the kernel's sum.
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
    """Reconstruct one frame from uploaded particles (Nadaraya-Watson regression, 3.3).

    A pixel whose coverage is at least `filling.HOLE_COVERAGE` has the kernel's mean as its color.
    If torn pixels are closed, its coverage must also be at least `CLOSED_SHARE` of the coverage
    around it. Below half of these thresholds wider kernels determine its color, and in between the
    color is a mixture of both. So neither rounding nor pairs that a plan has dropped can switch a
    pixel from one color to another.

    `mass` is the particles' total at time t. Without a kernel, pixels without a particle are 0;
    with a kernel, holes are filled by wider kernels, everywhere or where `fill` is true.
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
    colors = kernel_mean(numerator, denominator)
    density = denominator / kernel_sum(sigma)
    sums = np.dstack((colors, density)) * (1.0 - filling.wanted)[..., None]
    own, width = np.dstack((colors, density)), sigma
    while sigma > 0 and width < max(canvas.shape) and filling.missing > UNSEEN:
        width *= WIDENING
        wider_numerator, wider = operations.splat(splats, canvas.shape, width, CUT * width)
        share = wider / uniform_density(mass, canvas, width)
        # The last kernel that is tried fills every pixel that it reaches at all.
        whole = wider > 0 if width >= max(canvas.shape) else None
        before = filling.wanted
        given = filling.fill(share, whole)
        colors, density = kernel_mean(wider_numerator, wider), wider / kernel_sum(width)
        sums += given[..., None] * np.dstack((colors, density))
        sums -= (filling.wanted - before)[..., None] * own
    # Pixels that no kernel could fill keep their colors.
    sums += filling.left[..., None] * own
    return Sums(sums[..., :3], filling.coverage, sums[..., 3])


def kernel_mean(
    numerator: NDArray[np.float64], denominator: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return numerator, (H, W, 3), / denominator, (H, W), and 0 where the denominator is 0.

    The numerator need not be 0 there: each sum of float32 is rounded to 0 by itself.
    """
    there = denominator[..., None] > 0
    return np.divide(
        numerator, denominator[..., None], out=np.zeros_like(numerator, dtype=float), where=there
    )


def neighbor_distances(operations: Operations, splats: Any, canvas: Canvas) -> NDArray[np.float64]:
    """Estimate the distance between particles around every pixel: (H, W) array, in pixels.

    The estimate uses Kish's effective number (sum w)^2 / sum w^2 over a window around each pixel.
    For a single particle it is at most sqrt(2 pi) window widths.
    """
    from scipy.ndimage import gaussian_filter

    # Particles are deposited into pixels first, so that the cost of the window does not depend on
    # their number.
    mass, squares = (
        gaussian_filter(part, PILOT, mode="reflect")
        for part in operations.deposit(splats, canvas.shape)
    )
    farthest = float(np.sqrt(2 * np.pi) * PILOT)
    distances = np.full(canvas.shape, farthest)
    np.divide(np.sqrt(squares), mass, out=distances, where=mass > 1e-12 * mass.max())
    return np.minimum(distances, farthest)


def kernel_sum(sigma: float) -> float:
    """Return the sum of a kernel over all pixels."""
    return float(2 * np.pi * sigma**2) if sigma > 0 else 1.0


def uniform_density(mass: float, canvas: Canvas, sigma: float) -> NDArray[np.float64]:
    """Return the kernel mass that each pixel would have if particles were spread uniformly.

    The (H, W) array falls towards the border, where kernels extend beyond the canvas.
    """
    from scipy.special import ndtr  # few morphs need it, and it takes long to import

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
