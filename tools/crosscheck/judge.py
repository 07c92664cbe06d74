"""An independent solver: the optimum of a small problem between two proven bounds.

The dual is maximized over f alone, with g = Delta_2 T(f) put in (the semi-dual), by Newton's method
with a Levenberg-Marquardt term, a Sinkhorn sweep between the steps, and epsilon annealed from the
size of the cost. The Hessian is -1 / epsilon times a weighted graph's Laplacian plus a diagonal
that cannot be negative. Eliminated as Grassmann, Taksar and Heyman do, from its off-diagonal
entries and its row sums, it needs no subtraction, so that each entry of the factors is right to
some units in its last place, however small the plan's entries between two clusters are.

Sources: Brauer, Clason, Lorenz, Wirth, "A Sinkhorn-Newton method for entropic optimal transport"
(2017); Grassmann, Taksar, Heyman, "Regenerative analysis and steady state distributions for Markov
chains" (1985); for the plan that meets its marginals: Altschuler, Weed, Rigollet, "Near-linear
time approximation algorithms for optimal transport via Sinkhorn iteration" (2017).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crosscheck.exact import Dense, evaluate
from crosscheck.feasible import feasible, hessian, solve_laplacian
from crosscheck.numbers import NUMBER, Vector, kl_terms, unit_of

#: Gap at which a problem is settled, as a share of its value.
SETTLED = max(1e-15, 1e4 * float(np.finfo(NUMBER).eps))
#: Factor between the levels of the annealing.
ANNEALING = 0.25
#: Steps at most, on each level and on the last.
STEPS, LAST_STEPS = 30, 200
#: Largest relative error of a marginal at which a level is left.
LEVEL_TOLERANCE = 0.05


@dataclass(frozen=True)
class Optimum:
    """Proven bounds of the optimum, and potentials of points with mass.

    A gap is compared with `scale`: the value, or epsilon times the mass of the plan if that is
    more.
    """

    low: Any
    high: Any
    scale: Any
    f: Vector
    g: Vector

    @property
    def settled(self) -> bool:
        """Whether the bounds are as close as they should be."""
        return bool(self.high - self.low <= SETTLED * self.scale)


def solve(problem: Dense) -> Optimum:
    """Return the optimum of a problem; balanced masses are made equal by scaling the target's."""
    if problem.source.balanced and problem.target.balanced:
        target = problem.target
        mass = target.mass * (problem.source.mass.sum() / target.mass.sum())
        problem = replace(problem, target=replace(target, mass=mass, logarithm=np.log(mass)))
    if len(problem.source) > len(problem.target):
        found = solve(problem.swapped)
        return replace(found, f=found.g, g=found.f)
    cost = problem.cost()
    ascent = _Newton(problem, cost)
    epsilon = max(float(np.ptp(cost)), float(problem.epsilon))
    while epsilon > 1.5 * problem.epsilon:
        ascent.run(NUMBER(epsilon), LEVEL_TOLERANCE, STEPS)
        epsilon *= ANNEALING
    ascent.run(problem.epsilon, 0.0, LAST_STEPS)
    return _certified(problem, cost, ascent)


class _Newton:
    """The semi-dual and its steps."""

    def __init__(self, problem: Dense, cost: Vector) -> None:
        self.source, self.target, self.cost = problem.source, problem.target, cost
        self.f = np.zeros(len(cost), NUMBER)

    def damping(self) -> tuple[Any, Any]:
        """Return Delta of both sides."""
        return tuple(1 / (1 + self.epsilon * side.rate) for side in (self.source, self.target))

    def best_g(self, f: Vector) -> Vector:
        """Delta_2 T(f)."""
        z = (f[:, None] - self.cost) / self.epsilon + self.source.logarithm[:, None]
        return -self.damping()[1] * self.epsilon * _log_sums(z, 0)

    def best_f(self, g: Vector) -> Vector:
        """Delta_1 T(g)."""
        z = (g - self.cost) / self.epsilon + self.target.logarithm
        return -self.damping()[0] * self.epsilon * _log_sums(z, 1)

    def shifted(self, f: Vector, g: Vector) -> Vector:
        """Return f + s for the best s of (f + s, g - s)."""
        rates = self.source.rate, self.target.rate
        if not any(rates):
            return f
        excess = _log_sums(self.source.logarithm - f * rates[0], 0)
        excess -= _log_sums(self.target.logarithm - g * rates[1], 0)
        return f + excess / sum(rates)

    def value(self, f: Vector, g: Vector) -> Any:
        """Return the dual at (f, best g), but for constants."""
        total = -self.epsilon * self.target.limit(g).sum()  # the mass of the plan
        for side, potential in ((self.source, f), (self.target, g)):
            if side.balanced:
                total += (side.mass * potential).sum()
            else:
                total -= side.rho * (side.mass * np.expm1(-potential * side.rate)).sum()
        return total

    def run(self, epsilon: Any, tolerance: float, steps: int) -> None:
        """Maximize at one epsilon; tolerance: relative error of the row masses."""
        self.epsilon = epsilon
        damping, unit = NUMBER(1e-3), unit_of(NUMBER)
        f = self.best_f(self.best_g(self.f))
        best, idle = NUMBER(np.inf), 0
        for _ in range(steps):
            f = self.best_f(self.best_g(self.shifted(f, self.best_g(f))))
            g = self.best_g(f)
            plan = np.exp(self.exponents(f, g))
            rows, limit = plan.sum(axis=1), self.source.limit(f)
            held = (rows > 0) & (limit > 0)  # float64 may have neither
            error = np.abs(np.log(rows[held] / limit[held])).max(initial=0)
            if error < best / 2:
                best, idle, self.f = error, 0, f
            else:
                idle += 1
            if error <= tolerance or (idle > 2 and best < 1e-9) or best < 4 * unit:
                break
            f, damping = self.step(f, g, plan, limit - rows, damping)
        else:
            self.f = f

    def exponents(self, f: Vector, g: Vector) -> Vector:
        """Return the logarithms of the plan of (f, g)."""
        z = (f[:, None] + g - self.cost) / self.epsilon
        return z + self.source.logarithm[:, None] + self.target.logarithm

    def step(
        self, f: Vector, g: Vector, plan: Vector, gradient: Vector, damping: Any
    ) -> tuple[Vector, Any]:
        """Return the next f, and the Levenberg-Marquardt factor for the next step."""
        before = self.value(f, g)
        noise = 1e3 * unit_of(NUMBER) * abs(before)
        weights, excess, diagonal = hessian(self.source, self.target, self.epsilon, f, plan)
        for _ in range(30):
            direction = self.epsilon * solve_laplacian(
                weights, excess + damping * diagonal, gradient
            )
            expected = (gradient * direction).sum()
            after = self.value(f + direction, self.best_g(f + direction))
            if np.isfinite(after) and after - before >= 0.1 * expected - noise:
                return f + direction, damping / 16 if damping > 1e-12 else NUMBER(0)
            damping = max(8 * damping, NUMBER(1e-6))
        return f, damping


def _log_sums(values: Vector, axis: int) -> Any:
    top = values.max(axis=axis, keepdims=True)
    return np.squeeze(top, axis) + np.log(np.exp(values - top).sum(axis=axis))


def _certified(problem: Dense, cost: Vector, ascent: _Newton) -> Optimum:
    """Return bounds: the dual of the potentials, and the primal of a plan that is feasible.

    For any plan p that has the marginals prescribed, P(p) - D(f, g) = epsilon KL(p | pi)
    + rho_1 KL(p 1 | a e^(-f / rho_1)) + rho_2 KL(p^T 1 | b e^(-g / rho_2)), the balanced sides'
    terms left out, where pi is the plan of (f, g): nothing cancels.
    """
    f, epsilon, unit = ascent.f, problem.epsilon, unit_of(NUMBER)
    g = ascent.best_g(f)
    source, target = problem.source, problem.target
    truth = evaluate(problem, f, g, NUMBER)
    error = truth.dual.error
    if truth.gap is not None:
        gap, gap_error = truth.gap.value, truth.gap.error
    else:
        logarithms = ascent.exponents(f, g)
        plan = np.exp(logarithms)
        ratio, plan = feasible(plan, logarithms, source, target, epsilon, f)
        # An exponent's own error is a change of the ratio.
        both = f[:, None] + g
        size = np.abs(both) + np.abs(cost)
        size = size + 2 * (np.abs(source.offsets[:, None]) + np.abs(target.offsets))
        near = unit * ((source.points.shape[1] + 8) * size / epsilon + 4 * np.abs(logarithms))
        base = np.exp(logarithms)
        near_ones = base * kl_terms(np.minimum(ratio, 1))
        gap = epsilon * np.where(ratio < 1, near_ones, plan * (ratio - 1) + base).sum()
        gap_error = epsilon * (plan * near * (2 * np.abs(ratio) + near) + 16 * unit * plan).sum()
        # Marginals are met to some roundings. Moved along any pairs, so little mass costs:
        far = np.abs(both - cost).max() + epsilon * (64 + np.abs(logarithms).max())
        gap_error += 4 * unit * plan.sum() * far
        for side, potential, marginal in (
            (source, f, plan.sum(axis=1)), (target, g, plan.sum(axis=0)),
        ):  # fmt: skip
            if not side.balanced:
                least = np.finfo(NUMBER).tiny  # where float64 underflows
                limit = np.maximum(side.limit(potential), least)
                excess = np.log(np.maximum(marginal, least) / limit)
                gap += side.rho * (limit * kl_terms(excess)).sum()
                change = 16 * unit * (1 + np.abs(potential) * side.rate)
                gap_error += side.rho * (marginal * change * (np.abs(excess) + change)).sum()
    value = truth.dual.value
    scale = max(abs(value), epsilon * truth.mass.value)
    return Optimum(value - error, value + gap + error + gap_error, scale, f, g)
