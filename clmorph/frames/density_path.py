"""Displacement interpolation of two densities: mass moves, it does not fade over.

Every pair of a plan moves along a straight line at constant speed (McCann, "A convexity principle
for interacting gases", Advances in Mathematics 128, 1997). Mass that unbalanced transport leaves
unmatched stays where it is and fades, as that of a morph's particles does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_number
from clmorph.backends.select import Backend, get_backend
from clmorph.frames.canvas import canvas_at
from clmorph.measures.lift import check_density, density, pixel_positions
from clmorph.transport.options import Reach, SolverOptions
from clmorph.transport.plan import Plan
from clmorph.transport.plan_building import transport_plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.sinkhorn import sinkhorn

#: Number of pairs that are moved at once.
CHUNK = 1 << 20


@dataclass(frozen=True, repr=False, eq=False)
class DensityPath:
    """The path of densities from a source to a target.

    Attributes
    ----------
    source, target : (H, W) and (H', W') arrays
        Masses of the cells.
    potentials : Potentials
        The solution of the transport between the cells of positive mass.
    plan : Plan
        Its pairs; points are these cells, row by row.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> path = clmorph.density_path(np.eye(5)[:1], np.eye(5)[4:], backend="numpy")
    >>> path
    <DensityPath from 1 x 5 to 1 x 5 cells, mass 1 to 1>
    >>> path.at(0.5).round(3).tolist()
    [[0.0, 0.0, 1.0, 0.0, 0.0]]
    """

    source: Array
    target: Array
    potentials: Potentials
    plan: Plan

    def __repr__(self) -> str:
        sizes = " to ".join(f"{h} x {w}" for h, w in (self.source.shape, self.target.shape))
        return (
            f"<DensityPath from {sizes} cells, mass {self.source.sum():g} to {self.target.sum():g}>"
        )

    def at(self, t: float) -> Array:
        """Return the density at a time.

        A pair's mass is divided among the four cells around its position, in proportion to their
        nearness. The total mass goes linearly from that of the source to that of the target.

        Parameters
        ----------
        t : float
            From 0, the source, to 1, the target.

        Returns
        -------
        (H, W) array
            Masses of the cells. Between grids of different sizes, sides go linearly from those of
            the source to those of the target, as a morph's canvas does.
        """
        t = check_number("t", t, 0.0, 1.0)
        if t in (0.0, 1.0):
            return np.array(self.target if t else self.source)
        canvas = canvas_at(t, self.source.shape, self.target.shape)
        total = np.zeros(canvas.shape[0] * canvas.shape[1])
        cells = [np.flatnonzero(grid) for grid in (self.source, self.target)]
        positions = [
            pixel_positions(grid.shape)[there]
            for grid, there in zip((self.source, self.target), cells, strict=True)
        ]
        rows, plan = self.plan.rows, self.plan
        for first in range(0, len(plan), CHUNK):
            part = slice(first, first + CHUNK)
            start, end = positions[0][rows[part]], positions[1][plan.indices[part]]
            total += _shared(canvas, (1 - t) * start + t * end, plan.mass[part])
        for share, place, grid, there, moved in (
            (1 - t, positions[0], self.source, cells[0], plan.row_mass),
            (t, positions[1], self.target, cells[1], plan.column_mass),
        ):
            # Rounding, or a residual, can leave slightly more than the mass in the pairs.
            total += share * _shared(canvas, place, grid.ravel()[there] - moved)
        found = np.maximum(total, 0.0).reshape(canvas.shape)
        # Cells that would be negative become empty, which must not add mass.
        return found * (((1 - t) * self.source.sum() + t * self.target.sum()) / found.sum())


def _shared(canvas: Any, positions: Array, mass: Array) -> Array:
    """Return masses at positions, each divided among the four cells around it: (H * W,) array."""
    height, width = canvas.shape
    places = canvas.places(positions)
    corner = np.floor(places)
    upper = places - corner
    total = np.zeros(height * width)
    for down in (0, 1):
        for right in (0, 1):
            row, column = corner[0] + down, corner[1] + right
            near = (upper[0] if down else 1 - upper[0]) * (upper[1] if right else 1 - upper[1])
            row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
            total += np.bincount(
                (row * width + column).astype(np.int64), near * mass, height * width
            )
    return total


def density_path(
    source: ArrayLike,
    target: ArrayLike,
    blur: float | None = None,
    reach: Reach = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
) -> DensityPath:
    """Return the displacement interpolation between two densities on grids.

    Entropic transport spreads a cell's mass over destinations within about `blur`, and densities
    between the ends are as much softer, most at t = 1/2. A smaller blur is sharper, and slower.

    Parameters
    ----------
    source, target : (H, W) and (H', W') arrays
        Masses of the cells, see `clmorph.density`. If `reach` is None they must have equal sums.
    blur, reach, tol, max_iter, backend
        As in `clmorph.sinkhorn`; lengths are in image sides.

    Returns
    -------
    DensityPath

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> x = np.linspace(0, 1, 41)
    >>> left, right = (np.exp(-0.5 * ((x - c) / 0.05) ** 2)[None] for c in (0.3, 0.7))
    >>> path = clmorph.density_path(left, right, blur=0.01, backend="numpy")
    >>> middle = path.at(0.5)
    >>> int(middle.argmax()), round(float(middle.sum() / left.sum()), 6)  # a bump, in the middle
    (20, 1.0)
    """
    grids = check_density("source", source), check_density("target", target)
    pair = density(grids[0]), density(grids[1])
    operations = get_backend(backend)
    potentials = sinkhorn(*pair, blur, reach, tol, max_iter, operations)
    plan = transport_plan(*pair, potentials, backend=operations)
    return DensityPath(*grids, potentials, plan)
