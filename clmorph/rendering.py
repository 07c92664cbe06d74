"""Canvas, kernel width and Nadaraya-Watson frames (paper, 3.3, Eq. 3 and 4)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.checks import check_choice, check_number, check_sigma
from clmorph.operations import Operations

#: How particles become pixels: with the width of Eq. 4, with sigma_start throughout, or
#: each into its nearest pixel (the paper's two baselines).
SPLATTING = ("adaptive", "fixed", "none")

#: Where the Gaussian is cut, in kernel widths: what lies beyond is at most
#: exp(-4.5^2 / 2) = 4e-5 of the particles' mass.
CUT = 4.5

#: Coverage under which a pixel is a hole: its kernel mass as a share of what a uniform
#: spread of the particles would give.
HOLE_COVERAGE = 1e-3


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


def effective_count(weights: NDArray[np.float64]) -> float:
    """Return Kish's effective number (sum w)^2 / sum w^2 of weighted particles; 1 of none."""
    largest = float(weights.max(initial=0.0))
    if largest == 0:
        return 1.0
    scaled = weights / largest  # squares of tiny numbers are none
    return float(scaled.sum() ** 2 / np.sum(scaled**2))


@dataclass(frozen=True)
class KernelWidth:
    """The kernel's width as a function of time (Eq. 3 and 4).

    Attributes
    ----------
    sigma_start, sigma_end : float
        Pixels, at t = 0 and t = 1.
    gamma : float
        Height of the bulge at t = 1/2, in pixels.
    n_start, n_end : float
        Effective numbers of particles by the plan's two marginals.
    splatting : {"adaptive", "fixed", "none"}
    """

    sigma_start: float
    sigma_end: float
    gamma: float
    n_start: float
    n_end: float
    splatting: str = "adaptive"

    def __post_init__(self) -> None:
        check_choice("splatting", self.splatting, SPLATTING)
        check_sigma("sigma_start", self.sigma_start)
        check_sigma("sigma_end", self.sigma_end)
        check_number("gamma", self.gamma, 0.0, 1e4)

    def floor(self, t: float, canvas: Canvas) -> float:
        """Half the mean distance of the particles, in pixels (Eq. 3)."""
        count = (1 - t) * self.n_start + t * self.n_end
        return 0.5 * float(np.sqrt(canvas.shape[0] * canvas.shape[1] / count))

    def at(self, t: float, canvas: Canvas) -> float:
        """Width in pixels at time t (Eq. 4); 0 stands for no kernel."""
        if self.splatting == "none":
            return 0.0
        if self.splatting == "fixed":
            return self.sigma_start
        path = (1 - t) * self.sigma_start + t * self.sigma_end + 4 * self.gamma * t * (1 - t)
        return max(self.floor(t, canvas), path)


def render(
    operations: Operations,
    particles: Any,
    mass: float,
    t: float,
    canvas: Canvas,
    sigma: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Reconstruct one frame from particles (Nadaraya-Watson regression, 3.3).

    Parameters
    ----------
    operations : Operations
    particles
        What `operations.upload_particles` returned.
    mass : float
        The particles' total mass at time t.
    t : float
    canvas : Canvas
    sigma : float
        Kernel width in pixels. 0: nearest pixel; pixels without a particle stay black.
        Otherwise pixels in holes are filled by widening the kernel there.

    Returns
    -------
    frame : (H, W, 3) float32 array in [0, 1]
    coverage : (H, W) float32 array
        Kernel mass of each pixel, before filling, as a share of a uniform spread's.
    """
    splats = operations.place(particles, t, canvas.scale, canvas.center)
    numerator, denominator = operations.splat(splats, canvas.shape, sigma, CUT * sigma)
    coverage = denominator / uniform_density(mass, canvas, sigma)
    width = sigma
    open_pixels = coverage < HOLE_COVERAGE
    while sigma > 0 and width < max(canvas.shape) and open_pixels.any():
        width *= 2
        wider_numerator, wider = operations.splat(splats, canvas.shape, width, CUT * width)
        filled = open_pixels & (wider >= HOLE_COVERAGE * uniform_density(mass, canvas, width))
        numerator[filled], denominator[filled] = wider_numerator[filled], wider[filled]
        open_pixels &= ~filled
    tiny = np.finfo(np.float64).tiny
    frame = numerator / np.maximum(denominator, tiny)[..., None]
    return np.clip(frame, 0.0, 1.0).astype(np.float32), coverage.astype(np.float32)


def uniform_density(mass: float, canvas: Canvas, sigma: float) -> float:
    """Kernel mass that each pixel would have were the particles spread evenly."""
    kernel_sum = 2 * np.pi * sigma**2 if sigma > 0 else 1.0
    return float(mass * kernel_sum / (canvas.shape[0] * canvas.shape[1]))
