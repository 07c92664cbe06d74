"""Anderson acceleration of a fixed-point iteration x <- G(x).

Source: Anderson, "Iterative procedures for nonlinear integral equations" (1965); Walker and
Ni, "Anderson acceleration for fixed-point iterations" (2011). Near its solution a Sinkhorn
iteration is self-adjoint in the inner product weighted by the marginal, so there this is a
Krylov method: it finds by itself what over-relaxation needs a well-chosen factor for, and
gets ahead of the best factor when few modes are slow.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Pairs (x, G(x)) remembered.
MEMORY = 16
#: Share of the remaining residual that is added, as in over-relaxation.
MIXING = 1.5
#: Longest extrapolation at first, in steps of the plain iteration, and how it grows where it
#: was too short, and shrinks where it was too long.
TRUST, GROWTH, SHRINKAGE = 32.0, 4.0, 0.25
#: Regularization of the least-squares problem, relative to its diagonal.
RIDGE = 1e-10


class Anderson:
    """Remembers the last iterates and combines them."""

    def __init__(self) -> None:
        self._images: list[Array] = []
        self._residuals: list[Array] = []
        self._trust, self._was_cut = TRUST, False

    def accepted(self) -> None:
        """Learn that the last extrapolation was good."""
        if self._was_cut:
            self._trust *= GROWTH

    def rejected(self) -> None:
        """Learn that it was not, and begin anew."""
        self._trust = max(1.0, SHRINKAGE * self._trust)
        self._images.clear()
        self._residuals.clear()

    def extrapolate(self, x: Array, image: Array, weights: Array) -> Array | None:
        """Remember x and G(x) and return a better next x than G(x).

        Parameters
        ----------
        x, image : (n,) arrays
        weights : (n,) array
            Of the inner product.

        Returns
        -------
        (n,) array or None
            None while there is nothing to combine.
        """
        self._images.append(image)
        self._residuals.append(image - x)
        if len(self._images) > MEMORY + 1:
            del self._images[0], self._residuals[0]
        if len(self._images) == 1:
            return None
        residual = self._residuals[-1]
        differences = np.stack([residual - old for old in self._residuals[:-1]])
        weighted = differences * weights
        normal = weighted @ differences.T
        scale = np.sqrt(np.diag(normal))
        if not np.all(scale > 0):
            return None
        normal = normal / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
        coefficients = np.linalg.solve(normal, (weighted @ residual) / scale) / scale
        images = np.stack([image - old for old in self._images[:-1]])
        step = (MIXING - 1) * (residual - coefficients @ differences) - coefficients @ images
        longest = self._trust * _norm(residual, weights)
        length = _norm(step, weights)
        self._was_cut = length > longest
        return image + (longest / length if self._was_cut else 1.0) * step


def _norm(x: Array, weights: Array) -> float:
    return float(np.sqrt(weights @ x**2))
