"""The soft minimum between two clouds, over the pairs that matter."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.records import NearPairs
from clmorph.backends.rounding import rounding_error
from clmorph.errors import InputError

Array = NDArray[np.float64]

#: Pairs are chosen for less than the truncation, so that they serve while potentials move: at
#: first for this share, for less each time that they moved too far, and at last for this little.
RESERVE, SCARCER, LEAST_RESERVE = 3e-2, 1e-4, 1e-24
#: Choices in a row after which nothing is left out instead.
ATTEMPTS = 3


class Softmin:
    """T: potentials of the columns to soft minima over the rows (paper, section 3.1).

    With a truncation it is summed over near pairs only (`Operations.near_pairs`). These are
    chosen for one potential g; at another one, h, the share of the rest can have grown by no
    more than exp(max(h - g) / epsilon), times what the row's own sum has changed by. Only where
    this bound exceeds the truncation they are chosen anew.

    Parameters
    ----------
    operations : Operations
    rows, columns
        Its clouds.
    weights : (N,), (M,)
        Of both clouds.
    truncation : float, optional
        By how many nats a log-sum-exp may be too small; all pairs are summed if None.

    Attributes
    ----------
    truncation : float or None
    guess : (N,) array or None
        About what the next softmin will be; the last one unless set.
    left_out : float
        By how many nats the logarithms of the last softmin's sums can be too small for what it
        left out: a bound.
    roundoff : float
        By how many nats they can be off for rounding: a bound if it was a `bounded` softmin, else
        unknown and 0.
    near : NearPairs or None
        What the last one summed; None: all pairs.
    proven : bool
        Whether what is left out must be within the truncation, or just ought to.
    reserve : float
        Pairs are chosen for this share of the truncation; the less, the longer they serve.
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
        self.reserve = RESERVE
        self.proven = True
        self._near: NearPairs | None = None
        self._chosen_for: tuple[float, Array] = (0.0, np.zeros(0))
        self.guess: Array | None = None
        self.near: NearPairs | None = None
        self.left_out = self.roundoff = 0.0

    def __call__(
        self, potential: Array, epsilon: float, precise: bool = False, bounded: bool = False
    ) -> Array:
        """Return T(potential), (N,) for (M,).

        Parameters
        ----------
        potential : (M,) array, cost units
        epsilon : float, cost units
        precise : bool
            Form exponents in more than float32.
        bounded : bool
            Let no rounding go without a bound: `roundoff`.
        """
        kind = precise, bounded
        if self.truncation is None:
            return self._over(None, potential, epsilon, *kind)
        if self._near is not None and self._chosen_for[0] == epsilon:
            softmin = self._over(self._near, potential, epsilon, *kind)
            self.left_out = self._bound(potential, softmin, epsilon)
            if self.left_out <= self.truncation:
                return softmin
            self.reserve = max(LEAST_RESERVE, SCARCER * self.reserve)
        if self.guess is None:
            self.guess = self._over(None, potential, epsilon, False, False)
        for _ in range(ATTEMPTS):
            near = self._choose(potential, epsilon)
            if near is not None:
                softmin, self.roundoff = near.softmin, 0.0
                if precise or bounded:
                    softmin = self._over(near, potential, epsilon, *kind)
                self.near, self.left_out = near, self._bound(potential, softmin, epsilon)
                return softmin
        # What is left out cannot be bounded: leave out nothing.
        self._near, self.left_out = None, 0.0
        return self._over(None, potential, epsilon, *kind)

    def release(self) -> None:
        """Sum over all pairs from now on."""
        self.truncation = self._near = None

    def _choose(self, potential: Array, epsilon: float) -> NearPairs | None:
        """Choose pairs; None if they leave out too much, as after a bad guess."""
        assert self.guess is not None
        assert self.truncation is not None
        near = self.operations.near_pairs(
            self.rows,
            self.columns,
            potential,
            self.guess,
            epsilon,
            self.reserve * self.truncation,
        )
        _finite(near.softmin)
        self.guess = near.softmin
        if self.proven and float(near.skipped.max()) > self.truncation:
            return None
        self._near, self._chosen_for = near, (epsilon, potential)
        return near

    def _over(
        self, near: NearPairs | None, potential: Array, epsilon: float, precise: bool, bounded: bool
    ) -> Array:
        arguments = self.rows, self.columns, potential, epsilon
        self.roundoff = 0.0
        if bounded:
            softmin, self.roundoff = self.operations.bounded_softmin(*arguments, near)
        elif near is None:
            softmin = self.operations.softmin(*arguments, precise)
        else:
            softmin = self.operations.softmin(*arguments, precise, near)
        self.near, self.guess, self.left_out = near, _finite(softmin), 0.0
        return softmin

    @property
    def visited(self) -> float:
        """Share of all pairs that the last softmin summed."""
        return 1.0 if self.near is None else min(1.0, self.near.n_pairs / self._pairs)

    def _bound(self, potential: Array, softmin: Array, epsilon: float) -> float:
        """Return by how many nats the sums over the chosen pairs can be too small now."""
        assert self._near is not None
        grown = float((potential - self._chosen_for[1])[self._massive].max())
        with np.errstate(divide="ignore"):
            logarithms = np.log(self._near.skipped)
        logarithms += (grown + softmin - self._near.softmin) / epsilon
        return float(np.exp(np.minimum(logarithms.max(), 700.0)))

    def rounding(self, n_columns: int, largest_cost: float, epsilon: float, precise: bool) -> float:
        """By how many nats rounding may change a softmin; see `rounding_error`.

        Parameters
        ----------
        n_columns : int
        largest_cost : float
            Over all pairs.
        epsilon : float
        precise : bool
        """
        if self._near is not None and self._chosen_for[0] == epsilon:
            n_columns = self._near.n_columns
            largest_cost = min(largest_cost, self._near.largest)
        return rounding_error(self.operations, n_columns, largest_cost / epsilon, precise)


def plan_softmin(
    operations: Operations, clouds: tuple[Any, Any], pair: tuple[Any, Any], potentials: Any
) -> Softmin:
    """Return what takes T(g) of a plan's rows, as the solver took it.

    Parameters
    ----------
    operations : Operations
    clouds : (rows, columns)
    pair : (source, target)
        Measures, or what has `weights`.
    potentials : Potentials
    """
    weights = pair[0].weights, pair[1].weights
    result = Softmin(operations, *clouds, weights, potentials.truncation)
    rho = potentials.rho[0] if isinstance(potentials.rho, tuple) else potentials.rho
    result.guess = potentials.f * (1.0 + potentials.epsilon / rho)
    return result


def _finite(softmin: Array) -> Array:
    """Return a softmin if it is finite; float32 ends before float64 does."""
    if np.all(np.isfinite(softmin)):
        return softmin
    raise InputError(
        "points are too far apart for this blur on this device, whose float32 overflows: raise "
        "blur, scale the points, or use backend='numpy'"
    )
