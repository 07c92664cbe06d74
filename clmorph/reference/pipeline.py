"""The method of the paper from images to frames in plain NumPy float64, dense and independent.

This module iterates plain Sinkhorn from zero, forms the whole plan, and sums the kernels of all
particles. It shares no mathematics with the accelerated path, so it can verify that path. It stores
N x M numbers, so images should have at most about 64 x 64 pixels. Equations are those of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Unpack

import numpy as np

from clmorph._shared.options import among, specifications
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_number
from clmorph.backends.arrays import as_floats
from clmorph.errors import InputError
from clmorph.frames.options import WIDTH, RenderOptions
from clmorph.images.pixels import as_rgb
from clmorph.measures.measure import Measure
from clmorph.measures.points import as_image_measure
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import MorphKeywords
from clmorph.pipeline.options import PAPER, MorphOptions
from clmorph.reference.transport import sinkhorn, transport_plan
from clmorph.transport.options import SolverOptions
from clmorph.transport.potentials import Potentials

#: The options of `morph`.
REFERENCE_OPTIONS = (
    *specifications(SolverOptions), "color_weight", "sigma_start", "sigma_end", "gamma", "extent",
    "unmatched", "log_threshold", "n_frames",
)  # fmt: skip
# --- 3.3: canvas, kernel width, Nadaraya-Watson -----------------------------------------


def canvas_shape(t: float, source: Measure, target: Measure) -> tuple[int, int]:
    """Return the canvas (H(t), W(t)) of the frame at time t (paper, 3.3).

    Its sides are interpolated between those of the source and of the target, and rounded down.
    """
    (hs, ws), (ht, wt) = source.shape, target.shape
    return (hs + int(np.floor(t * (ht - hs) + 1e-9)), ws + int(np.floor(t * (wt - ws) + 1e-9)))


def kernel_width(
    t: float,
    shape: tuple[int, int],
    masses: tuple[Array, Array],
    sigma_start: float,
    sigma_end: float,
    gamma: float,
) -> float:
    """Return the kernel width sigma(t) in pixels (paper, Eq. 4), with the floor of Eq. 3.

    `masses` are the masses drawn at both ends: the marginals of the plan, or with births and deaths
    the masses of the images.
    """
    r, c = masses
    n_eff = (1 - t) * r.sum() ** 2 / np.sum(r**2) + t * c.sum() ** 2 / np.sum(c**2)
    sigma_min = 0.5 * np.sqrt(shape[0] * shape[1] / n_eff)
    sigma = (1 - t) * sigma_start + t * sigma_end + gamma * 4 * t * (1 - t)
    return float(max(sigma_min, sigma))


def render(
    source: Measure, target: Measure, plan: Array, t: float, sigma: float, unmatched: str = "fade"
) -> tuple[Array, Array]:
    """Sum the kernels of all particles at time t (paper, 3.3), without truncation.

    Particle (i, j) stands at (1 - t) x_i + t y_j, has the color (1 - t) c_i + t d_j and the weight
    pi_ij; its kernel is exp(-|p - p_k|^2 / (2 sigma^2)).

    Parameters
    ----------
    source, target : Measure
        Lifted images.
    plan : (N, M) array
    t : float
        Time in [0, 1].
    sigma : float
        Kernel width, in pixels.
    unmatched : {"fade", "drop"}
        "fade" scales the weights so that the source at t = 0 and the target at t = 1 have their
        masses, and draws mass that does not move as it dies or is born. "drop" leaves this mass
        out, as the paper does.

    Returns
    -------
    numerator : (H, W, 3) array
    denominator : (H, W) array
        The frame is numerator / denominator (Nadaraya-Watson).

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> from clmorph import reference
    >>> source, target = (clmorph.lift(np.full((2, 2), gray)) for gray in (0.2, 0.6))
    >>> numerator, denominator = reference.render(source, target, np.eye(4) / 4, 0.5, 1.0)
    >>> (numerator / denominator[..., None])[0, 0].round(3).tolist()
    [0.4, 0.4, 0.4]
    """
    source, target = (
        as_image_measure(name, measure, "frames are images")
        for name, measure in (("source", source), ("target", target))
    )
    t, sigma = check_number("t", t, 0.0, 1.0), WIDTH.check("sigma", sigma)
    _check_unmatched(unmatched)
    plan = as_floats("plan", plan, "an array (N, M) of masses")
    sizes = len(source), len(target)
    if plan.shape != sizes or not np.all(np.isfinite(plan) & (plan >= 0)):
        raise InputError(
            f"plan has shape {plan.shape}: expected finite masses of at least 0, of shape {sizes}"
        )
    height, width = canvas_shape(t, source, target)
    numerator, denominator = np.zeros((height, width, 3)), np.zeros((height, width))
    a, b = source.weights, target.weights
    r, c = plan.sum(axis=1), plan.sum(axis=0)

    def add(positions: Array, colors: Array, weights: Array) -> None:
        x, y = _to_pixels(positions, t, source, target)
        along_x = np.exp(-((np.arange(width) - x[:, None]) ** 2) / (2 * sigma**2))
        along_y = np.exp(-((np.arange(height) - y[:, None]) ** 2) / (2 * sigma**2))
        along_y *= weights[:, None]
        denominator[...] += along_y.T @ along_x
        for channel in range(3):
            numerator[..., channel] += (along_y * colors[:, channel, None]).T @ along_x

    for i in range(len(source)):
        weights = plan[i]
        if unmatched == "fade":
            scale_a = min(1.0, a[i] / r[i]) if r[i] > 0 else 0.0
            scale_b = np.minimum(1.0, b / np.where(c > 0, c, np.inf))
            weights = plan[i] * ((1 - t) * scale_a + t * scale_b)
        add(
            (1 - t) * source.positions[i] + t * target.positions,
            (1 - t) * source.colors[i] + t * target.colors,
            weights,
        )
    if unmatched == "fade":
        add(source.positions, source.colors, (1 - t) * np.maximum(0.0, a - r))
        add(target.positions, target.colors, t * np.maximum(0.0, b - c))
    return numerator, denominator


def _to_pixels(positions: Array, t: float, source: Measure, target: Measure) -> tuple[Array, Array]:
    """Return pixel coordinates x and y on the canvas at time t (paper, 3.3)."""
    height, width = canvas_shape(t, source, target)
    if source.extent == "unit":
        return positions[:, 0] * (width - 1), positions[:, 1] * (height - 1)
    scale = (1 - t) * (max(source.shape) - 1) + t * (max(target.shape) - 1)
    return (
        (positions[:, 0] - 0.5) * scale + (width - 1) / 2,
        (positions[:, 1] - 0.5) * scale + (height - 1) / 2,
    )


# --- the whole --------------------------------------------------------------------------


def _lift(pixels: Array, color_weight: float, extent: str) -> Measure:
    """Lift an image with uniform weights (paper, 2.3)."""
    height, width, _ = pixels.shape
    longer = max(height, width)
    positions = np.empty((height, width, 2))
    for row in range(height):
        for column in range(width):
            if extent == "unit":
                x = column / (width - 1) if width > 1 else 0.5
                y = row / (height - 1) if height > 1 else 0.5
            else:
                x = 0.5 + (column - (width - 1) / 2) / max(1, longer - 1)
                y = 0.5 + (row - (height - 1) / 2) / max(1, longer - 1)
            positions[row, column] = x, y
    n = height * width
    return Measure(
        positions=positions.reshape(n, 2),
        colors=pixels.reshape(n, 3),
        weights=np.full(n, 1 / n),
        shape=(height, width),
        color_weight=color_weight,
        extent=extent,
    )


@dataclass(frozen=True)
class ReferenceMorph:
    """A morph by the reference, with the attributes of `clmorph.Morph` and a dense plan.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph import reference
    >>> morph = reference.morph(np.zeros((2, 2)), np.ones((2, 2)), n_frames=3, reach=None)
    >>> morph.plan.shape, morph.sigma.round(2).tolist()
    ((4, 4), [1.2, 1.35, 0.5])
    """

    source: Measure
    target: Measure
    potentials: Potentials
    plan: Array
    times: Array
    sigma_start: float
    sigma_end: float
    gamma: float
    unmatched: str

    @property
    def sigma(self) -> Array:
        """Kernel widths at `times`, in pixels: (n_frames,) array."""
        return np.array([self._sigma(t) for t in self.times])

    def _sigma(self, t: float) -> float:
        shape = canvas_shape(t, self.source, self.target)
        masses = self.source.weights, self.target.weights
        if self.unmatched == "drop":
            # These are the marginals of the whole plan, whatever pairs are kept.
            masses = self.potentials.row_mass, self.potentials.column_mass
        return kernel_width(t, shape, masses, self.sigma_start, self.sigma_end, self.gamma)

    def frame(self, t: float) -> Array:
        """Return the (H(t), W(t), 3) frame at time t, sRGB in [0, 1] (paper, 3.3).

        Examples
        --------
        >>> import numpy as np
        >>> from clmorph import reference
        >>> morph = reference.morph(np.zeros((2, 2)), np.ones((2, 2)), n_frames=3, reach=None)
        >>> morph.frame(0.5)[0, 0].round(3).tolist()
        [0.5, 0.5, 0.5]
        """
        t = check_number("t", t, 0.0, 1.0)
        sigma = self._sigma(t)
        numerator, denominator = render(
            self.source, self.target, self.plan, t, sigma, self.unmatched
        )
        tiny = np.finfo(float).tiny
        return np.clip(numerator / np.maximum(denominator, tiny)[..., None], 0, 1)

    @property
    def frames(self) -> list[Array]:
        """The frames at `times`."""
        return [self.frame(t) for t in self.times]


def _check_unmatched(unmatched: str) -> None:
    RenderOptions.checked("unmatched", unmatched)
    if unmatched == "grow":
        raise InputError("unmatched='grow': the reference knows 'fade' and 'drop'; use one of them")


@documented(MorphOptions, REFERENCE_OPTIONS, PAPER)
def morph(image_a: ArrayLike, image_b: ArrayLike, **given: Unpack[MorphKeywords]) -> ReferenceMorph:
    """Morph one image into another as the paper does; the defaults are the paper's.

    Parameters
    ----------
    image_a, image_b : array_like
        Source and target: (H, W), (H, W, 1), (H, W, 3) or (H, W, 4), with at most 2^25 pairs of
        pixels; they are not downscaled. Transparent parts are laid on white.
    {options}

    Returns
    -------
    ReferenceMorph

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph import reference
    >>> morph = reference.morph(np.zeros((2, 2)), np.ones((2, 2)), n_frames=3, reach=None)
    >>> [frame[0, 0, 0].round(3).item() for frame in morph.frames]
    [0.0, 0.5, 1.0]
    """
    options = PAPER.replace(**among(given, REFERENCE_OPTIONS))
    _check_unmatched(options.unmatched)
    sigma_start = WIDTH.check("sigma_start", options.sigma_start)
    sigma_end = WIDTH.check("sigma_end", options.sigma_end)
    source, target = (
        _lift(as_rgb(image, name), options.color_weight, options.extent)
        for name, image in (("image_a", image_a), ("image_b", image_b))
    )
    potentials = sinkhorn(source, target, **options.of(SolverOptions))
    plan = transport_plan(source, target, potentials, log_threshold=options.log_threshold)
    times = np.linspace(0, 1, options.n_frames)
    return ReferenceMorph(
        source, target, potentials, plan, times, sigma_start, sigma_end, options.gamma or 0.0,
        options.unmatched,
    )  # fmt: skip
