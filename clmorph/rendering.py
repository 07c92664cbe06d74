"""Canvas, kernel width and Nadaraya-Watson frames (paper, 3.3, Eq. 3 and 4)."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from clmorph.operations import Operations

#: Where the Gaussian is cut, in kernel widths: what lies beyond is at most
#: exp(-4.5^2 / 2) = 4e-5 of the particles' mass.
CUT = 4.5

#: Width, in pixels, of the window in which "local" widths look for neighbors.
PILOT = 1.0

#: Coverage under which a pixel is empty: its kernel mass as a share of what a uniform
#: spread of the particles would give.
HOLE_COVERAGE = 1e-3
#: The same as a share of that around it, within so many pixels: torn.
HOLE_SHARE, HOLE_SURROUNDINGS = 0.1, 3.0
#: The same from which on a pixel is closed: closing others raises what is around it.
CLOSED_SHARE = 0.15
#: Share of the coverage from which on a pixel is left as it is, under which it is filled
#: altogether; in between it is both, so that nothing depends on which side of a threshold it is.
OPEN = 0.5
#: Share of a color that 8 bits do not show.
UNSEEN = 1 / 1024
#: Change of what is to be filled that ends the cascade below.
SETTLED = 1 / 256
#: Factor by which the kernel widens until a hole is filled.
WIDENING = 2.0
#: How often, at most, pixels that others leave torn by being filled are filled by the same kernel.
CASCADE = 16


@dataclass(frozen=True)
class Canvas:
    """The pixels of one frame.

    Attributes
    ----------
    shape : (height, width)
    scale : (x, y)
        Pixels per unit of the common frame.
    """

    shape: tuple[int, int]
    scale: tuple[float, float]

    @property
    def center(self) -> tuple[float, float]:
        """Pixel coordinates (x, y) of the common frame's center."""
        return (self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2


def canvas_at(
    t: float, source_shape: tuple[int, int], target_shape: tuple[int, int], extent: str = "true"
) -> Canvas:
    """Return the canvas at time t (paper, 3.3, "Dynamic Rasterization Grid").

    Sides go from the source's to the target's, rounded down on the way; at both ends the
    common frame maps onto exactly that image's pixels.

    Parameters
    ----------
    t : float in [0, 1]
    source_shape, target_shape : (height, width)
    extent : {"true", "unit"}
        As the measures were lifted.
    """
    # The small number keeps rounding from turning an integer into the one below.
    height, width = (
        s + int(np.floor(t * (e - s) + 1e-9))
        for s, e in zip(source_shape, target_shape, strict=True)
    )
    if extent == "unit":
        return Canvas((height, width), (width - 1.0, height - 1.0))
    per_unit = (1 - t) * (max(source_shape) - 1) + t * (max(target_shape) - 1)
    return Canvas((height, width), (per_unit, per_unit))


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

    A pixel's color can be trusted to be that mean from a coverage of `HOLE_COVERAGE` on, and if
    torn pixels are closed, from `CLOSED_SHARE` of what surrounds it on. From the `OPEN` part of
    that down wider kernels decide, and in between both, continuously: neither rounding nor pairs
    that a plan has dropped tip a pixel from one color to another.

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
    splats = operations.place(particles, t, canvas.scale, canvas.center)
    sigma = widths.sigma
    shaped = splats
    if widths.local:
        distances = neighbor_distances(operations, splats, canvas)
        shaped = operations.adapt_widths(splats, distances, sigma)
    numerator, denominator = operations.splat(shaped, canvas.shape, sigma, CUT * sigma)
    coverage = denominator / uniform_density(mass, canvas, sigma)
    filling = _Filling(coverage, widths.closed, fill)
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


class _Filling:
    """How much of each pixel wider kernels decide, and how much of that is still to be filled.

    All of it depends continuously on the kernels' masses: a pixel at a threshold, where rounding
    or a pair that the plan has dropped would tip it, has the same color on both sides.

    Parameters
    ----------
    coverage : (H, W) array
        By the frame's own kernel.
    closed : bool
        Whether pixels are filled that are only torn out of their surroundings.
    where : bool or (H, W) array of bool
        Which pixels may be filled.

    Attributes
    ----------
    wanted : (H, W) array
        Share of a pixel's color that is to come from wider kernels.
    given : (H, W) array
        Share that has.
    coverage : (H, W) array
        With what is closed as covered as the kernels that close it say.
    """

    def __init__(
        self, coverage: NDArray[np.float64], closed: bool, where: bool | NDArray[np.bool_]
    ) -> None:
        self._own, self._closed, self._where = coverage, closed, where
        self.coverage = coverage
        self._around = surroundings(coverage) if closed else coverage
        self.wanted = self._openness(coverage, self._around) * where
        self.given = np.zeros_like(coverage)
        #: Coverage of what was given beside its surroundings, times its share.
        self._relative = np.zeros_like(coverage)

    @property
    def left(self) -> NDArray[np.float64]:
        """(H, W) share that is still to be filled."""
        return self.wanted - self.given

    @property
    def missing(self) -> float:
        """The largest share that is still to be filled."""
        return float(self.left.max())

    def _openness(
        self, own: NDArray[np.float64], around: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how torn pixels are, from 0 at the threshold to 1 at `OPEN` of it."""
        needed: NDArray[np.float64] | float = HOLE_COVERAGE
        if self._closed:
            needed = np.maximum(CLOSED_SHARE * around, HOLE_COVERAGE)
        return np.asarray(np.clip((1.0 - own / needed) / (1.0 - OPEN), 0.0, 1.0))

    def fill(
        self, share: NDArray[np.float64], whole: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Fill what a wider kernel covers: return its share of each pixel, (H, W).

        Parameters
        ----------
        share : (H, W) array
            Coverage by that kernel.
        whole : (H, W) array of bool, optional
            Pixels that it is to fill, and no others, however torn.
        """
        around = surroundings(share) if self._closed else share
        covers = 1.0 - self._openness(share, around) if whole is None else whole.astype(float)
        before, relative_before = self.given, self._relative
        given = (self.wanted - before) * covers
        if self._closed:
            relative = share / np.maximum(around, HOLE_COVERAGE)
            for _ in range(CASCADE):
                self.given = before + given
                # As covered, beside its surroundings, as it is with the kernel that covers it;
                # this raises what surrounds others, which the same kernel may close.
                self._relative = relative_before + given * relative
                self.coverage = (1.0 - self.given) * self._own + self._relative * self._around
                self._around = surroundings(self.coverage)
                wanted = self._openness(self._own, self._around) * self._where
                change = np.maximum(wanted - self.wanted, 0.0)
                if change.max() <= SETTLED:
                    break
                self.wanted = self.wanted + change
                given = (self.wanted - before) * covers
        self.given = before + given
        return given


def _mean(numerator: NDArray[np.float64], denominator: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return numerator / denominator, 0 where there is nothing."""
    tiny = np.finfo(np.float64).tiny
    return np.asarray(numerator / np.maximum(denominator, tiny)[..., None])


def is_torn(coverage: NDArray[np.float64], least: float = HOLE_SHARE) -> NDArray[np.bool_]:
    """Return which pixels are holes: far less covered than what surrounds them, or not at all.

    Parameters
    ----------
    coverage : (H, W) array
        Kernel mass as a share of a uniform spread's.
    least : float
        Share of what surrounds it under which a pixel is torn.
    """
    return (coverage < least * surroundings(coverage)) | (coverage < HOLE_COVERAGE)


def surroundings(coverage: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how well the surroundings of each pixel are covered: (H, W) array."""
    from scipy.ndimage import gaussian_filter

    # A mean of roots: a few spikes of a narrow kernel say nothing about their surroundings.
    mean = gaussian_filter(np.sqrt(coverage), HOLE_SURROUNDINGS, mode="reflect")
    return np.asarray(mean**2)


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
