"""The soft minimum between two clouds, summed over the pairs with notable terms."""

from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.backends.records import NearPairs, ProgramError
from clmorph.backends.rounding import rounding_error
from clmorph.backends.speed import speed_factor
from clmorph.errors import InputError

#: Problems with at least this many pairs of points are solved through coarser problems, and with
#: truncated sums, unless the caller chooses otherwise.
MANY_PAIRS = 1 << 27
#: In more dimensions than this, near pairs and clusters save little: boxes bound distances badly,
#: and points have few neighbors. Such a problem is solved so only where the caller chooses it.
FEW_DIMENSIONS = 11
#: Near pairs are chosen for a share of the truncation, so that they remain valid while potentials
#: move. The constants are the first share, its largest factor after each move that was too far, and
#: the least share. A share below the factor is squared.
RESERVE, SCARCER, LEAST_RESERVE = 0.15, 1e-4, 1e-50
#: Once the residual is this small, potentials have little way left. Near pairs that are valid for
#: far moves are then chosen anew, once, for this share: half as many pairs are left.
SETTLED, SETTLED_RESERVE = 3e-2, 1e-6
#: Rounding may be this share of the truncation where its bound is computed.
ROUNDING_SHARE = 0.3
#: After this many successive choices that leave out too much, all pairs are summed.
ATTEMPTS = 3


def many_pairs(operations: Operations | None = None) -> int:
    """Return `MANY_PAIRS`, which are 8 or 64 times as many on a fast device."""
    if operations is None:
        return MANY_PAIRS
    return MANY_PAIRS * speed_factor(operations.on_processor, operations.pairs_per_second)


class Softmin:
    """The operator T: potentials of the columns to soft minima, one a row (paper, section 3.1).

    With a truncation, in nats, T sums only near pairs, which are chosen for one potential g and the
    share `reserve` of the truncation. At another potential h the share of the other pairs can have
    grown by at most exp(max(h - g) / epsilon), times the change of the row's own sum; where this
    bound exceeds the truncation pairs are chosen anew. Unless `proven`, nothing proves a choice.

    `left_out` bounds the nats by which the last sums are too small, and `roundoff` their rounding
    after a `bounded` softmin. `near` has their pairs, or None for all, and `guess` (N,) estimates
    the next softmin.
    """

    def __init__(
        self,
        operations: Operations,
        rows: Any,
        columns: Any,
        weights: tuple[Array, Array],
        truncation: float | None = None,
    ) -> None:
        self.operations, self.rows, self.columns = operations, rows, columns
        self.truncation = truncation
        self.weights = weights
        self._massive = weights[1] > 0
        self._pairs = len(weights[0]) * len(weights[1])
        self.n_columns: Any = len(weights[1])
        self.reserve = RESERVE
        self.proven, self._settled = True, False
        self._near: NearPairs | None = None
        self._chosen_for: tuple[float, Array] = (0.0, np.zeros(0))
        self.guess: Array | None = None
        self.near: NearPairs | None = None
        self.left_out: float = 0.0
        self.roundoff: Any = 0.0

    def __call__(
        self, potential: Array, epsilon: float, precise: bool = False, bounded: bool = False
    ) -> Array:
        """Return T(potential)_i = -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon) (paper, 3.1).

        `precise` exponents are better than float32; `bounded` computes `roundoff`.
        """
        if self.truncation is not None:
            try:
                return self._truncated(self.truncation, potential, epsilon, precise, bounded)
            except ProgramError as error:
                error.tell("softmins sum over all pairs of points, which takes longer")
                self.release()
        return self._over(None, potential, epsilon, precise, bounded)

    def _truncated(
        self, truncation: float, potential: Array, epsilon: float, precise: bool, bounded: bool
    ) -> Array:
        """Return T(potential), summed over near pairs if pairs left out can be bounded."""
        kind = precise, bounded
        # Pairs left out and rounding together are then within the truncation.
        share = 1.0 - ROUNDING_SHARE if bounded else 1.0
        if self._near is not None and self._chosen_for[0] == epsilon:
            softmin = self._over(self._near, potential, epsilon, *kind)
            self.left_out = self._bound(potential, softmin, epsilon)
            if self.left_out <= share * truncation:
                return softmin
            self.reserve = max(LEAST_RESERVE, min(SCARCER, self.reserve) * self.reserve)
        if self.guess is None:
            self.guess = self._over(None, potential, epsilon, False, False)
        for _ in range(ATTEMPTS):
            near = self._choose(potential, epsilon, share)
            if near is not None:
                softmin, self.roundoff = near.softmin, 0.0
                if precise or bounded:
                    softmin = self._over(near, potential, epsilon, *kind)
                self.near, self.left_out = near, self._bound(potential, softmin, epsilon)
                return softmin
        # The pairs left out cannot be bounded, so all pairs are summed.
        self._near, self.left_out = None, 0.0
        return self._over(None, potential, epsilon, *kind)

    def take_over(self, near: NearPairs, potential: Array, softmin: Array, epsilon: float) -> None:
        """Take over pairs that another softmin has summed at this potential, with their result."""
        self._keep(near, potential, epsilon)
        self.near, self.guess = near, softmin

    def _keep(self, near: NearPairs, potential: Array, epsilon: float) -> None:
        """Keep pairs, and what bounds those that they leave out."""
        self._near, self._chosen_for = near, (epsilon, potential)
        with np.errstate(divide="ignore"):
            self._log_skipped = np.log(near.skipped)

    def settle(self, residual: float) -> None:
        """Choose pairs anew, once, if they are for far moves and the residual is small."""
        far = self._near is not None and self.reserve < SETTLED_RESERVE
        if far and residual <= SETTLED and not self._settled:
            self.reserve, self._near, self._settled = SETTLED_RESERVE, None, True

    def release(self) -> None:
        """Sum over all pairs from now on."""
        self.truncation = self._near = None

    def _choose(self, potential: Array, epsilon: float, share: float) -> NearPairs | None:
        """Choose pairs; None if they leave out more than this share, after a bad guess."""
        assert self.guess is not None
        assert self.truncation is not None
        near = self.operations.near_pairs(
            self.rows, self.columns, potential, self.guess, epsilon, self.reserve * self.truncation
        )
        check_finite(near.softmin)
        self.guess = near.softmin
        if self.proven and float(near.skipped.max()) > share * self.truncation:
            return None
        self._keep(near, potential, epsilon)
        return near

    def _over(
        self, near: NearPairs | None, potential: Array, epsilon: float, precise: bool, bounded: bool
    ) -> Array:
        arguments = self.rows, self.columns, potential, epsilon
        self.roundoff = 0.0
        if bounded:
            enough = 0.0 if self.truncation is None else ROUNDING_SHARE * self.truncation
            softmin, self.roundoff = self.operations.bounded_softmin(*arguments, near, enough)
        else:
            softmin = self.operations.softmin(*arguments, precise, near)
        self.near, self.guess, self.left_out = near, self.checked(softmin), 0.0
        return softmin

    def checked(self, softmin: Array) -> Array:
        """Return a softmin if it is finite."""
        return check_finite(softmin)

    @property
    def visited(self) -> float:
        """Share of all pairs that the last softmin summed."""
        return 1.0 if self.near is None else min(1.0, self.near.n_pairs / self._pairs)

    def _bound(self, potential: Array, softmin: Array, epsilon: float) -> float:
        """Return a bound of the nats by which sums over the chosen pairs are too small now."""
        assert self._near is not None
        grown = float((potential - self._chosen_for[1])[self._massive].max())
        logarithms = self._log_skipped + (grown + softmin - self._near.softmin) / epsilon
        return float(np.exp(np.minimum(logarithms.max(), 700.0)))

    def rounding(
        self, largest_cost: Any, epsilon: float, precise: bool, exact: bool = False
    ) -> Any:
        """Return the largest effect of rounding on a softmin, in nats; see `rounding_error`."""
        n_columns = self.n_columns
        if self._near is not None and self._chosen_for[0] == epsilon:
            n_columns = self._near.n_columns
            largest_cost = min(largest_cost, self._near.largest)
        return rounding_error(self.operations, n_columns, largest_cost / epsilon, precise, exact)


def check_finite(softmin: Array) -> Array:
    """Return a softmin if it is finite; values in the range of float64 can overflow in float32."""
    if np.all(np.isfinite(softmin)):
        return softmin
    raise overflow("points")


def overflow(name: str) -> InputError:
    """Return the error for points, which `name` names, that are too far apart for float32."""
    return InputError(
        f"{name} are too far apart for this blur on this device, whose float32 overflows: raise "
        "blur, scale the points, or use backend='numpy'"
    )
