"""The result `Barycenter`: weighted points, and how far the iteration has come."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.errors import InputError
from clmorph.measures.grid import Grid
from clmorph.measures.points import AnyMeasure, WeightedPoints
from clmorph.transport.regularization import Goal

#: Share of the mean mass of the measures below which the mass of the support is lost.
LOST = 1e-20


class Call(NamedTuple):
    """The checked options of a call."""

    goal: Goal
    fixed: bool
    debias: bool
    seed: int


class BarycenterProblem(NamedTuple):
    """Measures with positive shares, these shares, and the support with which to begin."""

    measures: list[AnyMeasure]
    shares: list[float]
    start: WeightedPoints | Grid


@dataclass(frozen=True, repr=False, eq=False)
class Barycenter(WeightedPoints):
    """The barycenter of some measures, which is a measure itself.

    Attributes
    ----------
    points : (N, D) array
        Points of the support, in the unit of the measures.
    weights : (N,) array
        Their masses.
    offsets : None
    status : {"converged", "max_iter", "precision"}
        "precision": the points rest, but a transport problem could not be solved as exactly as
        `tol` asks for.
    n_iter : int
        Number of iterations.
    residual : float
        The residual of the last iteration. With a free support it is the root mean square of the
        step of the points in units of blur, the change of the masses relative to the whole mass, or
        the residual of a transport problem, whichever is largest. With a fixed one it is the
        largest error of a marginal, or the change of the masses, relative to the whole mass.
    residuals : (n_iter,) array
        The residual of each iteration.
    grid : Grid or None
        The barycenter as a grid, if it is one of grids on the cells of a grid.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> measures = [(np.ones(1), np.array([[x]])) for x in (0.0, 1.0)]
    >>> found = clmorph.barycenter(measures, [0.25, 0.75], backend="numpy")
    >>> found
    <Barycenter of 1 points in 1D, mass 1, converged in 1 iteration>
    >>> found.points.round(6).tolist()
    [[0.75]]
    """

    status: str = "converged"
    n_iter: int = 0
    residual: float = 0.0
    residuals: Array = field(default_factory=lambda: np.zeros(0))
    grid: Grid | None = None

    def __repr__(self) -> str:
        state = "converged" if self.converged else "not converged"
        return (
            f"<Barycenter of {len(self)} points in {self.points.shape[1]}D, mass {self.mass:g}, "
            f"{state} in {self.n_iter} iteration{'s' * (self.n_iter != 1)}>"
        )

    @property
    def converged(self) -> bool:
        """Whether the residual has reached the tolerance."""
        return self.status == "converged"


def check_mass(weights: Array, mass: float) -> None:
    """Raise InputError if the support has lost the mass of the measures, which is `mass`."""
    if weights.sum() < LOST * mass:
        raise InputError(
            "support: no mass travels between it and the measures; begin with points nearer to "
            "them, or raise the reach"
        )
