"""One transport problem: its half-steps, its dual and primal values, its certificate.

Source of the formulas: the paper, 2.1 and 3.1; Chizat, Peyré, Schmitzer, Vialard, "Scaling
algorithms for unbalanced optimal transport problems" (2018).
"""

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from clmorph.operations import Operations
from clmorph.points import AnyMeasure
from clmorph.softmins import Softmin

Array = NDArray[np.float64]

#: Exponents are cut here, so that potentials far from a solution give large numbers, not inf.
MAX_EXPONENT = 300.0


class Certificate(NamedTuple):
    """What the two marginals of the plan of (f, g) prove.

    Attributes
    ----------
    primal, dual : float
        Values of the plan and of the potentials, cost units times mass. With finite reach on
        both sides dual <= optimum <= primal.
    gap : float or None
        primal - dual, summed from terms that cannot be negative; None if both sides are
        balanced, as the plan is feasible in the limit only. With one balanced side it bounds
        the distance to the optimum for the marginal that the plan has there.
    marginal_error : float
        |pi 1 - a|_1 + |pi^T 1 - b|_1 over the balanced sides; 0 without any.
    row_mass, column_mass : (N,) and (M,) arrays
        Marginals of the plan.
    transported_mass : float
        Mass of the plan.
    """

    primal: float
    dual: float
    gap: float | None
    marginal_error: float
    row_mass: Array
    column_mass: Array
    transported_mass: float


class Problem:
    """Unbalanced entropic transport between two measures, at any epsilon.

    Parameters
    ----------
    to_rows, to_columns : Softmin
        What takes T(g) and T(f).
    weights : (a, b)
        Masses of both measures.
    rho : (rho_source, rho_target)
        Cost units; infinite is balanced.
    largest_cost : float
        A bound of the cost.
    """

    def __init__(
        self,
        to_rows: Softmin,
        to_columns: Softmin,
        weights: tuple[Array, Array],
        rho: tuple[float, float],
        largest_cost: float,
    ) -> None:
        self.to_rows, self.to_columns = to_rows, to_columns
        self.a, self.b = weights
        with np.errstate(divide="ignore"):
            self.log_a, self.log_b = np.log(self.a), np.log(self.b)
        self.rho, self.largest_cost = rho, largest_cost
        #: 1 / rho, 0 if balanced: with it one infinite rho is harmless.
        self.inverse_rho = tuple(0.0 if np.isinf(value) else 1.0 / value for value in rho)
        self.masses = float(self.a.sum()), float(self.b.sum())
        self.n_softmin = 0

    @classmethod
    def between(
        cls,
        operations: Operations,
        source: AnyMeasure,
        target: AnyMeasure,
        rho: tuple[float, float],
        truncation: float | None = None,
    ) -> Self:
        """Return the problem of two measures.

        Parameters
        ----------
        operations : Operations
        source, target : Measure or WeightedPoints
        rho : (rho_source, rho_target)
        truncation : float, optional
            See `clmorph.softmins.Softmin`.
        """
        rows = columns = operations.upload(source.points, source.weights, source.offsets)
        if target is not source:
            columns = operations.upload(target.points, target.weights, target.offsets)
        a, b = source.weights, target.weights
        return cls(
            Softmin(operations, rows, columns, (a, b), truncation),
            Softmin(operations, columns, rows, (b, a), truncation),
            (a, b), rho, largest_cost(source.points, target.points),
        )  # fmt: skip

    @property
    def operations(self) -> Operations:
        """The backend."""
        return self.to_rows.operations

    @property
    def rows(self) -> Any:
        """The source's cloud."""
        return self.to_rows.rows

    @property
    def columns(self) -> Any:
        """The target's cloud."""
        return self.to_rows.columns

    @property
    def truncation(self) -> float | None:
        """By how many nats a log-sum-exp may be too small."""
        return self.to_rows.truncation

    def is_astray(self, f: Array, epsilon: float) -> bool:
        """Whether potentials have left where this problem stands for another one."""
        return False

    def damping(self, epsilon: float) -> tuple[float, float]:
        """Delta = rho / (rho + epsilon), the proximal step of the KL penalty; of both sides."""
        source, target = (1.0 / (1.0 + epsilon * inverse) for inverse in self.inverse_rho)
        return source, target

    def softmin_rows(self, g: Array, epsilon: float, precise: bool) -> Array:
        """T(g): (N,) array."""
        self.n_softmin += 1
        return self.to_rows(g, epsilon, precise)

    def softmin_columns(self, f: Array, epsilon: float, precise: bool) -> Array:
        """T(f): (M,) array."""
        self.n_softmin += 1
        return self.to_columns(f, epsilon, precise)

    @property
    def truncation_error(self) -> float:
        """By how many nats the sums of the last softmins can be too small."""
        return max(self.to_rows.error, self.to_columns.error)

    @property
    def visited(self) -> float:
        """Share of all pairs that the last softmins summed, the mean of both."""
        return 0.5 * (self.to_rows.visited + self.to_columns.visited)

    def rounding(self, epsilon: float, precise: bool) -> float:
        """By how many nats a softmin may be off."""
        return max(
            self.to_rows.rounding(len(self.b), self.largest_cost, epsilon, precise),
            self.to_columns.rounding(len(self.a), self.largest_cost, epsilon, precise),
        )

    def update_f(self, g: Array, t_rows: Array, epsilon: float) -> tuple[Array, Array, Array]:
        """Maximize the dual over all (f, g + s), given T(g): return f, g + s and its softmin.

        f = Delta T(g + s) for every s, and the best s has a closed form; a shift of its own,
        after f, would spoil f again. Source of the idea: Séjourné, Vialard, Peyré, "Faster
        unbalanced optimal transport: translation invariant Sinkhorn and 1-D Frank-Wolfe"
        (2022).
        """
        s = self._shift(self.log_a, t_rows, 0, self.log_b, g, epsilon)
        return self.damping(epsilon)[0] * (t_rows - s), g + s, t_rows - s

    def update_g(self, f: Array, t_columns: Array, epsilon: float) -> tuple[Array, Array, Array]:
        """Maximize the dual over all (f + s, g), given T(f): return g, f + s and its softmin."""
        s = self._shift(self.log_b, t_columns, 1, self.log_a, f, epsilon)
        return self.damping(epsilon)[1] * (t_columns - s), f + s, t_columns - s

    def _shift(
        self, log_new: Array, softmin: Array, side: int, log_old: Array, old: Array, epsilon: float
    ) -> float:
        """Best s for `old` + s, if the other potential follows by its half-step."""
        # 1 / (rho + epsilon) and 1 / rho: 0 if balanced
        new_rate = self.inverse_rho[side] * self.damping(epsilon)[side]
        old_rate = self.inverse_rho[1 - side]
        if new_rate + old_rate == 0.0:
            return 0.0
        excess = _log_sum_exp(log_old - old * old_rate)
        excess -= _log_sum_exp(log_new - softmin * new_rate)
        return excess / (new_rate + old_rate)

    def residual(
        self, f: Array, g: Array, t_rows: Array, t_columns: Array, epsilon: float
    ) -> float:
        """max(|f - Delta T(g)|, |g - Delta T(f)|) / epsilon, over points of positive mass.

        With truncation a bound of it, for the softmins taken last.
        """
        source, target = self.damping(epsilon)
        # What is left out can only be missing from the sums behind the softmins.
        change_f = np.abs(f - source * t_rows)[self.a > 0]
        change_g = np.abs(g - target * t_columns)[self.b > 0]
        return float(max(change_f.max(), change_g.max()) / epsilon) + self.truncation_error

    def row_mass(self, f: Array, t_rows: Array, epsilon: float) -> Array:
        """First marginal of the plan of (f, g), given T(g)."""
        return _mass(self.a, self.log_a, f, t_rows, epsilon)

    def column_mass(self, g: Array, t_columns: Array, epsilon: float) -> Array:
        """Second marginal of the plan of (f, g), given T(f)."""
        return _mass(self.b, self.log_b, g, t_columns, epsilon)

    def dual(self, f: Array, g: Array, plan_mass: float, epsilon: float) -> float:
        """D(f, g), given the mass of its plan."""
        value = -epsilon * (plan_mass - self.masses[0] * self.masses[1])
        for potential, weights, inverse in (
            (f, self.a, self.inverse_rho[0]),
            (g, self.b, self.inverse_rho[1]),
        ):
            if inverse:
                # rho (1 - exp(-f / rho)), without the cancellation at large rho
                scaled = np.minimum(-potential * inverse, MAX_EXPONENT)
                value -= inner(weights, np.expm1(scaled)) / inverse
            else:
                value += inner(weights, potential)
        return value

    def certificate(
        self, f: Array, g: Array, t_rows: Array, t_columns: Array, epsilon: float
    ) -> Certificate:
        """Return what T(g) and T(f) prove about (f, g).

        With truncation masses can be up to a factor exp(truncation_error) larger; dual and
        primal are then the least and the greatest that this leaves possible.
        """
        missing = self.truncation_error
        rows = self.row_mass(f, t_rows, epsilon)
        columns = self.column_mass(g, t_columns, epsilon)
        plan_mass = float(rows.sum())
        dual = self.dual(f, g, plan_mass, epsilon)
        primal, gap, marginal_error = dual, 0.0, 0.0
        for potential, softmin, weights, marginal, inverse in (
            (f, t_rows, self.a, rows, self.inverse_rho[0]),
            (g, t_columns, self.b, columns, self.inverse_rho[1]),
        ):
            if inverse:
                # rho KL(pi 1 | a exp(-f / rho)), term by term
                excess = (potential - softmin) / epsilon + potential * inverse
                limit = np.exp(np.minimum(-potential * inverse, MAX_EXPONENT)) * weights
                terms = _kl_terms(excess)
                if missing:
                    terms = np.maximum(terms, _kl_terms(excess + missing))
                gap += inner(limit, np.maximum(terms, 0.0)) / inverse
            else:
                primal += inner(marginal - weights, potential)
                marginal_error += float(np.abs(marginal - weights).sum())
                if missing:
                    more = np.expm1(missing) * marginal
                    primal += inner(more, np.abs(potential))
                    marginal_error += float(more.sum())
        balanced = not any(self.inverse_rho)
        primal += gap
        if missing:
            dual = self.dual(f, g, plan_mass * np.exp(missing), epsilon)
            gap = primal - dual
        return Certificate(
            primal, dual, None if balanced else gap, marginal_error, rows, columns, plan_mass
        )


def _kl_terms(excess: Array) -> Array:
    """Return x e^x - e^x + 1, which grows with |x|."""
    excess = np.clip(excess, -MAX_EXPONENT, MAX_EXPONENT)
    return excess * np.exp(excess) - np.expm1(excess)


def inner(x: Array, y: Array) -> float:
    """Return the inner product of two vectors, in this thread.

    A BLAS that shares it between threads lets them spin for a while afterwards, on the cores
    that a CPU device's next kernel needs; that made solves a quarter slower.
    """
    return float(np.einsum("i,i", x, y))


def largest_cost(x: Array, y: Array) -> float:
    """Return a bound of the cost: half the squared diameter of the joint bounding box."""
    low = np.minimum(x.min(axis=0), y.min(axis=0))
    high = np.maximum(x.max(axis=0), y.max(axis=0))
    return float(0.5 * np.sum((high - low) ** 2))


def _mass(weights: Array, log_weights: Array, f: Array, softmin: Array, epsilon: float) -> Array:
    """a_i exp((f_i - T(g)_i) / epsilon), by its logarithm: a alone may underflow."""
    with np.errstate(invalid="ignore"):
        exponent = np.minimum((f - softmin) / epsilon + log_weights, MAX_EXPONENT)
    return np.where(weights > 0, np.exp(exponent), 0.0)


def _log_sum_exp(values: Array) -> float:
    largest = values.max()
    return float(largest + np.log(np.sum(np.exp(values - largest))))
