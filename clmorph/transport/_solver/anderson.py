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


class Ring:
    """What each problem has stored of its iterates, and how far its extrapolations may go."""

    def __init__(self, of: Any) -> None:
        self._of: Any = of
        #: Radius of the trust region, in steps of the plain iteration.
        self.radius: Any = of.filled(TRUST_RADIUS)
        #: Whether it limited the last extrapolation.
        self.was_cut: Any = of.filled(False)
        #: Whether the last iterate is stored, and the differences stored since a problem began.
        self.begun: Any = of.filled(False)
        self.stored: Any = of.filled(0)

    def accepted(self, which: Any = True) -> None:
        """Enlarge the trust region if it limited the last extrapolation, which was good."""
        grown = which & self.was_cut
        if self._of.any(grown):
            self.radius = self._of.choose(grown, GROWTH * self.radius, self.radius)

    def rejected(self, which: Any = True) -> None:
        """Shrink the trust region after a bad extrapolation, and forget all iterates."""
        of = self._of
        self.radius = of.choose(which, of.larger(1.0, SHRINKAGE * self.radius), self.radius)
        self.begun, self.stored = of.without(self.begun, which), of.choose(which, 0, self.stored)

    def add(self, which: Any) -> None:
        """Store an iterate of some problems, and its difference from the one before, if any."""
        self.stored = self.stored + (which & self.begun)
        self.begun = self.begun | which

    def take(self, problems: IntArray, of: Reductions) -> None:
        """Go on with some of the problems, which have these reductions."""
        self._of, self.radius, self.was_cut = of, self.radius[problems], self.was_cut[problems]
        self.begun, self.stored = self.begun[problems], self.stored[problems]


class Anderson:
    """Anderson acceleration, of one problem or of many, whose truth values are arrays, (B,)."""

    def __init__(self, of: Reductions = WHOLE) -> None:
        self._of, self.ring = of, Ring(of)
        #: The last image and residual, and the weights of the inner product.
        self._last: tuple[Array, Array, Array] | None = None
        # Differences between successive iterates: those of the images plus the mixed share of the
        # residuals, those of the residuals, and the inner products of the latter. The oldest ones
        # are overwritten.
        self._ahead = self._residuals = np.zeros((MEMORY, 0))
        self._products = np.zeros((*of.shape, MEMORY, MEMORY))

    def rejected(self, which: Any = True) -> None:
        """Forget all iterates after a bad extrapolation."""
        self.ring.rejected(which)
        self._products = np.where(np.asarray(which)[..., None, None], 0.0, self._products)

    def take(self, problems: IntArray, points: Any, of: Reductions) -> None:
        """Go on with some of the problems, which have these points and reductions."""
        self._of = of
        self.ring.take(problems, of)
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
        of, ring, residual = self._of, self.ring, image - x
        begun, place = ring.begun, np.asarray(ring.stored % MEMORY)
        ring.add(which)
        if self._last is not None and np.any(begun):
            last_image, last_residual, first = self._last
            weights = first if np.all(begun) else np.where(of.spread(begun), first, weights)
            changes = image - last_image, residual - last_residual
            self._remember(*changes, weights, place, np.broadcast_to(begun & which, of.shape))
        self._last = image, residual, weights
        coefficients, found = self._coefficients(residual, weights)
        found = found & which
        if not np.any(found):
            return image, found
        correction = of.combined(coefficients, self._ahead[: coefficients.shape[-1]])
        step = (MIXING - 1) * residual - correction
        plain, length = (np.sqrt(of.inner(x * weights, x)) for x in (residual, step))
        longest = ring.radius * plain
        ring.was_cut = found & (length > longest)
        factor = np.minimum(1.0, longest / np.maximum(length, TINY))
        return image + of.spread(found * factor) * step, found

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

    def _remember(
        self, of_image: Array, of_residual: Array, weights: Array, place: Any, new: Any
    ) -> None:
        of = self._of
        if not self._ahead.size:
            self._ahead, self._residuals = (np.zeros((MEMORY, len(of_image))) for _ in range(2))
        points = np.flatnonzero(of.spread(new))
        at: Any = (of.spread(place)[points], points) if of.shape else int(place)
        for kept, each in (
            (self._ahead, of_image + (MIXING - 1) * of_residual), (self._residuals, of_residual),
        ):  # fmt: skip
            kept[at] = each[points] if of.shape else each
        count, stored = self._stored()
        row = np.zeros(stored.shape)
        row[..., :count] = of.inner_each(self._residuals[:count], of_residual * weights)
        row, here = row * stored, (np.arange(MEMORY) == place[..., None]) & new[..., None]
        self._products = np.where(here[..., None], row[..., None, :], self._products)
        self._products = np.where(here[..., None, :], row[..., None], self._products)

    def _stored(self) -> tuple[int, Any]:
        """Return the largest number of differences of a problem, and which ones each has."""
        count = np.minimum(self.ring.stored, MEMORY)
        return int(count.max(initial=0)), np.arange(MEMORY) < count[..., None]
