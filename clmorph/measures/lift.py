"""From an image to a measure: weighted points in position and color (paper, 2.3, 5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clmorph._shared.arrays import as_floats
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_choice, check_color_weight, shown
from clmorph.backends.interface import MAX_POINTS
from clmorph.errors import InputError
from clmorph.images.color import COLOR_SPACES, ColorSpace, as_metric, square_root, to_space
from clmorph.images.pixels import as_pixels, split_alpha
from clmorph.measures.options import EXTENTS, MASSES, Extent, LiftOptions, Mass

#: Share of linear red, green and blue in luminance (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True, repr=False, eq=False)
class Measure:
    """A sum of Diracs sum_i a_i delta_(x_i, c_i).

    Attributes
    ----------
    positions : (N, 2) array
        x to the right, y down, in the common frame [0, 1]^2.
    colors : (N, 3) array
        sRGB in [0, 1].
    weights : (N,) array
        Masses a_i, at least 0.
    shape : (height, width)
        Of the image that was lifted; N = height * width, row by row.
    color_weight : float
        lambda, the weight of color against position.
    extent : {"true", "unit"}
        How the pixels stand in the common frame.
    color_space : str
        In which colors are compared, see `clmorph.images.color.to_space`.
    color_metric : (3, 3) or (N, 3, 3) array, optional
        M, with which they are compared there: (c - d)^T M (c - d), times lambda^2; one for all
        pixels, or one each (of the source).
    alpha : (N,) array, optional
        Opacity of each pixel; None if all are opaque.
    """

    positions: Array
    colors: Array
    weights: Array
    shape: tuple[int, int]
    color_weight: float
    extent: str
    color_space: str = "srgb"
    color_metric: Array | None = None
    alpha: Array | None = None
    #: Only measures of other costs have some, see `clmorph.measures.points.WeightedPoints`.
    offsets = None

    def __repr__(self) -> str:
        return f"<Measure of {len(self)} points, mass {self.mass:g}>"

    def __len__(self) -> int:
        return len(self.weights)

    @cached_property
    def points(self) -> Array:
        """(N, 5) lifted points (x, y, lambda r, lambda g, lambda b); Eq. 1.

        In other color spaces than sRGB their coordinates, with a metric M = L L^T these times L.
        """
        if self.has_metric_map:
            raise InputError(
                "a source with a map of color metrics has no points of its own: its cost needs "
                "a target"
            )
        colors = self.coordinates
        if self.color_metric is not None:
            colors = colors @ square_root(self.color_metric)
        return np.column_stack((self.positions, self.color_weight * colors))

    @cached_property
    def coordinates(self) -> Array:
        """(N, 3) colors in the space in which they are compared."""
        return to_space(self.colors, self.color_space)

    @property
    def has_metric_map(self) -> bool:
        """Whether every pixel has its own metric of color."""
        return self.color_metric is not None and self.color_metric.ndim == 3

    @property
    def spacing(self) -> float:
        """Distance of neighboring pixels in the common frame; the axes' mean if it differs."""
        height, width = self.shape
        sides = 2 * max(height, width) - 2 if self.extent == "true" else height + width - 2
        return 2.0 / max(1, sides)

    @property
    def mass(self) -> float:
        """Total mass."""
        return float(self.weights.sum())


def pixel_positions(shape: tuple[int, int], extent: str = "true") -> Array:
    """Return where the pixels of an image stand in the common frame.

    Parameters
    ----------
    shape : (height, width)
    extent : {"true", "unit"}
        "true": the longer side spans [0, 1], the shorter is centered. "unit": both span
        [0, 1], as in the paper. A side of one pixel stands at 1/2.

    Returns
    -------
    (height * width, 2) array
        x and y, row by row.
    """
    height, width = shape
    longer = max(height, width)
    across = (longer, longer) if extent == "true" else (height, width)
    y, x = (
        0.5 + (np.arange(side) - (side - 1) / 2) / max(1, span - 1)
        for side, span in zip(shape, across, strict=True)
    )
    grid = np.meshgrid(x, y)
    return np.column_stack([axis.ravel() for axis in grid])


def lift(
    image: ArrayLike,
    color_weight: float = LiftOptions.color_weight,
    *,
    weights: ArrayLike | None = None,
    mass: Mass = LiftOptions.mass,
    extent: Extent = LiftOptions.extent,
    color_space: ColorSpace = LiftOptions.color_space,
    color_metric: ArrayLike | None = None,
) -> Measure:
    """Lift an image into position and color (paper, section 2.3).

    Parameters
    ----------
    image : array
        See `clmorph.images.pixels.as_pixels`. Opacity, if there is any, multiplies the mass.
    color_weight : float
        lambda: how many image sides a full step of one color channel is worth. Color spaces are
        scaled so that it means the same in all of them.
    weights : (H, W) array, optional
        Masses of the pixels, at least 0, of positive sum, in place of `mass`; taken as they are
        (times opacity).
    mass : {"uniform", "luminance", "alpha"}
        The same for every pixel, by its luminance, or by its opacity alone, which there must
        then be. The sum is 1.
    extent : {"true", "unit"}
        See `pixel_positions`.
    color_space : {"srgb", "linear", "lab", "luv", "oklab"}
        In which colors are compared.
    color_metric : (3, 3), (H, W, 3, 3) or (H, W) array, optional
        Metric M of color, constant or (for a source) one for each pixel; a map of numbers
        stands for these times the identity. Distances are lambda^2 (c - d)^T M (c - d).

    Returns
    -------
    Measure

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    colors, alpha = split_alpha(as_pixels(image, max_pixels=MAX_POINTS))
    color_weight = check_color_weight(color_weight)
    check_choice("extent", extent, EXTENTS)
    check_choice("mass", mass, MASSES)
    shape = (colors.shape[0], colors.shape[1])
    n = shape[0] * shape[1]
    if weights is None:
        masses = _masses(colors, alpha, mass)
    else:
        masses = as_floats("weights", weights, "a map (H, W) of masses")
        if masses.shape != shape:
            raise InputError(f"weights have shape {masses.shape}: expected the image's, {shape}")
        if alpha is not None:
            masses *= alpha
        masses = masses.ravel()
        check_masses("weights", masses)
    colors = colors.reshape(n, 3)
    to_space(colors[:1], color_space)  # is there such a one?
    return Measure(
        positions=pixel_positions(shape, extent),
        colors=colors,
        weights=masses,
        shape=shape,
        color_weight=color_weight,
        extent=extent,
        color_space=color_space,
        color_metric=None if color_metric is None else as_metric(color_metric, shape),
        alpha=None if alpha is None else alpha.ravel(),
    )


def check_masses(name: str, masses: Array) -> None:
    """Check masses of points.

    Raises
    ------
    InputError
        If one is negative or NaN, or their sum is out of range.
    """
    with np.errstate(over="ignore"):
        total = masses.sum()
    if not (np.all(masses >= 0) and 1e-30 <= total <= 1e30):
        raise InputError(
            f"{name}: expected masses of at least 0 with a positive sum, from 1e-30 to 1e30; "
            "replace negative or missing ones by 0, and scale them"
        )


def check_measure(name: str, measure: Measure) -> None:
    """Check a lifted image, whose parts a caller can have replaced.

    Raises
    ------
    InputError
        If a part is not what `Measure` says it is.
    """
    remedy = "lift the image again with clmorph.lift, which checks what it is given"
    try:
        height, width = measure.shape
        n = int(height) * int(width)
        if min(height, width) < 1:
            raise InputError(f"its shape is {height} x {width}")
        check_color_weight(measure.color_weight)
        check_choice("extent", measure.extent, EXTENTS)
        check_choice("color_space", measure.color_space, COLOR_SPACES)
    except (TypeError, ValueError) as error:
        reason = f": {error}" if isinstance(error, InputError) else ""
        raise InputError(f"{name} is no usable Measure{reason}; {remedy}") from None
    shapes = {"positions": (n, 2), "colors": (n, 3), "weights": (n,)}
    if measure.alpha is not None:
        shapes["alpha"] = (n,)
    for part, shape in shapes.items():
        array = getattr(measure, part)
        usable = type(array) is np.ndarray and array.dtype == np.float64 and array.shape == shape
        low, high = (-1e6, 1e6) if part == "positions" else (-1e-6, 1 + 1e-6)
        # NaN is within no range.
        if usable and part != "weights":
            usable = bool(array.min() >= low and array.max() <= high)
        if not usable:
            raise InputError(
                f"{name} has {part} {shown(array)}: expected a float64 array of shape {shape}, "
                f"each from {low:g} to {high:g}; {remedy}"
                if part != "weights"
                else f"{name} has weights {shown(array)}: expected a float64 array of shape "
                f"{shape}; {remedy}"
            )
    check_masses(f"{name}: its weights", measure.weights)
    if measure.color_metric is not None:
        metric = measure.color_metric
        usable = type(metric) is np.ndarray and metric.shape in ((3, 3), (n, 3, 3))
        if not usable or metric.dtype != np.float64 or not np.all(np.isfinite(metric)):
            raise InputError(
                f"{name} has color_metric {shown(metric)}: expected a finite float64 array of "
                f"shape (3, 3) or {(n, 3, 3)}; {remedy}"
            )


def _masses(colors: Array, alpha: Array | None, mass: str) -> Array:
    """Masses by a rule: (N,) array of sum 1."""
    if mass == "alpha" and alpha is None:
        raise InputError("mass='alpha': the image is opaque; use 'uniform', or an RGBA image")
    masses = np.ones(colors.shape[:2])
    if mass == "luminance":
        masses = to_space(colors, "linear") @ LUMINANCE
    if alpha is not None:
        masses = masses * alpha
    total = masses.sum()
    if total <= 0:
        what = "black" if mass == "luminance" else "transparent"
        raise InputError(f"mass={mass!r}: every pixel of the image is {what}, so there is no mass")
    return (masses / total).ravel()
