"""Measure how far a plan moves mass (paper, 4, Table 1), and how much it creates and destroys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array, BoolArray
from clmorph._shared.validation import check_number
from clmorph.measures.measure import Measure
from clmorph.measures.points import as_image_measure
from clmorph.transport.plan import Plan, check_plan


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
    instead = ", or use plan.mean_destinations(x, y) for plain points"
    source, target = (
        as_image_measure(name, measure, "displacements are in pixels", instead)
        for name, measure in (("source", source), ("target", target))
    )
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
