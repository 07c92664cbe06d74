"""From an image to a measure: weighted points in position and color (paper, 2.3)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph import defaults
from clmorph.checks import check_choice, check_color_weight
from clmorph.errors import InputError
from clmorph.images import as_rgb
from clmorph.operations import MAX_POINTS

#: How pixels stand in the common frame: "true" keeps the aspect ratio, "unit" stretches
#: each axis to [0, 1].
EXTENTS = ("true", "unit")


@dataclass(frozen=True, repr=False)
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
    """

    positions: NDArray[np.float64]
    colors: NDArray[np.float64]
    weights: NDArray[np.float64]
    shape: tuple[int, int]
    color_weight: float
    extent: str

    def __repr__(self) -> str:
        return f"<Measure of {len(self)} points, mass {self.mass:g}>"

    def __len__(self) -> int:
        return len(self.weights)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(N, 5) lifted points (x, y, lambda r, lambda g, lambda b); Eq. 1."""
        return np.column_stack((self.positions, self.color_weight * self.colors))

    @property
    def mass(self) -> float:
        """Total mass."""
        return float(self.weights.sum())


def pixel_positions(shape: tuple[int, int], extent: str = "true") -> NDArray[np.float64]:
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
    color_weight: float = defaults.COLOR_WEIGHT,
    *,
    weights: ArrayLike | None = None,
    extent: str = "true",
) -> Measure:
    """Lift an image into position and color (paper, section 2.3).

    Parameters
    ----------
    image : array
        See `clmorph.images.as_rgb`.
    color_weight : float
        lambda: how many image sides a full step of one color channel is worth.
    weights : (H, W) array, optional
        Masses of the pixels, at least 0, of positive sum; 1 / (H W) each if not given.
    extent : {"true", "unit"}
        See `pixel_positions`.

    Returns
    -------
    Measure

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    sides = np.shape(image)[:2]
    if np.prod(sides, dtype=float) > MAX_POINTS:
        raise InputError(
            f"the image has shape {sides}: expected at most {MAX_POINTS} pixels in all; "
            "reduce it with clmorph.fit"
        )
    pixels = as_rgb(image)
    color_weight = check_color_weight(color_weight)
    check_choice("extent", extent, EXTENTS)
    shape = (pixels.shape[0], pixels.shape[1])
    n = shape[0] * shape[1]
    if weights is None:
        masses = np.full(n, 1.0 / n)
    else:
        masses = np.asarray(weights, dtype=float)
        if masses.shape != shape:
            raise InputError(f"weights have shape {masses.shape}: expected the image's, {shape}")
        masses = masses.ravel()
        with np.errstate(over="ignore"):
            total = masses.sum()
        if not (np.all(masses >= 0) and 1e-30 <= total <= 1e30):
            raise InputError(
                "weights: expected masses of at least 0 with a positive sum, from 1e-30 to 1e30; "
                "replace negative or missing ones by 0, and scale them"
            )
    return Measure(
        positions=pixel_positions(shape, extent),
        colors=pixels.reshape(n, 3),
        weights=masses,
        shape=shape,
        color_weight=color_weight,
        extent=extent,
    )
