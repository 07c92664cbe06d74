"""Linear systems of the judge, and plans that meet the marginals that are prescribed."""

from typing import Any

import numpy as np

from crosscheck.exact import Side
from crosscheck.numbers import NUMBER, Vector

#: Largest correction of a plan that shall meet its marginals, in nats.
CORRECTION = 1e-6


def solve_laplacian(weights: Vector, excess: Vector, right: Vector) -> Vector:
    """Solve (diag(excess + sum_j w_ij) - w) x = right without a subtraction in the factors.

    Weights (symmetric, the diagonal is ignored) and excess are at least 0; where the excess is 0
    for a whole component, one x of it is 0.
    """
    w, e, b = weights.copy(), excess.copy(), right.copy()
    n = len(e)
    shares, pivots = np.zeros_like(w), np.zeros_like(e)
    for k in range(n - 1, -1, -1):
        row = w[k, :k].copy()
        pivots[k] = e[k] + row.sum()
        if pivots[k] == 0:
            continue
        share = row / pivots[k]
        w[:k, :k] += share[:, None] * row
        e[:k] += share * e[k]
        b[:k] += share * b[k]
        shares[k, :k] = share
    x = np.zeros_like(b)
    for k in range(n):
        if pivots[k] > 0:
            x[k] = b[k] / pivots[k] + shares[k, :k] @ x[:k]
    return x


def hessian(
    source: Side, target: Side, epsilon: Any, f: Vector, plan: Vector
) -> tuple[Vector, Vector, Vector]:
    """Return -epsilon times the semi-dual's Hessian: off-diagonal weights, row sums, scale."""
    columns, rows = plan.sum(axis=0), plan.sum(axis=1)
    grown = 1 + epsilon * target.rate
    safe = np.where(columns > 0, columns, 1)
    weights = (plan / (safe * grown)) @ plan.T
    excess = source.limit(f) * epsilon * source.rate
    excess = excess + rows * (epsilon * target.rate / grown)
    return weights, excess, rows


def feasible(
    plan: Vector, logarithms: Vector, source: Side, target: Side, epsilon: Any, f: Vector
) -> tuple[Vector, Vector]:
    """Return a plan that has the marginals prescribed, near a given one, and log of their ratio."""
    ratio = np.zeros_like(plan)
    if source.balanced and target.balanced:
        for _ in range(4):
            ratio -= np.log(plan.sum(axis=0) / target.mass)
            plan = np.exp(logarithms + ratio)
            weights, _, _ = hessian(source, target, epsilon, f, plan)
            ratio += _correction(weights, plan.sum(axis=1), source.mass)[:, None]
            plan = np.exp(logarithms + ratio)
        ratio -= np.log(plan.sum(axis=0) / target.mass)
        plan = np.exp(logarithms + ratio)
        ratio -= np.log(np.maximum(plan.sum(axis=1) / source.mass, 1))[:, None]
        plan = np.exp(logarithms + ratio)
        ratio -= np.log(np.maximum(plan.sum(axis=0) / target.mass, 1))
        plan = np.exp(logarithms + ratio)
        missing = np.maximum(source.mass - plan.sum(axis=1), 0)
        other = np.maximum(target.mass - plan.sum(axis=0), 0)
        if other.sum() > 0 and missing.sum() > 0:
            more = missing[:, None] * (other / other.sum())
            with np.errstate(divide="ignore"):
                ratio = np.logaddexp(ratio, np.log(more) - logarithms)
            plan = plan + more
    elif source.balanced:
        ratio -= np.log(plan.sum(axis=1) / source.mass)[:, None]
        plan = np.exp(logarithms + ratio)
    else:
        ratio -= np.log(plan.sum(axis=0) / target.mass)
        plan = np.exp(logarithms + ratio)
    return ratio, plan


def _correction(weights: Vector, rows: Vector, wanted: Vector) -> Vector:
    """Return by how many nats to raise rows, so that they have the masses wanted.

    Between clusters that hardly exchange mass a rounding of their masses would call for a large
    step. What remains there is left to the part of rank one.
    """
    damping = NUMBER(0)
    while True:
        step = solve_laplacian(weights, damping * rows, wanted - rows)
        if np.abs(step).max() <= CORRECTION:
            return step
        damping = max(damping * 100, NUMBER(1e-24))
        if damping > 1e12:
            return np.zeros_like(step)
