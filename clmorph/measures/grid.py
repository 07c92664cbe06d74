"""Masses on a regular grid of one to three or more axes, whose transport costs are separable."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array, ArrayLike, BoolArray
from clmorph._shared.validation import as_float, shown
from clmorph.backends.arrays import NUMBERS, as_array, as_floats
from clmorph.backends.interface import MAX_AXIS, MAX_POINTS
from clmorph.errors import InputError
from clmorph.measures.measure import check_masses

#: The largest number of axes.
MAX_AXES = 11
#: Largest coordinate of a cell, in the unit of blur and reach.
FARTHEST = 1e6


@dataclass(frozen=True, repr=False, eq=False)
class Grid:
    """The measure sum_i a_i delta_(X_i) over the cells of a grid, as `grid_measure` makes it.

    The squared distance of two cells is a sum over the axes, so that `clmorph.sinkhorn` between two
    grids sums along one axis after the other: it takes time in proportion to the number of cells
    times the lengths of the axes, and memory in proportion to the number of cells.

    Attributes
    ----------
    masses : (n_1, ..., n_D) array
        Masses of the cells, at least 0.
    axes : tuple of D arrays (n_k,)
        Coordinates of the cells along each axis, which ascend or descend.
    mask : (n_1, ..., n_D) array of bool, optional
        The cells that belong to the measure's domain; None if all do. Others have no mass.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> grid = clmorph.grid_measure(np.ones((2, 3)) / 6, spacing=(0.5, 1.0))
    >>> grid
    <Grid of 2 x 3 cells, mass 1>
    >>> grid.points.tolist()[-1], grid.weights.shape
    ([0.5, 2.0], (6,))
    """

    masses: Array
    axes: tuple[Array, ...]
    mask: BoolArray | None = None
    #: A grid has no offsets, see `clmorph.measures.points.WeightedPoints`.
    offsets = None

    def __repr__(self) -> str:
        cells = " x ".join(map(str, self.shape))
        masked = "" if self.mask is None else f", {int(self.mask.sum())} of them in the mask"
        return f"<Grid of {cells} cells{masked}, mass {self.mass:g}>"

    def __len__(self) -> int:
        return self.masses.size

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of cells along the axes."""
        return self.masses.shape

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return self.masses.ndim

    @property
    def weights(self) -> Array:
        """(N,) masses of the cells, in the order of the array (the last axis fastest)."""
        return self.masses.reshape(-1)

    @cached_property
    def points(self) -> Array:
        """(N, D) centers of the cells, an axis a column. Only sums over pairs of points need it."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, len(self.axes))

    @property
    def corners(self) -> Array:
        """(2, D) least and largest coordinates."""
        return np.array([[axis.min() for axis in self.axes], [axis.max() for axis in self.axes]])

    @property
    def mass(self) -> float:
        """Total mass."""
        return float(self.masses.sum())

    def array(self, values: ArrayLike) -> Array:
        """Return a number for each cell, such as `Potentials.f`, as an array of the grid's shape.

        Parameters
        ----------
        values : (N,) or (N, K) array
            In the order of the cells.

        Returns
        -------
        (n_1, ..., n_D) or (n_1, ..., n_D, K) array
            NaN outside of the mask.

        Raises
        ------
        InputError
            If there is not a number for each cell.

        Examples
        --------
        >>> import clmorph
        >>> inside = [[True, True], [True, False]]
        >>> grid = clmorph.grid_measure([[1.0, 2.0], [3.0, 4.0]], mask=inside)
        >>> grid.array(grid.weights).tolist()
        [[1.0, 2.0], [3.0, nan]]
        """
        found = as_floats("values", values, "a number for each cell")
        if found.ndim not in (1, 2) or len(found) != len(self):
            raise InputError(
                f"values have shape {found.shape}: expected ({len(self)},) or ({len(self)}, K), "
                "for the cells of the grid"
            )
        found = found.reshape(*self.shape, *found.shape[1:])
        if self.mask is not None:
            found[~self.mask] = np.nan
        return found

    def with_masses(self, masses: ArrayLike) -> Grid:
        """Return the grid with other masses, (N,) or in the grid's shape; the mask stays.

        Examples
        --------
        >>> import clmorph
        >>> clmorph.grid_measure([1.0, 1.0]).with_masses([0.0, 3.0])
        <Grid of 2 cells, mass 3>
        """
        found = as_floats("masses", masses, "a mass for each cell")
        if found.shape not in (self.shape, (len(self),)):
            raise InputError(f"masses have shape {found.shape}: expected {self.shape}")
        found = found.reshape(self.shape)
        inside = found if self.mask is None else np.where(self.mask, found, 0.0)
        return _checked("masses", replace(self, masses=inside))


def grid_measure(
    values: Any,
    spacing: float | Iterable[float] | None = None,
    origin: float | Iterable[float] | None = None,
    mask: ArrayLike | None = None,
    *,
    axes: Sequence[ArrayLike] | None = None,
) -> Grid:
    """Return masses on a grid (an image, a volume, a field) as a measure.

    Between two such measures `clmorph.sinkhorn`, `clmorph.sinkhorn_divergence`,
    `clmorph.displacement_field`, `clmorph.gradient` and `clmorph.barycenter` (with ``fixed=True``)
    sum along one axis after the other, with memory in proportion to the number of cells. Both grids
    must have the same number of axes; their shapes, spacings and origins may differ.

    Parameters
    ----------
    values : (n_1, ..., n_D) array, or xarray.DataArray
        Masses of the cells, at least 0, of positive sum. They are not scaled: multiply a density by
        the cells' volumes. A DataArray brings the coordinates of its dimensions.
    spacing : float or D floats, optional
        Distance of neighboring cells along each axis, in the unit of blur and reach; 1 by default.
        A negative one descends.
    origin : float or D floats, optional
        Coordinates of the first cell; 0 by default.
    mask : (n_1, ..., n_D) array of bool, optional
        The cells that count. Values elsewhere are ignored, NaN too.
    axes : D arrays (n_k,), optional
        In place of spacing and origin: coordinates that ascend or descend, in any steps.

    Returns
    -------
    Grid

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> x = np.arange(32)
    >>> bump = np.exp(-0.5 * ((x[:, None] - 8) ** 2 + (x - 10) ** 2) / 9)
    >>> source = clmorph.grid_measure(bump / bump.sum(), spacing=1 / 32)
    >>> target = source.with_masses(np.roll(source.masses, 12, axis=0))
    >>> options = {"blur": 0.05, "tol": 1e-5, "backend": "numpy"}
    >>> moved = clmorph.sinkhorn_divergence(source, target, **options)
    >>> round(float(moved), 4), round(0.5 * (12 / 32) ** 2, 4)
    (0.0703, 0.0703)
    """
    dims: Any = getattr(values, "dims", None)
    named = isinstance(dims, tuple) and hasattr(values, "coords")
    masses = as_floats("values", values, "masses of cells")
    if not 1 <= masses.ndim <= MAX_AXES or not masses.size:
        raise InputError(
            f"values have shape {masses.shape}: expected masses of the cells of a grid, with 1 to "
            f"{MAX_AXES} axes"
        )
    if axes is not None and (spacing is not None or origin is not None):
        raise InputError("axes replace spacing and origin: give either of them")
    if axes is None and named and spacing is None and origin is None:
        pairs = zip(dims, masses.shape, strict=True)
        axes = [_coordinates(values, dim, n) for dim, n in pairs]
    if axes is None:
        steps = _each("spacing", spacing, masses.ndim, 1.0)
        if not all(steps):
            raise InputError(f"spacing={shown(spacing)}: expected numbers other than 0")
        starts = _each("origin", origin, masses.ndim, 0.0)
        axes = [
            start + step * np.arange(n)
            for start, step, n in zip(starts, steps, masses.shape, strict=True)
        ]
    chosen = None
    if mask is not None:
        chosen = as_array("mask", mask, "an array of bool")
        if chosen.dtype != bool or chosen.shape != masses.shape:
            raise InputError(
                f"mask has shape {chosen.shape} and dtype {chosen.dtype}: expected {masses.shape} "
                "and bool, as of a comparison"
            )
        theirs = getattr(mask, "dims", dims)
        if named and isinstance(theirs, tuple) and theirs != dims:
            raise InputError(
                f"mask has the dimensions {shown(theirs)}, values {shown(dims)}: expected the same "
                "order; use mask.transpose(*values.dims)"
            )
        chosen = np.array(chosen, bool)
        masses = np.where(chosen, masses, 0.0)
    if not isinstance(axes, list | tuple):
        raise InputError(f"axes={shown(axes)}: expected a list of arrays, one for each axis")
    found = tuple(as_floats(f"axes[{k}]", axis, "coordinates") for k, axis in enumerate(axes))
    return _checked("values", Grid(masses, found, chosen))


def _coordinates(values: Any, dim: Any, n: int) -> AnyArray:
    """Return the coordinates of a dimension of a DataArray; numbers of cells if it has none."""
    if dim not in values.coords:
        return np.arange(n)
    found = np.asarray(values.coords[dim])
    if found.dtype.kind not in NUMBERS:
        raise InputError(
            f"values: the coordinates {shown(dim)} have dtype {found.dtype}: expected numbers; "
            "give axes or spacing"
        )
    return found


def _each(name: str, given: Any, count: int, default: float) -> list[float]:
    """Return a number for each axis."""
    if given is None:
        return [default] * count
    number = as_float(given)
    found = np.full(count, number) if number is not None else as_floats(name, given)
    if found.shape != (count,) or not np.all(np.isfinite(found)):
        raise InputError(
            f"{name}={shown(given)}: expected a finite number, or one for each of {count} axes"
        )
    return [float(each) for each in found]


def _checked(name: str, grid: Grid) -> Grid:
    """Return a grid after checking its parts."""
    shape = grid.masses.shape
    if len(grid.axes) != len(shape) or any(
        axis.shape != (n,) for axis, n in zip(grid.axes, shape, strict=True)
    ):
        given = ", ".join(str(axis.shape) for axis in grid.axes)
        raise InputError(
            f"{name} of shape {shape} with axes of shapes {given}: expected a coordinate for each "
            "place along each axis"
        )
    if math.prod(shape) > MAX_POINTS or max(shape) > MAX_AXIS:
        raise InputError(
            f"{name} have shape {shape}: expected at most {MAX_POINTS} cells, and {MAX_AXIS} along "
            "an axis; use a coarser grid"
        )
    for k, axis in enumerate(grid.axes):
        if not np.all(np.abs(axis) <= FARTHEST):
            raise InputError(
                f"{name}: the coordinates of axis {k} are not all within +-{FARTHEST:g}; choose "
                "another unit"
            )
        steps = np.diff(axis)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise InputError(
                f"{name}: the coordinates of axis {k} must ascend, or descend, without repetition"
            )
    if grid.mask is not None and not grid.mask.any():
        raise InputError("the mask selects no cell: expected True for at least one")
    if np.isnan(grid.masses.min()):
        raise InputError(
            f"{name} hold NaN: expected masses; give a mask that leaves such cells out"
        )
    check_masses(name, grid.masses)
    return grid


def check_grid(name: str, grid: Grid) -> Grid:
    """Check a grid, because a caller can have made it without `grid_measure`."""
    arrays = (grid.masses, *grid.axes) if isinstance(grid.axes, tuple) else (None,)
    usable = all(type(each) is np.ndarray and each.dtype == np.float64 for each in arrays)
    usable = usable and 1 <= grid.masses.ndim <= MAX_AXES and grid.masses.size > 0
    usable = usable and grid.masses.flags.c_contiguous
    if usable and grid.mask is not None:
        usable = type(grid.mask) is np.ndarray and grid.mask.dtype == bool
        usable = usable and grid.mask.shape == grid.masses.shape
        usable = usable and not np.any(grid.masses[~grid.mask])
    if not usable:
        raise InputError(
            f"{name} is not a usable Grid: make it with clmorph.grid_measure, which checks its "
            "parts"
        )
    return _checked(name, grid)


def are_grids(*measures: Any) -> bool:
    """Return whether all these measures are grids, so that sums over cells are separable."""
    return all(isinstance(measure, Grid) for measure in measures)
