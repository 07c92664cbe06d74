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
MEMORY = 12
#: Share of the remaining residual that is added, as in over-relaxation.
MIXING = 1.5
#: Regularization of the least-squares problem, relative to its diagonal.
RIDGE = 1e-10


class Anderson:
    """Remembers the last iterates and combines them."""

    def __init__(self) -> None:
        self._images: list[Array] = []
        self._residuals: list[Array] = []

    def forget(self) -> None:
        """Begin anew."""
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
        combined = image - coefficients @ images
        return combined + (MIXING - 1) * (residual - coefficients @ differences)
