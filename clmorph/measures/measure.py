"""A lifted image: a measure of weighted points in position and color (paper, 2.3 and 5)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clmorph._shared.typing import Array
from clmorph._shared.validation import shown
from clmorph.backends.interface import MAX_LIFTED
from clmorph.errors import InputError
from clmorph.images.color import square_root, to_space
from clmorph.measures.options import LiftOptions

#: Coordinates that may lie far outside [0, 1].
FAR = ("positions", "warped", "features")


@dataclass(frozen=True, repr=False, eq=False)
class Measure:
    """The measure sum_i a_i delta_(x_i, c_i) of a lifted image (paper, 2.3).

    Attributes
    ----------
    positions : (N, 2) array
        x to the right, y down, in the common frame [0, 1]^2.
    colors : (N, 3) array
        sRGB in [0, 1].
    weights : (N,) array
        Masses a_i, at least 0.
    shape : (height, width)
        Shape of the lifted image; its N = height * width pixels are stored row by row.
    color_weight : float
        lambda, the weight of color relative to position.
    extent : {"true", "unit"}
        Placement of the pixels in the common frame, see `clmorph.measures.lift.pixel_positions`.
    color_space : str
        The space in which colors are compared, see `clmorph.images.color.to_space`.
    color_metric : (3, 3) or (N, 3, 3) array, optional
        Metric M of colors in that space: squared distances are lambda^2 (c - d)^T M (c - d)
        (paper, 5). One for all pixels, or one for each pixel (of a source).
    alpha : (N,) array, optional
        Opacity of each pixel; None if all are opaque.
    warped : (N, 2) array, optional
        Positions that the cost compares in place of `positions`, at which pixels are drawn
        (`clmorph.measures.landmarks`).
    features : (N, K) array, optional
        Further coordinates of the cost, in the unit of positions.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> measure = clmorph.lift(np.eye(2))
    >>> len(measure), measure.shape, measure.mass, measure.spacing
    (4, (2, 2), 1.0, 1.0)
    >>> measure.positions.tolist()
    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
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
    warped: Array | None = None
    features: Array | None = None
    #: A lifted image has no offsets, see `clmorph.measures.points.WeightedPoints`.
    offsets = None

    def __repr__(self) -> str:
        return f"<Measure of {len(self)} points, mass {self.mass:g}>"

    def __len__(self) -> int:
        return len(self.weights)

    @cached_property
    def points(self) -> Array:
        """(N, 5 + K) lifted points X = (x, y, lambda r, lambda g, lambda b) (paper, 2.3, Eq. 1).

        In another color space, the coordinates of that space replace r, g, b. With a metric
        M = L L^T they are multiplied by L (paper, 5), so that |X - Y|^2 includes the metric.
        Features, if there are any, follow.
        """
        if self.has_metric_map:
            raise InputError(
                "a source with a map of color metrics has no points of its own: its cost needs "
                "a target"
            )
        colors = self.coordinates
        if self.color_metric is not None:
            colors = colors @ square_root(self.color_metric)
        places = self.positions if self.warped is None else self.warped
        further = [] if self.features is None else [self.features]
        return np.column_stack((places, self.color_weight * colors, *further))

    @cached_property
    def coordinates(self) -> Array:
        """(N, 3) coordinates of the colors in the space in which colors are compared."""
        return to_space(self.colors, self.color_space)

    @property
    def has_metric_map(self) -> bool:
        """Whether every pixel has its own metric of color."""
        return self.color_metric is not None and self.color_metric.ndim == 3

    @property
    def spacing(self) -> float:
        """Distance of neighboring pixels in the common frame, as a mean over both axes."""
        height, width = self.shape
        sides = 2 * max(height, width) - 2 if self.extent == "true" else height + width - 2
        return 2.0 / max(1, sides)

    @property
    def mass(self) -> float:
        """Total mass."""
        return float(self.weights.sum())


def with_more(measure: Measure, features: Array) -> Measure:
    """Return a measure with further features, (N, K), behind its own."""
    own = [] if measure.features is None else [measure.features]
    return replace(measure, features=np.column_stack((*own, features)))


def check_masses(name: str, masses: Array) -> None:
    """Check masses of points: at least 0, with a sum in range."""
    with np.errstate(over="ignore"):
        total = masses.sum()
    wrong = masses[~(masses >= 0)]
    if wrong.size or not 1e-30 <= total <= 1e30:
        what = f"one is {wrong[0]:g}" if wrong.size else f"their sum is {total:g}"
        raise InputError(
            f"{name}: {what}; expected masses of at least 0 with a positive sum, from 1e-30 to "
            "1e30: replace negative or missing ones by 0, and scale them"
        )


def check_measure(name: str, measure: Measure) -> None:
    """Check a lifted image, because a caller can have replaced its attributes."""
    remedy = "lift the image again with clmorph.lift, which checks what it is given"
    try:
        height, width = measure.shape
        n = int(height) * int(width)
        if min(height, width) < 1:
            raise InputError(f"its shape is {height} x {width}")
        for option in ("color_weight", "extent", "color_space"):
            LiftOptions.checked(option, getattr(measure, option))
    except (TypeError, ValueError) as error:
        reason = f": {error}" if isinstance(error, InputError) else ""
        raise InputError(f"{name} is not a usable Measure{reason}; {remedy}") from None
    given = measure.features if type(measure.features) is np.ndarray else np.empty(0)
    count = given.shape[1] if given.ndim == 2 else 1
    shapes = {
        "positions": (n, 2), "colors": (n, 3), "weights": (n,), "alpha": (n,), "warped": (n, 2),
        "features": (n, min(max(1, count), MAX_LIFTED - 5)),
    }  # fmt: skip
    for part, shape in shapes.items():
        array = getattr(measure, part)
        if array is None and part in ("alpha", "warped", "features"):
            continue
        usable = type(array) is np.ndarray and array.dtype == np.float64 and array.shape == shape
        low, high = (-1e6, 1e6) if part in FAR else (-1e-6, 1 + 1e-6)
        # Comparisons with NaN are false, so NaN does not pass this check.
        if usable and part != "weights":
            usable = bool(array.min() >= low and array.max() <= high)
        if not usable:
            bounds = "" if part == "weights" else f", each from {low:g} to {high:g}"
            raise InputError(
                f"{name} has {part} {shown(array)}: expected a float64 array of shape {shape}"
                f"{bounds}; {remedy}"
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
