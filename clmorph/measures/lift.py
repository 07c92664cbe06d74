"""From an image to a measure: weighted points in position and color (paper, 2.3, 5)."""

from __future__ import annotations

import numpy as np

from clmorph._shared.arrays import as_floats
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_choice, check_color_weight
from clmorph.backends.interface import MAX_POINTS
from clmorph.errors import InputError
from clmorph.images.color import as_metric, to_space
from clmorph.images.pixels import as_pixels, split_alpha
from clmorph.measures.measure import EXTENTS, Measure, check_masses
from clmorph.pipeline import presets as defaults

#: What a pixel weighs, apart from its opacity: the same everywhere, its luminance (Y of CIE
#: XYZ), or, said expressly, its opacity alone.
MASSES = ("uniform", "luminance", "alpha")

#: Share of linear red, green and blue in luminance (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


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
    color_weight: float = defaults.COLOR_WEIGHT,
    *,
    weights: ArrayLike | None = None,
    mass: str = "uniform",
    extent: str = "true",
    color_space: str = "srgb",
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
