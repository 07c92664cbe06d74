"""How far and where a plan between two grids moves mass: a vector for each cell, and the cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.grid import Grid
from clmorph.measures.points import as_pair
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport.potentials import Potentials


@dataclass(frozen=True, repr=False, eq=False)
class DisplacementField:
    """The mean displacement of each cell of a grid, and statistics of the plan.

    Attributes
    ----------
    field : (n_1, ..., n_D, D) array
        T(x_i) - x_i along each axis, in the unit of the coordinates; T(x_i) is the mean
        destination, sum_j pi_ij y_j / sum_j pi_ij. The displacement is 0 where no mass leaves.
    row_mass, column_mass : (n_1, ..., n_D) and (m_1, ..., m_D) arrays
        Mass that leaves each cell of the source, and that arrives in each cell of the target.
    cost : float
        Cost <C, pi> of the plan, cost units times mass, without penalties and entropy.

    Examples
    --------
    >>> import clmorph
    >>> source = clmorph.grid_measure([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    >>> target = clmorph.grid_measure([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, backend="numpy")
    >>> moved = clmorph.displacement_field(source, target, potentials, backend="numpy")
    >>> moved.field[0, 0].round(6).tolist(), round(moved.cost, 6)
    ([1.0, 2.0], 2.5)
    """

    field: Array
    row_mass: Array
    column_mass: Array
    cost: float

    def __repr__(self) -> str:
        return (
            f"<DisplacementField of mean length {self.mean:.4g}, transported "
            f"{self.transported_mass:.4g}, cost {self.cost:.4g}>"
        )

    @property
    def length(self) -> Array:
        """(n_1, ..., n_D) displacements |T(x_i) - x_i|."""
        return np.asarray(np.sqrt(np.einsum("...d,...d->...", self.field, self.field)))

    @property
    def mean(self) -> float:
        """The mean displacement, weighted by the mass that leaves; 0 if none leaves."""
        return float((self.length * self.row_mass).sum()) / (self.transported_mass or 1.0)

    @property
    def transported_mass(self) -> float:
        """Mass of the plan."""
        return float(self.row_mass.sum())


def displacement_field(
    source: Grid, target: Grid, potentials: Potentials, *, backend: Backend = "auto"
) -> DisplacementField:
    """Return where the plan of potentials sends the mass of each cell of a grid, and its cost.

    The plan is not stored: means follow from one more sum along the axes for each axis.

    Parameters
    ----------
    source, target : Grid
        The measures of the potentials, see `clmorph.grid_measure`.
    potentials : Potentials
        Potentials of `clmorph.sinkhorn`.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    DisplacementField

    Raises
    ------
    InputError
        If an argument cannot be used; `clmorph.barycentric_plan` is for points.

    Examples
    --------
    >>> import clmorph
    >>> source = clmorph.grid_measure([1.0, 1.0, 0.0, 0.0], spacing=0.1)
    >>> target = source.with_masses([0.0, 0.0, 1.0, 1.0])
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.01, reach=0.5, backend="numpy")
    >>> moved = clmorph.displacement_field(source, target, potentials, backend="numpy")
    >>> moved.field.round(3).ravel().tolist()
    [0.2, 0.194, 0.0, 0.0]
    >>> round(moved.transported_mass, 2)  # of 2: the rest is destroyed and created
    1.92
    """
    pair = as_pair(source, target)
    first, second = pair
    if not (isinstance(first, Grid) and isinstance(second, Grid)):
        raise InputError(
            "source and target: expected two grids, as clmorph.grid_measure makes them; for points "
            "use clmorph.barycentric_plan"
        )
    _, mean = RowsOfPlan(get_backend(backend), pair, potentials, (None, None)).projection()
    mean = mean.reshape(*first.shape, first.dimension)
    row_mass, column_mass = first.array(potentials.row_mass), second.array(potentials.column_mass)
    for mass in (row_mass, column_mass):
        np.nan_to_num(mass, copy=False)  # no mass outside of a mask
    cost = 0.0
    moves = row_mass > 0
    for k, (x, y) in enumerate(zip(first.axes, second.axes, strict=True)):
        # |x - y|^2 = x^2 + y^2 - 2 x y, around the middle, so that squares are small.
        middle = 0.5 * float(first.corners[:, k].mean() + second.corners[:, k].mean())
        x, y = x - middle, y - middle
        along = [-1 if other == k else 1 for other in range(first.dimension)]
        places = x.reshape(along)
        others = tuple(other for other in range(first.dimension) if other != k)
        leaving, arriving = row_mass.sum(axis=others), column_mass.sum(axis=others)
        mixed = float((row_mass * places * (mean[..., k] - middle)).sum())
        cost += 0.5 * float(leaving @ x**2 + arriving @ y**2) - mixed
        mean[..., k] -= places + middle
        mean[..., k] *= moves
    return DisplacementField(mean, row_mass, column_mass, max(cost, 0.0))
