"""A density on a grid, such as a histogram of two variables or a gray image, as a measure."""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array, ArrayLike
from clmorph.backends.arrays import as_floats
from clmorph.errors import InputError
from clmorph.measures.lift import pixel_positions
from clmorph.measures.measure import check_masses
from clmorph.measures.points import WeightedPoints


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
