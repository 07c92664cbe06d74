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

    def __init__(self, of: Any) -> None:
        self._of: Any = of
        self.radius: Any = of.filled(TRUST_RADIUS)
        #: Whether it limited the last extrapolation.
        self.was_cut: Any = of.filled(False)

    def accepted(self, which: Any = True) -> None:
        """Enlarge the region if it limited the last extrapolation, which was good."""
        grown = which & self.was_cut
        if self._of.any(grown):
            self.radius = self._of.choose(grown, GROWTH * self.radius, self.radius)

    def rejected(self, which: Any = True) -> None:
        """Shrink the region after a bad extrapolation."""
        shrunk = self._of.larger(1.0, SHRINKAGE * self.radius)
        self.radius = self._of.choose(which, shrunk, self.radius)

    def take(self, problems: IntArray) -> None:
        """Go on with some of the problems."""
        self.radius, self.was_cut = self.radius[problems], self.was_cut[problems]


class Anderson:
    """Anderson acceleration, of one problem or of many, whose truth values are arrays, (B,)."""

    def __init__(self, of: Reductions = WHOLE) -> None:
        self._of, self._region = of, TrustRegion(of)
        #: Whether the last iterate is stored, and the differences stored since a problem began.
        self._begun, self._next = np.zeros(of.shape, bool), np.zeros(of.shape, int)
        #: The last image and residual, and the weights of the inner product.
        self._last: tuple[Array, Array, Array] | None = None
        # Differences between successive iterates: those of the images plus the mixed share of the
        # residuals, those of the residuals, and the inner products of the latter. The oldest ones
        # are overwritten.
        self._ahead = self._residuals = np.zeros((MEMORY, 0))
        self._products = np.zeros((*of.shape, MEMORY, MEMORY))

    def accepted(self, which: Any = True) -> None:
        """Enlarge the trust region if it limited the last extrapolation, which was good."""
        self._region.accepted(which)

    def rejected(self, which: Any = True) -> None:
        """Shrink the trust region after a bad extrapolation, and forget all iterates."""
        self._region.rejected(which)
        self._begun = self._begun & np.logical_not(which)
        self._next = np.where(which, 0, self._next)
        self._products = np.where(np.asarray(which)[..., None, None], 0.0, self._products)

    def take(self, problems: IntArray, points: Any, of: Reductions) -> None:
        """Go on with some of the problems, which have these points and reductions."""
        self._of = of
        self._region.take(problems)
        self._begun, self._next = self._begun[problems], self._next[problems]
        self._products = self._products[problems]
        if self._last is not None:
            image, residual, weights = self._last
            self._last = image[points], residual[points], weights[points]
        if self._ahead.size:
            # `take` keeps vectors contiguous, on which the rounding of sums depends.
            self._ahead, self._residuals = (
                each.take(points, axis=1) for each in (self._ahead, self._residuals)
            )

    def extrapolate(
        self, x: Array, image: Array, weights: Array, which: Any = True
    ) -> tuple[Array, Any]:
        """Store the iterate x, (n,), with its image G(x), and return the next one and if it is new.

        The weights of a problem's first iterate define its inner product. Problems that `which`
        leaves out begin anew with their next iterate.
        """
        of, residual = self._of, image - x
        begun, which = self._begun, np.broadcast_to(which, of.shape)
        self._begun = which
        if self._last is not None and np.any(begun):
            last_image, last_residual, first = self._last
            weights = first if np.all(begun) else np.where(of.spread(begun), first, weights)
            self._remember(image - last_image, residual - last_residual, weights, begun & which)
        self._last = image, residual, weights
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
        count, stored = self._stored()
        if not count:
            return np.zeros((*self._of.shape, 0)), np.zeros(self._of.shape, bool)
        right = np.zeros(stored.shape)
        right[..., :count] = self._of.inner_each(self._residuals[:count], weights * residual)
        squares = np.diagonal(self._products, axis1=-2, axis2=-1)
        positive = stored & (squares > 0)
        found = (positive == stored).all(axis=-1) & stored.any(axis=-1)
        scale = np.sqrt(np.where(positive, squares, 1.0))
        normal = self._products / (scale[..., :, None] * scale[..., None, :])
        # Products with what is not stored are 0, so such coefficients are 0. The system has one
        # size, because LAPACK's rounding depends on it, and problems together are as alone.
        normal += (1 + RIDGE - normal) * np.eye(MEMORY)
        right = stored * right / scale
        return (np.linalg.solve(normal, right[..., None])[..., 0] / scale)[..., :count], found

    def _remember(self, of_image: Array, of_residual: Array, weights: Array, new: Any) -> None:
        of, place = self._of, self._next % MEMORY
        self._next = self._next + new
        if not self._ahead.size:
            self._ahead, self._residuals = (np.zeros((MEMORY, len(of_image))) for _ in range(2))
        at: Any = int(place) if not of.shape else self._places(place, new)
        for kept, each in (
            (self._ahead, of_image + (MIXING - 1) * of_residual), (self._residuals, of_residual),
        ):  # fmt: skip
            kept[at] = each[at[1]] if of.shape else each
        count, stored = self._stored()
        row = np.zeros(stored.shape)
        row[..., :count] = of.inner_each(self._residuals[:count], of_residual * weights)
        row, here = (
            row * stored,
            (np.arange(MEMORY) == place[..., None]) & np.asarray(new)[..., None],
        )
        self._products = np.where(here[..., None], row[..., None, :], self._products)
        self._products = np.where(here[..., None, :], row[..., None], self._products)

    def _places(self, place: Any, new: Any) -> tuple[IntArray, IntArray]:
        """Return where many problems store a vector: rows, and the points of those that do."""
        points = np.flatnonzero(self._of.spread(new))
        return self._of.spread(place)[points], points

    def _stored(self) -> tuple[int, Any]:
        """Return the largest number of differences of a problem, and which ones each has."""
        count = np.minimum(self._next, MEMORY)
        return int(count.max(initial=0)), np.arange(MEMORY) < count[..., None]
