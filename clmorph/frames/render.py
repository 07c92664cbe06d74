"""Frames by Nadaraya-Watson regression from particles (paper, 3.3, Eq. 3 and 4).

Pixels that hardly any kernel reaches, the holes of a frame, are filled by wider kernels.
"""

from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph._shared.validation import check_number, shown
from clmorph.backends.interface import Operations
from clmorph.errors import InputError
from clmorph.frames.canvas import Canvas

#: The radius at which the Gaussian is cut, in kernel widths: the mass beyond it is at most
#: exp(-4.5^2 / 2) = 4e-5 of the particles' mass.
CUT = 4.5

#: Width, in pixels, of the window in which "local" widths look for neighbors.
PILOT = 1.0

#: The share of a color that is invisible in 8 bits.
UNSEEN = 1 / 1024
#: Factor by which the kernel widens until a hole is filled.
WIDENING = 2.0
#: Coverage under which a pixel is empty: its kernel mass as a share of what a uniform
#: spread of the particles would give.
HOLE_COVERAGE = 1e-3
#: Coverage under which a pixel is torn, as a share of the coverage around it, and the size in
#: pixels of these surroundings.
HOLE_SHARE, HOLE_SURROUNDINGS = 0.1, 3.0
#: The same share from which a pixel counts as closed: closing others raises the coverage around it.
CLOSED_SHARE = 0.15
#: A pixel is filled entirely below this share of the coverage from which it is not filled at all.
#: In between its color is a mixture, so that it depends continuously on the coverage.
OPEN = 0.5
#: The change of the share to be filled below which the repetition in `fill` ends.
SETTLED = 1 / 256
#: The largest number of repetitions with one kernel: filling some pixels can leave others torn.
CASCADE = 16


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
    colors: Array
    #: Kernel mass of each pixel as a share of that of a uniform spread, before empty pixels are
    #: filled but after torn pixels are closed, if the widths request it: (H, W) array.
    coverage: Array
    #: (H, W) Mass per pixel: kernel mass after filling, divided by the kernel's sum.
    density: Array


def render(
    operations: Operations,
    particles: Any,
    mass: float,
    t: float,
    canvas: Canvas,
    widths: Widths,
    *,
    fill: bool | BoolArray = True,
) -> Sums:
    """Reconstruct one frame from uploaded particles (Nadaraya-Watson regression, 3.3).

    A pixel whose coverage is at least `HOLE_COVERAGE` has the kernel's mean as its color.
    If torn pixels are closed, its coverage must also be at least `CLOSED_SHARE` of the coverage
    around it. Below half of these thresholds wider kernels determine its color, and in between the
    color is a mixture of both.

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
    while sigma > 0 and width < max(canvas.shape) and filling.left.max() > UNSEEN:
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


def kernel_mean(numerator: Array, denominator: Array) -> Array:
    """Return numerator, (H, W, 3), / denominator, (H, W), and 0 where the denominator is 0.

    The numerator need not be 0 there: each sum of float32 is rounded to 0 by itself.
    """
    there = denominator[..., None] > 0
    return np.divide(
        numerator, denominator[..., None], out=np.zeros_like(numerator, dtype=float), where=there
    )


def neighbor_distances(operations: Operations, splats: Any, canvas: Canvas) -> Array:
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


def uniform_density(mass: float, canvas: Canvas, sigma: float) -> Array:
    """Return the kernel mass that each pixel would have if particles were spread uniformly.

    The (H, W) array falls towards the border, where kernels extend beyond the canvas.
    """
    from scipy.special import ndtr  # few morphs need it, and it takes long to import

    share = np.ones(canvas.shape)
    if sigma > 0:
        down, along = (
            ndtr((side - 0.5 - np.arange(side)) / sigma) - ndtr((-0.5 - np.arange(side)) / sigma)
            for side in canvas.shape
        )
        share = down[:, None] * along
    return np.asarray(mass * kernel_sum(sigma) / (canvas.shape[0] * canvas.shape[1]) * share)


class Filling:
    """The share of each pixel's color that comes from kernels wider than the frame's own.

    The shares depend continuously on the kernels' masses. So a pixel has the same color on both
    sides of a threshold that rounding, or a pair dropped from the plan, could make it cross.
    `closed` fills pixels that are torn, but not empty, too; `where` masks the pixels that may be
    filled.

    All attributes are (H, W) arrays: `wanted` is the share of a pixel's color that wider kernels
    are to supply, `given` what they have supplied so far, and `coverage` the frame's own, with that
    of the wider kernels in the pixels that they have filled.
    """

    def __init__(self, coverage: Array, closed: bool, where: bool | BoolArray) -> None:
        self._own, self._closed, self._where = coverage, closed, where
        self.coverage = coverage
        self._around = surroundings(coverage) if closed else coverage
        self.wanted = self._openness(coverage, self._around) * where
        self.given = np.zeros_like(coverage)
        #: Coverage by the wider kernels relative to its surroundings, times the share supplied.
        self._relative = np.zeros_like(coverage)

    @property
    def left(self) -> Array:
        """Share of each pixel that is still to be filled: (H, W) array."""
        return self.wanted - self.given

    def _openness(self, own: Array, around: Array) -> Array:
        """Return the degree to which pixels are holes: 0 at the threshold, 1 at `OPEN` times it."""
        needed: Array | float = HOLE_COVERAGE
        if self._closed:
            needed = np.maximum(CLOSED_SHARE * around, HOLE_COVERAGE)
        return np.asarray(np.clip((1.0 - own / needed) / (1.0 - OPEN), 0.0, 1.0))

    def fill(self, share: Array, whole: BoolArray | None = None) -> Array:
        """Fill pixels that a wider kernel covers, and return its share of their colors: (H, W).

        `share`, (H, W), is the coverage by that kernel; `whole` masks the pixels to fill: others
        are not filled, even if they are torn.
        """
        around = surroundings(share) if self._closed else share
        covers = 1.0 - self._openness(share, around) if whole is None else whole.astype(float)
        before, relative_before = self.given, self._relative
        given = (self.wanted - before) * covers
        if self._closed:
            relative = share / np.maximum(around, HOLE_COVERAGE)
            for _ in range(CASCADE):
                self.given = before + given
                # A filled pixel gets the coverage, relative to its surroundings, of the kernel
                # that fills it. This raises the surroundings of others, which the same kernel may
                # close.
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


def is_torn(coverage: Array) -> BoolArray:
    """Return which pixels are holes: far less covered than their surroundings, or empty."""
    return (coverage < HOLE_SHARE * surroundings(coverage)) | (coverage < HOLE_COVERAGE)


def surroundings(coverage: Array) -> Array:
    """Return the mean coverage of the surroundings of each pixel: (H, W) array."""
    from scipy.ndimage import gaussian_filter

    # The mean is that of square roots, so that a few spikes of a narrow kernel hardly raise it.
    mean = gaussian_filter(np.sqrt(coverage), HOLE_SURROUNDINGS, mode="reflect")
    return np.asarray(mean**2)
