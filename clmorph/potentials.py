"""What a transport solver returns."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.problem import Certificate
from clmorph.strengths import Reach

Array = NDArray[np.float64]

#: How a solve can end, and what that means.
STATUSES = {
    "converged": "the residual is at most the tolerance",
    "max_iter": "the iterations ran out first",
    "precision": "the residual is at the device's rounding, above the tolerance",
    "schedule": "a fixed schedule ended, whatever the residual",
}


@dataclass(frozen=True, repr=False, eq=False)
class Potentials:
    """Dual potentials of the raw (not debiased) entropic problem, with their certificate.

    Attributes
    ----------
    f, g : (N,) and (M,) arrays
        Cost units (the points' unit squared).
    blur : float
        epsilon = blur^2, points' unit.
    reach : float, None, or a pair of them
        rho = reach^2, points' unit; None is balanced. A pair (source, target) if they differ.
    status : {"converged", "max_iter", "precision", "schedule"}
        See `STATUSES`.
    message : str
        What happened, and what to do about it.
    n_iter : int
        Iterations, annealing included; one is both updates. Updates that were taken back
        count too.
    residual : float
        max(|f - Delta T(g)|, |g - Delta T(f)|) / epsilon over points of positive mass,
        for these very potentials.
    residuals : (k,) array
        The residual after each iteration that was kept, each in units of its own level's
        epsilon: while the blur is annealed they start high at every level.
    certificate : Certificate
        Bounds and marginals that follow from these potentials.
    precise : bool
        Whether the last iterations needed more than float32 exponents.
    truncation : float or None
        What pairs could be left out for, see `clmorph.sinkhorn`; None: nothing was.
    truncation_error : float
        By how many nats the logarithms of the last row and column sums can be too small for what
        was left out: a proven bound. It is part of `residual`, `primal` and `dual`; `row_mass`,
        `column_mass` and `transported_mass` can be too small by this share.
    visited : float
        Share of all pairs of points that the last softmins summed.
    """

    f: Array
    g: Array
    blur: float
    reach: Reach
    status: str
    message: str
    n_iter: int
    residual: float
    residuals: Array
    certificate: Certificate
    precise: bool = False
    truncation: float | None = None
    truncation_error: float = 0.0
    visited: float = 1.0

    def __repr__(self) -> str:
        return f"<Potentials for {len(self.f)} and {len(self.g)} points, {self.message}>"

    @property
    def converged(self) -> bool:
        """Whether the residual is at most the tolerance."""
        return self.status == "converged"

    @property
    def epsilon(self) -> float:
        """Entropic strength, in cost units."""
        return self.blur**2

    @cached_property
    def rho(self) -> Any:
        """Marginal strength, in cost units, infinite if balanced; a pair if reach is one."""
        if isinstance(self.reach, tuple):
            return tuple(np.inf if reach is None else reach**2 for reach in self.reach)
        return np.inf if self.reach is None else self.reach**2

    def swapped(self) -> "Potentials":
        """Return the same seen from the target."""
        reach = self.reach[::-1] if isinstance(self.reach, tuple) else self.reach
        certificate = self.certificate._replace(
            row_mass=self.column_mass, column_mass=self.row_mass
        )
        return replace(self, f=self.g, g=self.f, reach=reach, certificate=certificate)

    @property
    def primal(self) -> float:
        """<C, pi> + rho KL(pi 1|a) + rho KL(pi^T 1|b) + epsilon KL(pi|a x b), of the plan.

        Without the KL of a balanced side: see `marginal_error` there.
        """
        return self.certificate.primal

    @property
    def dual(self) -> float:
        """Dual value D(f, g): a lower bound of the optimum, up to rounding."""
        return self.certificate.dual

    @property
    def gap(self) -> float | None:
        """Primal - dual, how far from the optimum these potentials can be; None if balanced."""
        return self.certificate.gap

    @property
    def marginal_error(self) -> float:
        """Sum over the balanced sides of |pi 1 - a|_1; 0 without any."""
        return self.certificate.marginal_error

    @property
    def transported_mass(self) -> float:
        """Mass of the plan."""
        return self.certificate.transported_mass

    @property
    def row_mass(self) -> Array:
        """(N,) first marginal of the plan: mass that leaves each source point."""
        return self.certificate.row_mass

    @property
    def column_mass(self) -> Array:
        """(M,) second marginal of the plan: mass that arrives at each target point."""
        return self.certificate.column_mass
