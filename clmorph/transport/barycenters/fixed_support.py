"""Barycenters on given points: iterative projections in the log domain.

With even masses u on the support x_i, of the mean mass of the measures, each plan between the
support and a measure b_k is

    pi_k,ij = u exp((f_k,i + g_k,j - C_ij) / epsilon) b_k,j,

and the barycenter has the masses a = u exp(alpha). Without debiasing these minimize, over a and
pi_k,

    sum_k w_k [<C, pi_k> + epsilon KL(pi_k | u x b_k)
               + rho KL(pi_k 1 | a) + rho KL(pi_k^T 1 | b_k)]:

the reference of the entropy is u in place of a, for which `clmorph.sinkhorn` has a x b_k. In turn
it is minimized over the columns' marginals, and over the rows' and a (Chizat, Peyré, Schmitzer,
Vialard, "Scaling algorithms for unbalanced optimal transport problems", Mathematics of Computation
87, 2018, section 5.2). With q = rho / (rho + epsilon), p = 1 - q and t_k = T(g_k),

    g_k <- q T(f_k),    alpha <- -m(t) / epsilon,    f_k <- q (epsilon alpha + t_k),

where m(t) = -(epsilon / p) log sum_k w_k exp(-p t_k / epsilon). For balanced transport, q = 1, both
marginals are given, m is the mean sum_k w_k t_k, and u, a constant, does not matter: these are
iterative Bregman projections (Benamou, Carlier, Cuturi, Nenna, Peyré, "Iterative Bregman
projections for regularized transportation problems", SIAM Journal on Scientific Computing 37(2),
2015, section 3.2). Diracs b_k at y_k then have a ~ exp(-sum_k w_k C(x, y_k) / epsilon), so that the
barycenter is blurred by the kernel.

With debiasing a minimizes sum_k w_k S(a, b_k). Entropies are then relative to a x b_k and a x a, so
that f_k = epsilon alpha + q t_k. Where d = u exp(delta) scales the plan of a to itself,
delta = alpha + q T(epsilon delta) / epsilon, the derivative by a is 0 for sum_k w_k exp(-p t_k /
epsilon) = exp((alpha - delta) p / q), and therefore

    alpha <- delta - q m(t) / epsilon,
    delta <- (delta + alpha + q T(epsilon delta) / epsilon) / 2,

which for q = 1 is algorithm 1 of Janati, Cuturi, Gramfort, "Debiased Sinkhorn barycenters", ICML
2020. Linearized at its fixed point, for measures that are alike, it contracts at every frequency
and every q. Masses of the plans differ from one another in proportion to q^2 from one iteration to
the next; so f_k + c_k and g_k - c_k take the place of both, where c_k is best for their plan
(Séjourné, Vialard, Peyré, "Faster unbalanced optimal transport", AISTATS 2022), less a constant
which leaves sum_k w_k pi_k 1 the mass that it has. Where measures are partly out of one another's
reach, one c_k does not fit all places: as long as these shifts grow, less of them is taken.

All sums over points are soft minima of a backend, so no matrix is stored.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, Progress
from clmorph.backends.interface import Operations
from clmorph.measures.grid import Grid, are_grids
from clmorph.transport._solver.grid_softmin import GridSoftmin
from clmorph.transport._solver.problem import uploaded
from clmorph.transport.barycenters.result import Barycenter, BarycenterProblem, Call, check_mass

#: The smallest logarithm of a mass, in nats below the mean: the square root of float64's range.
FAINTEST = -350.0
#: Factor by which the share of the shifts that is taken grows as long as they fall.
RECOVERY = 1.2


def fixed_support(
    problem: BarycenterProblem, call: Call, operations: Operations, report: Progress
) -> Barycenter:
    """Return the barycenter's weights on given points, or on a grid whose mask counts."""
    measures, shares, support = problem
    tol, max_iter, debias = call.goal.tol, call.goal.max_iter, call.debias
    epsilon, rho = call.goal.epsilon, call.goal.rho[0]
    q = 1.0 / (1.0 + epsilon / rho)
    even = support.weights
    grids = are_grids(support, *measures)
    places, *clouds = (
        each if grids else uploaded(operations, each) for each in (support, *measures)
    )

    def softmin(rows: Any, columns: Any, potential: Array) -> Array:
        if grids:
            return GridSoftmin(operations, rows, columns)(potential, epsilon, precise=True)
        return operations.softmin(rows, columns, potential, epsilon, precise=True)

    f = [np.zeros(len(even)) for _ in measures]
    g: list[Array] = [np.zeros(0)] * len(measures)
    alpha, delta, weights = np.zeros(len(even)), np.zeros(len(even)), even
    size, damping = np.inf, 1.0
    residuals: list[float] = []
    for number in range(max_iter):
        sums, error = [], 0.0
        for k, (cloud, measure) in enumerate(zip(clouds, measures, strict=True)):
            arriving = q * softmin(cloud, places, f[k])
            if number:
                # The plan before this step arrives in its columns' masses times exp(...).
                miss = np.expm1(np.minimum((g[k] - arriving) / epsilon, 50.0))
                error = max(error, float(measure.weights @ np.abs(miss)) / measure.mass)
            g[k] = arriving
            sums.append(softmin(places, cloud, arriving))
        if q < 1:
            own = [each - epsilon * alpha if debias else each for each in f]
            leaving = np.array([_log_mass(weights, each, rho) for each in own])
            arrived = [_log_mass(each.weights, g[k], rho) for k, each in enumerate(measures)]
            halves = (leaving - np.array(arrived)) / 2
            both = np.array([leaving, leaving - halves])
            both = np.logaddexp.reduce(np.log(shares) + both, axis=1)
            # What is added to f_k, and taken from g_k, in cost units.
            shifts = rho * (halves - both[0] + both[1])
            size, last = float(np.abs(shifts).max()), size
            damping = min(1.0, RECOVERY * damping) if size <= last else damping / 2
            for k, shift in enumerate(damping * shifts):
                g[k], sums[k] = g[k] - shift, sums[k] + shift
        mean = _mean(sums, shares, (1 - q) / epsilon)
        alpha = np.maximum(delta - q * mean / epsilon if debias else -mean / epsilon, FAINTEST)
        if debias:
            delta = 0.5 * (delta + alpha + q * softmin(places, places, epsilon * delta) / epsilon)
            f = [epsilon * alpha + q * each for each in sums]
        else:
            f = [q * (epsilon * alpha + each) for each in sums]
        before, weights = weights, even * np.exp(alpha)
        change = float(np.abs(weights - before).sum() / weights.sum())
        residuals.append(max(error, change) if number else 1.0)
        done = residuals[-1] <= tol
        report(1.0 if done else (number + 1) / max_iter)
        if done:
            break
    check_mass(weights, float(even.sum()))
    status = "converged" if residuals[-1] <= tol else "max_iter"
    if q == 1:
        weights *= even.sum() / weights.sum()
    grid = support.with_masses(weights) if isinstance(support, Grid) else None
    return Barycenter(
        support.points, weights, None, status, len(residuals), residuals[-1], np.array(residuals),
        grid,
    )  # fmt: skip


def _mean(sums: Sequence[Array], shares: Sequence[float], power: float) -> Array:
    """Return -log(sum_k w_k exp(-power t_k)) / power, which is the mean for the power 0."""
    mean = sum(share * each for share, each in zip(shares, sums, strict=True))
    if not power:
        return np.asarray(mean)
    least = np.minimum.reduce(sums)
    terms = (
        share * np.expm1(power * (least - each)) for share, each in zip(shares, sums, strict=True)
    )
    return least - np.log1p(sum(terms)) / power


def _log_mass(weights: Array, potential: Array, rho: float) -> float:
    """Return log sum_i a_i exp(-f_i / rho)."""
    exponents = potential / -rho
    top = exponents.max()
    return float(top + np.log(weights @ np.exp(exponents - top)))
