"""From images and densities to measures: points in position and color (paper, 2.3, 5)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, ArrayLike
from clmorph.backends.arrays import as_array, as_floats
from clmorph.backends.interface import MAX_POINTS
from clmorph.errors import InputError
from clmorph.images.color import ColorSpace, as_metric, to_space
from clmorph.images.flat_colors import foreground
from clmorph.images.pixels import as_pixels, split_alpha
from clmorph.measures.measure import Measure, check_masses
from clmorph.measures.options import Extent, LiftOptions, Mass
from clmorph.measures.points import WeightedPoints

#: Weights of linear red, green and blue in luminance (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class NoMassError(InputError):
    """An image of which every pixel is transparent, or black; the message says "the image"."""


def pixel_positions(shape: tuple[int, int], extent: str = "true") -> Array:
    """Return the positions (x, y) of the pixels of an image in the common frame (paper, 2.3).

    They are (height * width, 2), row by row. With the extent "true" the longer side spans [0, 1],
    and the shorter side is centered. With "unit" both sides span [0, 1], as in the paper. The
    coordinate along a side of one pixel is 1/2.
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
    """Lift an image into position and color: X_i = (x_i, lambda c_i) (paper, 2.3).

    Parameters
    ----------
    image : array_like
        (H, W), (H, W, 1), (H, W, 3) or (H, W, 4); uint8, uint16, bool, or float in [0, 1].
        Opacity, the fourth channel, multiplies the mass.
    color_weight : float
        lambda: the number of image sides that a full step of one color channel is worth. Color
        spaces are scaled so that it means the same in all of them.
    weights : (H, W) array, optional
        Masses of the pixels, at least 0, of positive sum, in place of `mass`. They are not
        normalized; opacity multiplies them.
    mass : {"uniform", "luminance", "alpha", "foreground"}
        The mass of a pixel: the same for all, its luminance, or its opacity alone, which the image
        must then have; or the same for all pixels before a transparent or flat background, whatever
        their opacity (`clmorph.images.flat_colors.foreground`). The masses are normalized to the
        sum 1.
    extent : {"true", "unit"}
        See `clmorph.measures.lift.pixel_positions`.
    color_space : {"srgb", "linear", "lab", "luv", "oklab"}
        The space in which colors are compared.
    color_metric : (3, 3), (H, W, 3, 3) or (H, W) array, optional
        Metric M of color: constant, or (for a source) one for each pixel. A map (H, W) of numbers
        stands for these times the identity. Squared distances of colors are
        lambda^2 (c - d)^T M (c - d) (paper, 5).

    Returns
    -------
    Measure

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> image = np.zeros((2, 3, 3))
    >>> image[..., 0] = 1.0
    >>> measure = clmorph.lift(image, color_weight=2.0)
    >>> measure
    <Measure of 6 points, mass 1>
    >>> measure.points[0].tolist()
    [0.0, 0.25, 2.0, 0.0, 0.0]
    """
    colors, alpha = split_alpha(as_pixels(image, max_pixels=MAX_POINTS))
    color_weight = LiftOptions.checked("color_weight", color_weight)
    LiftOptions.checked("extent", extent)
    LiftOptions.checked("mass", mass)
    shape = (colors.shape[0], colors.shape[1])
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
    colors = colors.reshape(-1, 3)
    to_space(colors[:1], color_space)  # raises an error if there is no such space
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
    """Return masses by a rule: (N,) array of sum 1."""
    if mass == "alpha" and alpha is None:
        raise InputError("mass='alpha': the image is opaque; use 'uniform', or an RGBA image")
    masses: Array = np.ones(colors.shape[:2])
    if mass == "luminance":
        masses = to_space(colors, "linear") @ LUMINANCE
    if mass == "foreground":
        masses = masses * foreground(colors, alpha)
    if alpha is not None:
        masses = masses * (alpha > 0 if mass == "foreground" else alpha)
    total = masses.sum()
    if total <= 0:
        what = "black" if mass == "luminance" else "transparent"
        raise NoMassError(f"mass={mass!r}: every pixel of the image is {what}, so there is no mass")
    return (masses / total).ravel()


def lift_pair(
    images: tuple[ArrayLike, ArrayLike], *, weights: Any, color_metric: ArrayLike | None,
    **options: Any,
) -> tuple[Measure, Measure]:  # fmt: skip
    """Lift two images with the same options of `lift`.

    The maps (H, W) of mass in `weights` are not normalized. If one of them is None, `mass` gives
    its distribution, with the total of the other map. A map as `color_metric` belongs to the source
    alone.
    """
    maps = (None, None) if weights is None else weights
    if not isinstance(maps, tuple | list) or len(maps) != 2:
        raise InputError(
            "weights: expected a pair of maps (H, W), one for each image; None in it stands for "
            "the rule that `mass` names"
        )
    metrics: tuple[Any, Any] = None, None
    if color_metric is not None:
        metric = as_array("color_metric", color_metric, "an array (3, 3), (H, W, 3, 3) or (H, W)")
        metrics = metric, metric if metric.shape == (3, 3) else None
    found = []
    for letter, image, given, metric in zip("ab", images, maps, metrics, strict=True):
        try:
            found.append(lift(image, weights=given, color_metric=metric, **options))
        except NoMassError as error:
            raise InputError(str(error).replace("the image", f"image_{letter}")) from None
    source, target = found
    if maps[0] is None and maps[1] is not None:
        source = replace(source, weights=source.weights * (target.mass / source.mass))
    if maps[1] is None and maps[0] is not None:
        target = replace(target, weights=target.weights * (source.mass / target.mass))
    return source, target


def density(values: ArrayLike) -> WeightedPoints:
    """Return a density on a grid as points in 2D, one for each cell of positive mass.

    Parameters
    ----------
    values : (H, W) array
        Masses of the cells, at least 0, of positive sum; they are not scaled. Rows go down and
        columns to the right, as in an image: transpose what `numpy.histogram2d` returns.

    Returns
    -------
    WeightedPoints
        Centers of the cells in image sides: the longer side spans [0, 1], the shorter one is
        centered, as in `clmorph.lift`.

    Raises
    ------
    InputError
        If the values are no such array.

    Examples
    --------
    >>> import clmorph
    >>> measure = clmorph.density([[0.0, 1.0, 3.0]])
    >>> measure
    <2 WeightedPoints in 2D, mass 4>
    >>> measure.points.tolist(), measure.weights.tolist()
    ([[0.5, 0.5], [1.0, 0.5]], [1.0, 3.0])
    """
    grid = check_density("values", values)
    there = np.flatnonzero(grid)
    return WeightedPoints(pixel_positions(grid.shape)[there], grid.ravel()[there])


def check_density(name: str, values: ArrayLike) -> Array:
    """Return a density, two-dimensional masses, as an array of float64."""
    grid = as_floats(name, values, "masses (H, W)")
    if grid.ndim != 2 or not grid.size:
        raise InputError(f"{name} has shape {grid.shape}: expected masses (H, W) of a grid")
    check_masses(name, grid)
    return grid
