"""How far a plan between images (paper, 4, Table 1), or between grids, moves mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph._shared.validation import check_number
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.grid import Grid
from clmorph.measures.measure import Measure
from clmorph.measures.points import as_image_measure, as_pair
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport.plan import Plan, check_plan
from clmorph.transport.potentials import Potentials


@dataclass(frozen=True, repr=False, eq=False)
class Displacement:
    """Mean displacement of each source pixel, and the mass that moves, dies and is born.

    Attributes
    ----------
    field : (H, W, 2) array
        T(x_i) - x_i in pixels of the source, x to the right and y down; T(x_i) is the mean
        destination, sum_j pi_ij y_j / sum_j pi_ij. The displacement is 0 where no mass leaves.
    source_mass, target_mass : (H, W) arrays
        Mass that leaves each source pixel, and mass that arrives at each target pixel.
    moves : (H, W) array of bool
        Whether the mass that leaves a source pixel is more than the mask.
    destroyed, created : (H, W) arrays
        Mass that does not leave its source pixel, (a_i - r_i)_+, and mass that is new at its target
        pixel, (b_j - c_j)_+ (math: mass in motion). Unbalanced transport can also move more mass
        than a pixel has.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = clmorph.lift(np.array([[0.0, 1.0], [0.0, 1.0]]), color_weight=2.0)
    >>> target = clmorph.lift(np.array([[1.0, 0.0], [1.0, 0.0]]), color_weight=2.0)
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.05, reach=0.3, backend="numpy")
    >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
    >>> moved = clmorph.displacement_statistics(source, target, plan)
    >>> moved.field.round(3).tolist()
    [[[1.0, 0.0], [-1.0, 0.0]], [[1.0, 0.0], [-1.0, 0.0]]]
    >>> round(moved.max, 3), round(float(moved.destroyed.sum()), 3)
    (1.0, 0.937)
    """

    field: Array
    source_mass: Array
    target_mass: Array
    moves: BoolArray
    destroyed: Array
    created: Array

    def __repr__(self) -> str:
        return (
            f"<Displacement of at most {self.max:.4g}, on average {self.mass_weighted_mean:.4g} "
            f"pixels, {self.source_mass.sum():.4g} moved, {self.destroyed.sum():.4g} destroyed, "
            f"{self.created.sum():.4g} created>"
        )

    @property
    def length(self) -> Array:
        """(H, W) displacements |T(x_i) - x_i|, in pixels."""
        return np.hypot(self.field[..., 0], self.field[..., 1])

    @property
    def max(self) -> float:
        """The largest displacement, in pixels."""
        return float(self.length.max())

    @property
    def mean(self) -> float:
        """The mean displacement of all source pixels, in pixels (paper, Table 1)."""
        return float(self.length.mean())

    @property
    def mass_weighted_mean(self) -> float:
        """The mean displacement weighted by the mass that leaves, in pixels; 0 if none leaves.

        Rows at or below the mask do not count.
        """
        mass = np.where(self.moves, self.source_mass, 0.0)
        total = mass.sum()
        return float((self.length * mass).sum() / total) if total > 0 else 0.0


def displacement_statistics(
    source: Measure, target: Measure, plan: Plan, *, mask: float = 0.0
) -> Displacement:
    """Measure how far a plan moves mass, and how much it creates and destroys (paper, Table 1).

    Parameters
    ----------
    source, target : Measure
        Lifted images.
    plan : Plan
    mask : float
        Rows of at most this mass count as resting. The paper's Table 1 uses 1e-6, which makes its
        smallest reach look motionless.

    Returns
    -------
    Displacement

    Raises
    ------
    InputError
        If the measures are no images, or the plan belongs to other measures.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = clmorph.lift(np.array([[0.0, 1.0], [0.0, 1.0]]), color_weight=2.0)
    >>> target = clmorph.lift(np.array([[1.0, 0.0], [1.0, 0.0]]), color_weight=2.0)
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.05, reach=0.3, backend="numpy")
    >>> plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
    >>> moved = clmorph.displacement_statistics(source, target, plan)
    >>> round(moved.mass_weighted_mean, 3), round(float(moved.source_mass.sum()), 3)
    (1.0, 0.063)
    """
    mask = check_number("mask", mask, 0.0, 1e30)
    why = "displacements are in pixels", ", or use plan.mean_destinations(x, y) for plain points"
    source = as_image_measure("source", source, *why)
    target = as_image_measure("target", target, *why)
    check_plan("plan", plan, (len(source), len(target)))
    destinations, _ = plan.mean_destinations(source.positions, target.positions)
    return displacement_of(source, target, destinations, *plan.marginals, mask)


def displacement_of(
    source: Measure,
    target: Measure,
    destinations: Array,
    row_mass: Array,
    column_mass: Array,
    mask: float = 0.0,
) -> Displacement:
    """Measure how far a plan moves mass, by mean destinations (N, 2) and marginals (N,), (M,)."""
    height, width = source.shape
    moves = row_mass > mask
    # Number of pixels in one unit of the common frame; stretched axes follow the paper's Table 1.
    scale = np.full(2, float(max(1, max(source.shape) - 1)))
    if source.extent == "unit":
        scale = np.array([width, height], float)
    # T(x_i) - x_i (paper, section 4)
    field = np.where(moves[:, None], (destinations - source.positions) * scale, 0.0)
    return Displacement(
        field=field.reshape(height, width, 2),
        source_mass=row_mass.reshape(source.shape),
        target_mass=column_mass.reshape(target.shape),
        moves=moves.reshape(height, width),
        destroyed=np.maximum(source.weights - row_mass, 0.0).reshape(source.shape),
        created=np.maximum(target.weights - column_mass, 0.0).reshape(target.shape),
    )


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
