"""Anderson acceleration of a fixed-point iteration x <- G(x).

Source: Anderson, "Iterative procedures for nonlinear integral equations" (1965); Walker and
Ni, "Anderson acceleration for fixed-point iterations" (2011). Near its solution a Sinkhorn
iteration is self-adjoint in the inner product weighted by the marginal, so there this is a
Krylov method. It needs no factor to be chosen, as over-relaxation does, and it is faster than the
best factor where only a few modes are slow.
"""

import numpy as np

from clmorph._shared.typing import Array
from clmorph.transport._solver.problem import inner

#: Number of stored iterates.
MEMORY = 16
#: Share of the remaining residual that is added, as in over-relaxation.
MIXING = 1.5
#: Initial radius of the trust region, in steps of the plain iteration; its growth factor after a
#: good extrapolation that the radius had limited, and its factor after a bad extrapolation.
TRUST_RADIUS, GROWTH, SHRINKAGE = 32.0, 4.0, 0.25
#: Regularization of the least-squares problem, relative to its diagonal.
RIDGE = 1e-10


class Anderson:
    """Anderson acceleration, which stores the last iterates and combines them."""

    def __init__(self) -> None:
        self._trust_radius, self._was_cut = TRUST_RADIUS, False
        self._begin()

    def _begin(self) -> None:
        self._weights: Array | None = None
        self._image: Array | None = None
        self._residual: Array | None = None
        # Differences between successive iterates: those of the images plus the mixed share of the
        # residuals, those of the residuals, and the inner products of the latter.
        self._ahead: list[Array] = []
        self._residuals: list[Array] = []
        self._products = np.zeros((0, 0))

    def accepted(self) -> None:
        """Enlarge the trust region if it limited the last extrapolation, which was good."""
        if self._was_cut:
            self._trust_radius *= GROWTH

    def rejected(self) -> None:
        """Shrink the trust region after a bad extrapolation, and forget all iterates."""
        self._trust_radius = max(1.0, SHRINKAGE * self._trust_radius)
        self._begin()

    def extrapolate(self, x: Array, image: Array, weights: Array) -> Array | None:
        """Store x and G(x) and return a better next iterate than G(x).

        Parameters
        ----------
        x, image : (n,) arrays
        weights : (n,) array
            Weights of the inner product; only those of the first iterate are used.

        Returns
        -------
        (n,) array or None
            The next iterate; None until two iterates are stored.
        """
        residual = image - x
        if self._image is None or self._residual is None or self._weights is None:
            self._image, self._residual, self._weights = image, residual, weights
            return None
        weights = self._weights
        self._remember(image - self._image, residual - self._residual, weights)
        self._image, self._residual = image, residual
        scale = np.sqrt(np.diag(self._products))
        if not np.all(scale > 0):
            return None
        right = np.array([inner(d, weights * residual) for d in self._residuals])
        normal = self._products / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
        coefficients = np.linalg.solve(normal, right / scale) / scale
        step = (MIXING - 1) * residual
        for c, ahead in zip(coefficients, self._ahead, strict=True):
            step -= c * ahead
        longest = self._trust_radius * _norm(residual, weights)
        length = _norm(step, weights)
        self._was_cut = length > longest
        return image + (longest / length if self._was_cut else 1.0) * step

    def _remember(self, of_image: Array, of_residual: Array, weights: Array) -> None:
        self._ahead.append(of_image + (MIXING - 1) * of_residual)
        self._residuals.append(of_residual)
        weighted = of_residual * weights
        row = np.array([inner(weighted, other) for other in self._residuals])
        size = len(row)
        products = np.empty((size, size))
        products[:-1, :-1] = self._products
        products[-1], products[:, -1] = row, row
        if size > MEMORY:
            del self._ahead[0], self._residuals[0]
            products = products[1:, 1:]
        self._products = products


def _norm(x: Array, weights: Array) -> float:
    return float(np.sqrt(inner(x * weights, x)))
