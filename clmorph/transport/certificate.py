"""Lower and upper bounds of the optimal value, proven by potentials, rounding included.

The dual value D(f, g) of any potentials is at most the optimum. The primal value of any plan that
keeps every balanced marginal is at least the optimum. Both values follow from the two marginals of
the plan, and these from two softmins. A softmin is known up to the pairs left out of its sums and
up to its rounding, and both errors are bounded in nats. `certify` returns the least dual value and
the greatest primal value that these bounds leave possible.

For unbalanced problems (paper, 2.1) the difference of both values is
rho KL(pi 1 | a e^(-f/rho)) + rho KL(pi^T 1 | b e^(-g/rho)) (math: certificate).

Source of the formulas: Chizat, Peyré, Schmitzer, Vialard, "Scaling algorithms for unbalanced
optimal transport problems" (2018).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import MAX_EXPONENT

#: At this and larger exponents, e^x and e^x - 1 are the same float64.
FAR = 50.0
#: Relative errors in float64: of a few operations, and of NumPy's pairwise sum of 2^24 terms.
STEPS_ERROR, SUM_ERROR = 2.0**-50, 2.0**-46


class Certificate(NamedTuple):
    """Bounds that follow from the two marginals of the plan of (f, g).

    Attributes
    ----------
    primal, dual : float
        Bounds of the optimal value, cost units times mass: dual <= optimum <= primal. Truncation
        and rounding are included; the bounds are infinite if potentials are so far from a solution
        that nothing is proven. Without a balanced side the primal value is that of the plan. With
        one balanced side it is that of the plan with rows (or columns) scaled to the given masses.
        With two balanced sides it follows from the marginal errors and the oscillation of the
        cost; it is then far above the optimum unless the potentials are good, and it requires
        equal masses.
    gap : float
        primal - dual.
    marginal_error : float
        Upper bound of |pi 1 - a|_1 + |pi^T 1 - b|_1 over the balanced sides; 0 without balanced
        sides.
    row_mass, column_mass : (N,) and (M,) arrays
        Marginals of the plan.
    transported_mass : float
        Mass of the plan.
    masses : (float, float)
        Masses of the source and the target.
    """

    primal: float
    dual: float
    gap: float
    marginal_error: float
    row_mass: Array
    column_mass: Array
    transported_mass: float
    masses: tuple[float, float]


class Side(NamedTuple):
    """One measure, its potential, and the softmin of the other potential with its error bounds."""

    weights: Array
    log_weights: Array
    potential: Array  #: f of the rows, or g of the columns, cost units
    softmin: Array  #: T(g), or T(f)
    inverse_rho: float  #: 0 if balanced
    left_out: float  #: nats by which the sums behind the softmin are too small, at most
    roundoff: float  #: nats of rounding of the logarithms of these sums, at most
    oscillation: float  #: bound of |C_ij - C_kj| over points i, k of this measure

    def marginal(self, epsilon: float) -> Array:
        """Return the marginal of the plan on this side."""
        return marginal(self.weights, self.log_weights, self.potential, self.softmin, epsilon)


class _Bounded:
    """One side over its points of positive mass, with an interval that contains each number."""

    def __init__(self, side: Side, epsilon: float) -> None:
        massive = side.weights > 0
        self.weights, self.log_weights = side.weights[massive], side.log_weights[massive]
        self.potential, self.softmin = side.potential[massive], side.softmin[massive]
        self.inverse_rho, self.oscillation = side.inverse_rho, side.oscillation
        sizes = (np.abs(self.potential) + np.abs(self.softmin)) / epsilon
        sizes += np.abs(self.log_weights)
        self.below = side.roundoff + STEPS_ERROR * sizes
        self.above = self.below + side.left_out
        #: Logarithm of the quotient of marginal and weights.
        self.ratio = (self.potential - self.softmin) / epsilon
        self.marginal = side.marginal(epsilon)[massive]

    @property
    def is_representable(self) -> bool:
        """Whether all exponentials are finite."""
        scaled = -self.potential * self.inverse_rho
        logarithms = np.maximum(self.ratio + self.above, scaled) + self.log_weights
        return bool(logarithms.max() < MAX_EXPONENT and scaled.max() < 2 * MAX_EXPONENT)

    @property
    def mass(self) -> tuple[float, float]:
        """Return the least and the greatest mass of the plan that this marginal allows."""
        low = float(np.sum(self.marginal * np.exp(-self.below)))
        high = float(np.sum(self.marginal * np.exp(self.above)))
        return low * (1 - SUM_ERROR), high * (1 + SUM_ERROR)

    @property
    def penalty(self) -> tuple[float, float]:
        """Return this potential's term of the dual, and a bound of its rounding.

        The term is rho <a, 1 - e^(-f/rho)>, or <a, f> if balanced (paper, 2.1; math: dual).
        """
        if not self.inverse_rho:
            terms = self.weights * self.potential
            return float(terms.sum()), SUM_ERROR * float(np.abs(terms).sum())
        scaled = -self.potential * self.inverse_rho
        # rho (1 - exp(-f / rho)), without the cancellation at large rho
        gains = np.expm1(scaled)
        sizes = self.weights * (np.abs(gains) + np.abs(scaled) * (1 + gains))
        gain = -float(np.sum(self.weights * gains)) / self.inverse_rho
        return gain, SUM_ERROR * float(sizes.sum()) / self.inverse_rho

    @property
    def missed(self) -> float:
        """Return an upper bound of |pi 1 - a|_1."""
        more = self.marginal * np.expm1(self.above)
        return float(np.sum(np.abs(self.marginal - self.weights) + more)) * (1 + SUM_ERROR)

    def divergence(self, shrunk: float, grown: float) -> float:
        """Return an upper bound of rho KL(r | a exp(-f / rho)), whose terms cannot be negative.

        The logarithms of r may be up to `shrunk` less than those of the marginal, and up to
        `grown` more.
        """
        scaled = self.potential * self.inverse_rho
        excess = self.ratio + scaled
        more = STEPS_ERROR * np.abs(scaled)
        low, high = excess - self.below - more - shrunk, excess + self.above + more + grown
        limit = self.weights * np.exp(-scaled)
        terms = np.maximum(_kl_terms(limit, low), _kl_terms(limit, high))
        # Where the marginal is far above the limit, e^x can overflow although the product with the
        # limit is finite.
        far = high > FAR
        if far.any():
            logarithms = (self.log_weights - scaled + high)[far]
            if float(logarithms.max()) > 2 * MAX_EXPONENT:
                return np.inf
            masses = np.exp(logarithms) * (1 + STEPS_ERROR * np.abs(logarithms))
            terms[far] = masses * (high[far] - 1) * (1 + STEPS_ERROR) + limit[far]
        rounding = 1 + SUM_ERROR + 2 * float(more.max())
        return float(np.sum(terms)) / self.inverse_rho * rounding


def certify(rows: Side, columns: Side, epsilon: float) -> Certificate:
    """Return the bounds that potentials and their softmins prove (math: certificate)."""
    of_rows, of_columns = _Bounded(rows, epsilon), _Bounded(columns, epsilon)
    row_mass, column_mass = rows.marginal(epsilon), columns.marginal(epsilon)
    mass = float(row_mass.sum())
    masses = float(rows.weights.sum()), float(columns.weights.sum())
    balanced = [side for side in (of_rows, of_columns) if not side.inverse_rho]
    if not (of_rows.is_representable and of_columns.is_representable):
        error = np.inf if balanced else 0.0
        return Certificate(np.inf, -np.inf, np.inf, error, row_mass, column_mass, mass, masses)
    intervals = of_rows.mass, of_columns.mass
    least = max(low for low, _ in intervals)
    most = max(least, min(high for _, high in intervals))
    gains, errors = zip(of_rows.penalty, of_columns.penalty, strict=True)
    constant = epsilon * masses[0] * masses[1]
    rounding = sum(errors) + SUM_ERROR * (epsilon * most + constant)
    dual = sum(gains) + constant - epsilon * most - rounding
    greatest = sum(gains) + constant - epsilon * least + rounding
    if len(balanced) == 2:
        primal = greatest + _infeasibility(of_rows, of_columns, epsilon)
    elif balanced:
        other = of_columns if of_rows is balanced[0] else of_rows
        primal = _one_side_scaled(balanced[0], other, epsilon, constant)
    else:
        primal = greatest + of_rows.divergence(0.0, 0.0) + of_columns.divergence(0.0, 0.0)
    primal = max(primal, dual)
    return Certificate(
        primal, dual, primal - dual, float(sum(side.missed for side in balanced)),
        row_mass, column_mass, mass, masses,
    )  # fmt: skip


def _one_side_scaled(balanced: _Bounded, other: _Bounded, epsilon: float, constant: float) -> float:
    """Return an upper bound of the primal of the plan with its rows scaled to the given masses.

    The scaled plan has the softmin itself as its potential there. Its other marginal changes by at
    most the largest factor of a row. The same holds for columns.
    """
    scaled = balanced.weights * (balanced.softmin + epsilon * balanced.below)
    mass = float(balanced.weights.sum())
    gain, error = other.penalty
    value = float(scaled.sum()) + gain + constant - epsilon * mass
    error += SUM_ERROR * (float(np.abs(scaled).sum()) + constant + epsilon * mass)
    largest = float(np.max(balanced.ratio + balanced.above))
    least = float(np.min(balanced.ratio - balanced.below))
    return value + error + other.divergence(max(largest, 0.0), max(-least, 0.0))


def _infeasibility(rows: _Bounded, columns: _Bounded, epsilon: float) -> float:
    """Return by how much the optimum of a balanced problem can exceed the dual value.

    The dual is concave with gradient (a - pi 1, b - pi^T 1), so it grows towards optimal
    potentials (f*, g*) by at most <a - pi 1, f* - f> + <b - pi^T 1, g* - g>. Optimal potentials
    are softmins, so they oscillate by no more than the cost does. With f* - f between plus and
    minus half an oscillation, g* = T(f*) differs from T(f) by no more than that, and T(f) is near
    to g.
    """
    bounds = []
    missed = rows.missed, columns.missed
    for one, other, missed_there in (
        (rows, columns, missed[1]), (columns, rows, missed[0])
    ):  # fmt: skip
        oscillation = one.oscillation + float(np.ptp(one.potential))
        off = float(np.max(np.abs(other.ratio) + other.above))
        bounds.append(0.5 * sum(missed) * oscillation + missed_there * epsilon * off)
    return min(bounds) * (1 + SUM_ERROR)


def marginal(
    weights: Array, log_weights: Array, potential: Array, softmin: Array, epsilon: float
) -> Array:
    """Return (pi 1)_i = a_i exp((f_i - T(g)_i) / epsilon), as a_i can underflow (math: plan)."""
    with np.errstate(invalid="ignore"):
        exponent = np.minimum((potential - softmin) / epsilon + log_weights, MAX_EXPONENT)
    return np.where(weights > 0, np.exp(exponent), 0.0)


def _kl_terms(limit: Array, excess: Array) -> Array:
    """Return an upper bound of (x e^x - e^x + 1) limit for x up to FAR; it grows with |x|."""
    excess = np.clip(excess, -MAX_EXPONENT, FAR)
    growth, powers = np.expm1(excess), excess * np.exp(excess)
    terms = np.maximum(powers - growth, 0.0) + STEPS_ERROR * (np.abs(powers) + np.abs(growth))
    return limit * terms
