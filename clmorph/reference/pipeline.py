"""The paper from images to frames in plain NumPy float64: dense, textbook, independent.

Plain Sinkhorn iteration from zero, the whole plan, the whole sum over all particles. It
shares no mathematics with the accelerated path, so it can judge it; it needs N x M
memory, so images should stay under about 64 x 64 pixels. Equations are those of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Unpack

import numpy as np

from clmorph._shared.arrays import as_floats
from clmorph._shared.options import specifications
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_choice, check_number, check_sigma
from clmorph.errors import InputError
from clmorph.frames.options import UNMATCHED
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
    """Return (H(t), W(t)): sides between the source's and the target's, rounded down."""
    (hs, ws), (ht, wt) = source.shape, target.shape
    return (
        hs + int(np.floor(t * (ht - hs) + 1e-9)),
        ws + int(np.floor(t * (wt - ws) + 1e-9)),
    )


def kernel_width(
    t: float,
    shape: tuple[int, int],
    masses: tuple[Array, Array],
    sigma_start: float,
    sigma_end: float,
    gamma: float,
) -> float:
    """Return sigma(t) in pixels, Eq. 4, with the floor of Eq. 3.

    `masses` are those drawn at both ends: the plan's marginals, or with births and deaths the
    images' own.
    """
    r, c = masses
    n_eff = (1 - t) * r.sum() ** 2 / np.sum(r**2) + t * c.sum() ** 2 / np.sum(c**2)
    sigma_min = 0.5 * np.sqrt(shape[0] * shape[1] / n_eff)
    sigma = (1 - t) * sigma_start + t * sigma_end + gamma * 4 * t * (1 - t)
    return float(max(sigma_min, sigma))


def render(
    source: Measure,
    target: Measure,
    plan: Array,
    t: float,
    sigma: float,
    unmatched: str = "fade",
) -> tuple[Array, Array]:
    """Sum the kernels of all particles, none left out and none cut.

    Parameters
    ----------
    source, target : Measure
    plan : (N, M) array
    t : float
    sigma : float
        Kernel width, pixels.
    unmatched : {"fade", "drop"}

    Returns
    -------
    numerator : (H, W, 3) array
    denominator : (H, W) array
        The frame is numerator / denominator.

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    source, target = (
        as_image_measure(name, measure, "frames are images")
        for name, measure in (("source", source), ("target", target))
    )
    t, sigma = check_number("t", t, 0.0, 1.0), check_sigma("sigma", sigma)
    check_choice("unmatched", unmatched, UNMATCHED)
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
    """Lift an image with uniform weights (2.3)."""
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
    """What `morph` returns; attributes as `clmorph.Morph`, `plan` dense."""

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
        """(n_frames,) kernel widths at `times`, in pixels."""
        return np.array([self._sigma(t) for t in self.times])

    def _sigma(self, t: float) -> float:
        shape = canvas_shape(t, self.source, self.target)
        masses = self.source.weights, self.target.weights
        if self.unmatched == "drop":
            # The transport's own, whatever pairs are kept.
            masses = self.potentials.row_mass, self.potentials.column_mass
        return kernel_width(t, shape, masses, self.sigma_start, self.sigma_end, self.gamma)

    def frame(self, t: float) -> Array:
        """Return the (H(t), W(t), 3) frame at time t."""
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


@documented(MorphOptions, REFERENCE_OPTIONS, PAPER)
def morph(image_a: ArrayLike, image_b: ArrayLike, **given: Unpack[MorphKeywords]) -> ReferenceMorph:
    """Morph one image into another as the paper does; the defaults are the paper's.

    Parameters
    ----------
    image_a, image_b : arrays
        See `clmorph.images.pixels.as_rgb`; they are not reduced.
    {options}

    Returns
    -------
    ReferenceMorph

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    options = PAPER.chosen(REFERENCE_OPTIONS, given)
    sigma_start = check_sigma("sigma_start", options.sigma_start)
    sigma_end = check_sigma("sigma_end", options.sigma_end)
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
