"""How far a plan moves things (paper, section 4, Table 1), and what it creates and destroys."""

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
    """Where each source pixel goes on average, and what happens to mass.

    Attributes
    ----------
    field : (H, W, 2) array
        T(x_i) - x_i in pixels of the source, x to the right and y down; T(x_i) is the mean
        destination, sum_j pi_ij y_j / sum_j pi_ij. 0 where nothing leaves.
    source_mass, target_mass : (H, W) arrays
        Kept mass that leaves each source pixel, and that arrives at each target pixel.
    moves : (H, W) array of bool
        Whether that mass is more than the mask.
    destroyed, created : (H, W) arrays
        What does not leave its source pixel, (a_i - r_i)_+, and what is new at its target
        pixel, (b_j - c_j)_+. Unbalanced transport can also move more than there is.
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
        """(H, W) |T(x_i) - x_i|, in pixels."""
        return np.hypot(self.field[..., 0], self.field[..., 1])

    @property
    def max(self) -> float:
        """The largest displacement, in pixels."""
        return float(self.length.max())

    @property
    def mean(self) -> float:
        """Its mean over all pixels, in pixels (the paper's Table 1)."""
        return float(self.length.mean())

    @property
    def mass_weighted_mean(self) -> float:
        """Its mean over the mass that leaves (of rows above the mask), in pixels; 0 if none."""
        mass = np.where(self.moves, self.source_mass, 0.0)
        total = mass.sum()
        return float((self.length * mass).sum() / total) if total > 0 else 0.0


def displacement_statistics(
    source: Measure, target: Measure, plan: Plan, *, mask: float = 0.0
) -> Displacement:
    """Measure what a plan does.

    Parameters
    ----------
    source, target : Measure
        Lifted images.
    plan : Plan
    mask : float
        Rows of at most this mass count as resting (the paper's Table 1: 1e-6, which makes its
        smallest reach look motionless).

    Returns
    -------
    Displacement

    Raises
    ------
    InputError
        If the measures are no images, or not those of the plan.
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
    """Measure what a plan does, from its means and its marginals.

    Parameters
    ----------
    source, target : Measure
        Lifted images of N and M pixels.
    destinations : (N, 2) array
        Mean destination of each source pixel, in the common frame.
    row_mass, column_mass : (N,) and (M,) arrays
        Mass that leaves each source pixel, and that arrives at each target pixel.
    mask : float
        Rows of at most this mass count as resting.

    Returns
    -------
    Displacement
    """
    height, width = source.shape
    moves = row_mass > mask
    # Pixels in a unit of the common frame; with stretched axes as the paper counts them.
    scale = np.full(2, float(max(1, max(source.shape) - 1)))
    if source.extent == "unit":
        scale = np.array([width, height], float)
    field = np.where(moves[:, None], (destinations - source.positions) * scale, 0.0)
    return Displacement(
        field=field.reshape(height, width, 2),
        source_mass=row_mass.reshape(source.shape),
        target_mass=column_mass.reshape(target.shape),
        moves=moves.reshape(height, width),
        destroyed=np.maximum(source.weights - row_mass, 0.0).reshape(source.shape),
        created=np.maximum(target.weights - column_mass, 0.0).reshape(target.shape),
    )
