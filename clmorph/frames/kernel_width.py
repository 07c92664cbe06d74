"""The kernel's width as a function of time (paper, 3.3, Eq. 3 and 4), and where it starts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.validation import check_choice, check_number, check_sigma
from clmorph.frames.canvas import Canvas
from clmorph.frames.render import Widths

#: How particles become pixels: with the width of Eq. 4; with one of its own for every
#: particle, by the density around it; with sigma_start throughout, or each into its nearest
#: pixel (the paper's two baselines).
SPLATTING = ("adaptive", "local", "fixed", "none")


def effective_count(weights: NDArray[np.float64]) -> float:
    """Return Kish's effective number (sum w)^2 / sum w^2 of weighted particles; 1 of none."""
    largest = float(weights.max(initial=0.0))
    if largest == 0:
        return 1.0
    scaled = weights / largest  # squares of tiny numbers are none
    return float(scaled.sum() ** 2 / np.sum(scaled**2))


@dataclass(frozen=True)
class KernelWidth:
    """Kernel widths over time (Eq. 3 and 4), or another curve in their place.

    Attributes
    ----------
    sigma_start, sigma_end : float
        Pixels, at t = 0 and t = 1.
    gamma : float
        Height of the bulge at t = 1/2, in pixels; "local" has none, it widens where needed.
    n_start, n_end : float
        Effective numbers of particles at both ends (N_eff of Eq. 3).
    splatting : {"adaptive", "local", "fixed", "none"}
    curve : (times, widths), optional
        Two arrays between which sigma(t) is interpolated, in place of Eq. 4; pixels. Torn pixels
        are then closed, as with "local", so that a narrow width is no reason for holes.
    """

    sigma_start: float
    sigma_end: float
    gamma: float
    n_start: float
    n_end: float
    splatting: str = "adaptive"
    curve: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def __post_init__(self) -> None:
        check_choice("splatting", self.splatting, SPLATTING)
        check_sigma("sigma_start", self.sigma_start)
        check_sigma("sigma_end", self.sigma_end)
        check_number("gamma", self.gamma, 0.0, 1e4)

    def count(self, t: float) -> float:
        """Effective number of particles at time t."""
        return (1 - t) * self.n_start + t * self.n_end

    def floor(self, t: float, canvas: Canvas) -> float:
        """Half the mean distance of the particles, in pixels (Eq. 3)."""
        return 0.5 * float(np.sqrt(canvas.shape[0] * canvas.shape[1] / self.count(t)))

    def at(self, t: float, canvas: Canvas) -> float:
        """Width in pixels at time t (Eq. 4); 0 stands for no kernel.

        For "local" the width of a particle whose surroundings are neither torn nor crowded.
        """
        if self.splatting == "none":
            return 0.0
        if self.splatting == "fixed":
            return self.sigma_start
        if self.curve is not None:
            return float(np.interp(t, *self.curve))
        path = (1 - t) * self.sigma_start + t * self.sigma_end
        if self.splatting == "local":
            return path
        return max(self.floor(t, canvas), path + 4 * self.gamma * t * (1 - t))

    def widths(self, t: float, canvas: Canvas) -> Widths:
        """Widths at time t, as `clmorph.frames.render.render` takes them."""
        local = self.splatting == "local"
        return Widths(self.at(t, canvas), local, closed=local or self.curve is not None)


#: Share of its edges' energy that an enlarged sprite has on the grid of its blocks.
BLOCK_SHARE = 0.9
#: Effective number of lines of edges from which on they tell a grid.
FEWEST_LINES = 4.0
#: A sprite that is not enlarged has at most so many colors, and so many pixels along a side.
SPRITE_COLORS = 64
SPRITE_SIDE = 256
#: Range of luma below which an image has no detail: less than a step of 8 bits.
FAINTEST = 1e-3
#: Share of an image's edges' energy up to the frequency that counts as its highest.
BAND_SHARE = 0.99


def intrinsic_spacing(image: NDArray[np.float64]) -> float:
    """Return the side, in pixels, of the smallest detail an image really has (at least 1).

    Parameters
    ----------
    image : (H, W, C) array

    Returns
    -------
    float
        The blocks' side for an enlarged sprite, also where compression left traces; for others
        half the shortest period in their spectrum.
    """
    return max(1.0, float(_block_side(image)), _half_period(image))


def auto_sigma(image: NDArray[np.float64]) -> float:
    """Return the kernel width that suits an image's resolution: half its smallest detail."""
    return 0.5 * intrinsic_spacing(image)


def is_pixel_art(image: NDArray[np.float64]) -> bool:
    """Return whether an image is a sprite: of few colors, or of blocks.

    Parameters
    ----------
    image : (H, W, 3) or (H, W, 4) array
        Opacity, and colors that are not seen, do not count.
    """
    if image.shape[2] == 4:
        image = np.where(image[..., 3:] > 0, image[..., :3], 0.0)
    if _block_side(image) > 1:
        return True
    if max(image.shape[:2]) > SPRITE_SIDE:
        return False
    colors = np.unique(image.reshape(-1, image.shape[2]), axis=0)
    return len(colors) <= min(SPRITE_COLORS, image.shape[0] * image.shape[1] // 4)


def _block_side(image: NDArray[np.float64]) -> int:
    """Largest k for which nearly all edges lie on one grid of k x k blocks, else 1."""
    edges = [np.sum(np.diff(image, axis=axis) ** 2, axis=(1 - axis, 2)) for axis in (0, 1)]
    total = sum(float(along.sum()) for along in edges)
    # A few lines lie on many grids.
    if total == 0 or total**2 < FEWEST_LINES * sum(float(np.sum(along**2)) for along in edges):
        return 1
    # With fewer than 8 blocks along a side any few edges would do.
    for side in range(min(image.shape[:2]) // 8, 1, -1):
        on_grid = sum(max(along[phase::side].sum() for phase in range(side)) for along in edges)
        if on_grid >= BLOCK_SHARE * total:
            return side
    return 1


def _half_period(image: NDArray[np.float64]) -> float:
    """Half the period, in pixels, up to which the spectrum holds nearly all edges."""
    height, width = image.shape[:2]
    if min(height, width) < 8:
        return 1.0
    # The window keeps the jump from one border to the opposite one out of it.
    window = np.hanning(height)[:, None] * np.hanning(width)
    gray = image[..., :3].mean(axis=2)
    if np.ptp(gray) < FAINTEST:
        return 1.0
    power = np.abs(np.fft.rfft2((gray - gray.mean()) * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    edges = (frequency**2 * power).ravel()
    order = np.argsort(frequency, axis=None)
    below = np.cumsum(edges[order])
    if below[-1] == 0:
        return 1.0
    highest = frequency.ravel()[order][np.searchsorted(below, BAND_SHARE * below[-1])]
    return float(0.5 / min(0.5, highest)) if highest > 0 else 1.0
