"""Anderson acceleration of a fixed-point iteration x <- G(x).

Sources: Anderson, "Iterative procedures for nonlinear integral equations" (1965); Walker and Ni,
"Anderson acceleration for fixed-point iterations" (2011). Near its solution a Sinkhorn iteration is
self-adjoint in the inner product weighted by the marginal, so there this is a Krylov method.
"""

from typing import Any

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import MEMORY, MIXING, RIDGE
from clmorph.transport._solver.reductions import WHOLE, Reductions

#: Initial radius of the trust region, in steps of the plain iteration; its growth factor after a
#: good extrapolation that the radius had limited, and its factor after a bad extrapolation.
TRUST_RADIUS, GROWTH, SHRINKAGE = 32.0, 4.0, 0.25
#: The least length of a step, which only keeps the quotient by it finite.
TINY = float(np.finfo(float).tiny)


class TrustRegion:
    """How far extrapolations may go: for each problem a radius in steps of the plain iteration."""

    def __init__(self, shape: tuple[int, ...] = ()) -> None:
        self.radius: Any = np.full(shape, TRUST_RADIUS)
        #: Whether it limited the last extrapolation.
        self.was_cut: Any = np.zeros(shape, bool)

    def accepted(self, which: Any = True) -> None:
        """Enlarge the region if it limited the last extrapolation, which was good."""
        grown = which & self.was_cut
        if np.any(grown):
            self.radius = np.where(grown, GROWTH * self.radius, self.radius)

    def rejected(self, which: Any = True) -> None:
        """Shrink the region after a bad extrapolation."""
        shrunk = np.maximum(1.0, SHRINKAGE * self.radius)
        self.radius = np.where(which, shrunk, self.radius)

    def take(self, problems: IntArray) -> None:
        """Go on with some of the problems."""
        self.radius, self.was_cut = self.radius[problems], self.was_cut[problems]


class Anderson:
    """Anderson acceleration, of one problem or of many, whose truth values are arrays, (B,)."""

    def __init__(self, of: Reductions = WHOLE) -> None:
        self._of = of
        self._region = TrustRegion(of.shape)
        self._begin()

    def _begin(self) -> None:
        #: Whether the last iterate is stored.
        self._begun: Any = np.zeros(self._of.shape, bool)
        self._weights: Array | None = None
        self._image: Array | None = None
        self._residual: Array | None = None
        # Differences between successive iterates: those of the images plus the mixed share of the
        # residuals, those of the residuals, and the inner products of the latter. The oldest ones
        # are overwritten. A problem has not stored all of them since it began anew.
        self._ahead = self._residuals = np.zeros((0, 0))
        self._next = 0
        self._products = np.zeros((*self._of.shape, MEMORY, MEMORY))
        self._stored = np.zeros((*self._of.shape, MEMORY), bool)

    def accepted(self, which: Any = True) -> None:
        """Enlarge the trust region if it limited the last extrapolation, which was good."""
        self._region.accepted(which)

    def rejected(self, which: Any = True) -> None:
        """Shrink the trust region after a bad extrapolation, and forget all iterates."""
        self._region.rejected(which)
        if np.all(which):
            self._begin()
            return
        self._begun = self._begun & ~which
        self._stored[which] = False

    def take(self, problems: IntArray, points: Any, of: Reductions) -> None:
        """Go on with some of the problems, which have these points and reductions."""
        self._of = of
        self._region.take(problems)
        self._begun, self._stored = self._begun[problems], self._stored[problems]
        self._products = self._products[problems]
        count = min(self._next, MEMORY)
        before = self._ahead, self._residuals
        if count:
            self._ahead, self._residuals = (np.empty((MEMORY, len(points))) for _ in range(2))
            for kept, each in zip((self._ahead, self._residuals), before, strict=True):
                kept[:count] = each[:count, points]
        if self._image is not None and self._residual is not None and self._weights is not None:
            self._image, self._residual = self._image[points], self._residual[points]
            self._weights = self._weights[points]

    def extrapolate(
        self, x: Array, image: Array, weights: Array, which: Any = True
    ) -> tuple[Array, Any]:
        """Store the iterate x, (n,), with its image G(x), and return the next one and if it is new.

        It is the image until a problem has two iterates. The weights of a problem's first
        iterate define its inner product. Problems that `which` leaves out begin anew with
        their next iterate.
        """
        of, residual = self._of, image - x
        begun, which = self._begun, np.broadcast_to(which, of.shape)
        self._begun = which
        if self._image is None or self._residual is None or self._weights is None:
            self._image, self._residual, self._weights = image, residual, weights
            return image, np.zeros(of.shape, bool)
        if not np.all(begun):
            self._weights = np.where(of.spread(begun), self._weights, weights)
        weights = self._weights
        self._remember(image - self._image, residual - self._residual, weights, begun & which)
        self._image, self._residual = image, residual
        coefficients, found = self._coefficients(residual, weights)
        found = found & which
        if not np.any(found):
            return image, found
        correction = of.combined(coefficients, self._ahead[: coefficients.shape[-1]])
        step = (MIXING - 1) * residual - correction
        plain, length = (np.sqrt(of.inner(x * weights, x)) for x in (residual, step))
        longest = self._region.radius * plain
        self._region.was_cut = found & (length > longest)
        factor = np.minimum(1.0, longest / np.maximum(length, TINY))
        return image + of.scaled(found * factor, step), found

    def _coefficients(self, residual: Array, weights: Array) -> tuple[Array, Any]:
        """Return the coefficients of the stored differences, and whether they are determined."""
        count = min(self._next, MEMORY)
        right = self._of.inner_each(self._residuals[:count], weights * residual)
        stored = self._stored[..., :count]
        products = self._products[..., :count, :count]
        squares = np.diagonal(products, axis1=-2, axis2=-1)
        positive = stored & (squares > 0)
        found = (positive == stored).all(axis=-1) & stored.any(axis=-1)
        scale = np.sqrt(np.where(positive, squares, 1.0))
        normal = products / (scale[..., :, None] * scale[..., None, :])
        # Products with what is not stored are 0, so such coefficients are 0.
        normal += (1 + RIDGE - normal) * np.eye(count)
        right = stored * right / scale
        return np.linalg.solve(normal, right[..., None])[..., 0] / scale, found

    def _remember(self, of_image: Array, of_residual: Array, weights: Array, stored: Any) -> None:
        place, self._next = self._next % MEMORY, self._next + 1
        if place == 0 and not self._residuals.size:
            self._ahead, self._residuals = (np.empty((MEMORY, len(of_image))) for _ in range(2))
        self._ahead[place] = of_image + (MIXING - 1) * of_residual
        self._residuals[place] = of_residual
        self._stored[..., place] = stored
        count = min(self._next, MEMORY)
        row = self._of.inner_each(self._residuals[:count], of_residual * weights)
        row *= self._stored[..., :count] & np.asarray(stored)[..., None]
        self._products[..., place, :count] = self._products[..., :count, place] = row
