"""The kernel's width as a function of time, and its floor (paper, 3.3, Eq. 3 and 4)."""

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array
from clmorph.frames.canvas import Canvas
from clmorph.frames.options import WIDTH, RenderOptions, Splatting
from clmorph.frames.render import Widths


def effective_count(weights: Array) -> float:
    """Return Kish's effective number (sum w)^2 / sum w^2 of particles (Eq. 3); 1 for none."""
    largest = float(weights.max(initial=0.0))
    if largest == 0:
        return 1.0
    scaled = weights / largest  # squares of tiny numbers would underflow
    return float(scaled.sum() ** 2 / np.sum(scaled**2))


@dataclass(frozen=True)
class KernelWidth:
    """Kernel widths over time by Eq. 3 and 4, or by another curve."""

    #: Widths in pixels at t = 0 and t = 1.
    sigma_start: float
    sigma_end: float
    #: Height of the bulge at t = 1/2, in pixels. "local" has no bulge, because it widens kernels
    #: where particles are sparse.
    gamma: float
    #: Effective numbers of particles at both ends (N_eff of Eq. 3).
    n_start: float
    n_end: float
    splatting: Splatting = "adaptive"
    #: Times and widths in pixels between which sigma(t) is interpolated, in place of Eq. 4. Torn
    #: pixels are then closed, as with "local", so that a narrow width does not cause holes.
    curve: tuple[Array, Array] | None = None

    def __post_init__(self) -> None:
        RenderOptions.checked("splatting", self.splatting)
        WIDTH.check("sigma_start", self.sigma_start)
        WIDTH.check("sigma_end", self.sigma_end)
        RenderOptions.checked("gamma", self.gamma)

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
