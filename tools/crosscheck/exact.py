"""Exact values for given potentials: dense sums in long double, each with a bound of its error.

Nothing here uses the library. With z_ij = (f_i + g_j - C_ij) / epsilon + log b_j, the row sums of
the plan are a_i exp(l_i), l_i = log sum_j exp(z_ij), and everything that `clmorph.sinkhorn` tells
about (f, g) follows from l and from its twin over the columns:

- T(g)_i = f_i - epsilon l_i, so that (f - Delta T(g)) / epsilon = f / (rho + epsilon) + Delta l;
- D(f, g) = rho_1 <a, 1 - exp(-f / rho_1)> + rho_2 <b, 1 - exp(-g / rho_2)>
  - epsilon (mass - m_a m_b), <a, f> in place of the first term where rho_1 is infinite;
- P - D = rho_1 KL(pi 1 | a exp(-f / rho_1)) + rho_2 KL(pi^T 1 | b exp(-g / rho_2)).

Source: Chizat, Peyré, Schmitzer, Vialard, "Scaling algorithms for unbalanced optimal transport
problems" (2018). Error bounds follow Higham, "Accuracy and Stability of Numerical Algorithms"
(2002), to first order, with constants that leave room for the next.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.numbers import NUMBER, Interval, Vector, kl_terms, unit_of

#: Pairs in one block.
BLOCK = 1 << 19
#: More pairs than this are summed in float64, with the bounds that follow from that.
MOST_EXTENDED = 1 << 20


@dataclass(frozen=True)
class Side:
    """The points of positive mass of one measure; `places` is where they stand among all.

    Points and offsets (added to the cost) are float64, the rest is long double; rho is infinite
    where the side is balanced.
    """

    places: Vector
    points: Vector
    mass: Vector
    logarithm: Vector
    offsets: Vector
    rho: Any

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def balanced(self) -> bool:
        """Whether this side's marginal is prescribed."""
        return bool(np.isinf(self.rho))

    @property
    def rate(self) -> Any:
        """1 / rho."""
        return NUMBER(0) if self.balanced else 1 / self.rho

    def limit(self, potential: Vector) -> Vector:
        """Return a exp(-f / rho), what the marginal is at the optimum."""
        return self.mass * np.exp(-potential * self.rate)


def make_side(weights: Vector, points: Vector, offsets: Vector | None, rho: float) -> Side:
    """Return a measure's points of positive mass."""
    places = np.flatnonzero(weights > 0)
    mass = weights[places].astype(NUMBER)
    if offsets is None:
        offsets = np.zeros(len(weights))
    return Side(
        places, np.array(points[places], np.float64), mass, np.log(mass), offsets[places],
        NUMBER(rho),
    )  # fmt: skip


@dataclass(frozen=True)
class Dense:
    """One problem, with all its pairs."""

    source: Side
    target: Side
    epsilon: Any

    @property
    def swapped(self) -> "Dense":
        """The same seen from the target."""
        return Dense(self.target, self.source, self.epsilon)

    @property
    def pairs(self) -> int:
        """Pairs of points."""
        return len(self.source) * len(self.target)

    @property
    def constant(self) -> Any:
        """Epsilon m_a m_b."""
        return self.epsilon * self.source.mass.sum() * self.target.mass.sum()

    def cost(self, rows: slice = slice(None), number: Any = NUMBER) -> Vector:
        """|X_i - Y_j|^2 / 2 + r_i + s_j, from differences."""
        x, y = self.source.points[rows].astype(number), self.target.points.astype(number)
        cost = np.zeros((len(x), len(y)), number)
        for one, other in zip(x.T, y.T, strict=True):
            difference = one[:, None] - other
            difference *= difference
            cost += difference
        cost /= 2
        if self.source.offsets.any() or self.target.offsets.any():
            cost += self.source.offsets[rows, None]
            cost += self.target.offsets
        return cost

    def row_logarithms(self, f: Vector, g: Vector, number: Any) -> tuple[Vector, Vector]:
        """Return l_i, and by how many nats it may be off.

        A cost is off by at most unit * (D + 2) of itself (and of the offsets), an exponent z_ij so
        by unit * (D + 8) * (|f_i + g_j| / epsilon + |z_ij| + |log b_j|), and a sum of n terms
        in pairs by unit * (32 + log2 n). The errors of the exponents are averaged with the weight
        that their pairs have in the sum; they are far below 1, and 1.01 covers their squares.
        """
        unit, epsilon = unit_of(number), number(self.epsilon)
        logarithm, f_, g_ = self.target.logarithm.astype(number), f.astype(number), g.astype(number)
        columns = 2 * np.abs(self.target.offsets) / epsilon + np.abs(logarithm)
        result, slack = np.empty(len(f), NUMBER), np.empty(len(f), NUMBER)
        step = max(1, BLOCK // len(g))
        for start in range(0, len(f), step):
            rows = slice(start, start + step)
            both = f_[rows, None] + g_
            z = both - self.cost(rows, number)
            z /= epsilon
            z += logarithm
            top = z.max(axis=1)
            z -= top[:, None]
            terms = np.exp(z)
            total = terms.sum(axis=1)
            result[rows] = top.astype(NUMBER) + np.log(total.astype(NUMBER))
            depth = -np.einsum("ij,ij->i", terms, z) / total
            sizes = (terms @ columns) / total + depth + np.abs(top)
            np.abs(both, out=both)
            sizes += np.einsum("ij,ij->i", terms, both) / (total * epsilon)
            sizes += 2 * np.abs(self.source.offsets[rows]) / epsilon
            slack[rows] = 1.01 * unit * (self.source.points.shape[1] + 8) * sizes
        slack += unit * (32 + np.log2(len(g))) + 4 * unit * np.abs(result)
        return result, slack


@dataclass(frozen=True)
class Truth:
    """What is true of given potentials.

    `rows` and `columns` are logarithms of the plan's marginals, over points of positive mass, and
    the slacks by how many nats these may be off. The residual is without truncation, the gap None
    with a balanced side.
    """

    rows: Vector
    columns: Vector
    rows_slack: Vector
    columns_slack: Vector
    residual: Interval
    marginal_error: Interval
    mass: Interval
    dual: Interval
    gap: Interval | None


def evaluate(problem: Dense, f: Vector, g: Vector, number: Any = None) -> Truth:
    """Return the truth about potentials (of points with mass), by sums over all pairs.

    Exponents are formed and summed as `number`: by default long double for few pairs, float64 for
    many.
    """
    if number is None:
        number = NUMBER if problem.pairs <= MOST_EXTENDED else np.float64
    f, g = f.astype(NUMBER), g.astype(NUMBER)
    unit, epsilon = unit_of(NUMBER), problem.epsilon
    sums = problem.row_logarithms(f, g, number), problem.swapped.row_logarithms(g, f, number)
    residual, masses, marginal_error = [], [], Interval(NUMBER(0), NUMBER(0))
    dual, dual_error = problem.constant, problem.constant * 4 * unit
    gap, gap_error, marginals = NUMBER(0), NUMBER(0), []
    sides = zip((problem.source, problem.target), (f, g), sums, strict=True)
    for side, potential, (logarithm, slack) in sides:
        n_unit = unit * (32 + np.log2(len(side)))  # of a sum in pairs
        rest = 1 / (1 + epsilon * side.rate)  # Delta
        own = potential * side.rate * rest + rest * logarithm
        own_slack = slack * rest + 8 * unit * (np.abs(potential) * side.rate + np.abs(logarithm))
        at = np.argmax(np.abs(own))
        residual.append(Interval(np.abs(own[at]), own_slack.max()))
        marginals.append((logarithm + side.logarithm, slack + 4 * unit * np.abs(side.logarithm)))
        with np.errstate(over="ignore", invalid="ignore"):
            mass = np.exp(marginals[-1][0])
            off = mass * (np.expm1(1.01 * marginals[-1][1]) + 8 * unit)
            masses.append(Interval(mass.sum(), off.sum() + n_unit * mass.sum()))
            if side.balanced:
                terms = side.mass * potential
                dual_error += n_unit * np.abs(terms).sum()
                wrong = np.abs(mass - side.mass)
                error = off.sum() + n_unit * (mass + side.mass).sum()
                marginal_error = Interval(
                    marginal_error.value + wrong.sum(), marginal_error.error + error
                )
            else:
                limit, exponent = side.limit(potential), np.abs(potential) * side.rate
                terms = -side.rho * side.mass * np.expm1(-potential * side.rate)
                dual_error += n_unit * np.abs(terms).sum()
                dual_error += side.rho * (limit * exponent).sum() * 8 * unit
                excess = logarithm + potential * side.rate
                near = slack + 4 * unit * (np.abs(logarithm) + exponent)
                kl = kl_terms(excess)
                gap += side.rho * (limit * kl).sum()
                # d/dx (x e^x - e^x + 1) = x e^x
                change = near * (np.abs(excess) + near) * np.exp(excess + near)
                change += (8 * exponent + 16) * unit * kl + 8 * unit * np.abs(excess) * near
                change += 8 * unit * (np.abs(excess) > 1e-3) * (1 + np.exp(excess))
                gap_error += side.rho * (limit * change).sum()
                gap_error += side.rho * n_unit * (limit * kl).sum()
            dual += terms.sum()
    best = min(masses, key=lambda mass: mass.error)
    with np.errstate(invalid="ignore"):
        dual = dual - epsilon * best.value
        dual_error = dual_error + epsilon * best.error + 8 * unit * np.abs(dual)
    return Truth(
        marginals[0][0], marginals[1][0], marginals[0][1], marginals[1][1],
        Interval(max(one.value for one in residual), max(one.error for one in residual)),
        marginal_error, best,
        Interval(dual, dual_error),
        None if problem.source.balanced or problem.target.balanced else Interval(gap, gap_error),
    )  # fmt: skip
