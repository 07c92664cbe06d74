"""Balanced barycenters on given points: iterative Bregman projections in the log domain.

Between the support x_i and each measure b_k stands the plan

    pi_k,ij = exp((f_k,i + g_k,j - C_ij) / epsilon) b_k,j.

In turn the plans are projected onto those that arrive in b_k, and onto those that leave one common
measure a (Benamou, Carlier, Cuturi, Nenna, Peyré, "Iterative Bregman projections for regularized
transportation problems", SIAM Journal on Scientific Computing 37(2), 2015, section 3.2):

    g_k <- T(f_k),    log a = log d - sum_k w_k T(g_k) / epsilon,    f_k <- epsilon log a + T(g_k).

With d = 1 they minimize, over a and over plans pi_k from a to b_k,

    sum_k w_k (<C, pi_k> + epsilon KL(pi_k | 1 x b_k)):

the reference of the entropy is the counting measure of the support in place of a, for which
`clmorph.sinkhorn` has a x b_k. Diracs b_k at y_k have a ~ exp(-sum_k w_k C(x, y_k) / epsilon), so
that the barycenter is blurred by the kernel. With debiasing d is the scaling of the plan of a
to itself, d (K d) = a, for which each iteration takes the step d <- sqrt(d a / (K d)) (Janati,
Cuturi, Gramfort, "Debiased Sinkhorn barycenters", ICML 2020, algorithm 1).

All sums over points are soft minima of a backend, so no matrix is stored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, Progress
from clmorph.backends.interface import Operations
from clmorph.measures.grid import Grid, are_grids
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.grid_softmin import GridSoftmin
from clmorph.transport.barycenters.result import Barycenter

#: The smallest logarithm of a mass, in nats below the mean: the square root of float64's range.
FAINTEST = -350.0


def fixed_support(
    measures: Sequence[AnyMeasure],
    shares: Sequence[float],
    support: AnyMeasure,
    epsilon: float,
    debias: bool,
    tol: float,
    max_iter: int,
    operations: Operations,
    report: Progress,
) -> Barycenter:
    """Return the barycenter's weights on given points.

    measures: of equal masses; shares: positive shares of the measures, with the sum 1; support:
    points of any masses, or a grid whose mask counts; report: called with the share of the work
    that is done.
    """
    mass = float(measures[0].weights.sum())
    unit = np.ones(len(support))
    places: Any
    clouds: list[Any]
    softmin: Callable[[Any, Any, Array], Array]
    if isinstance(support, Grid) and are_grids(*measures):
        if support.mask is not None:
            unit = support.mask.reshape(-1).astype(float)
        places, clouds = replace(support, masses=unit.reshape(support.shape)), list(measures)

        def softmin(rows: Any, columns: Any, potential: Array) -> Array:
            return GridSoftmin(operations, rows, columns)(potential, epsilon, precise=True)

    else:
        places = operations.upload(support.points, unit)
        clouds = [operations.upload(each.points, each.weights) for each in measures]

        def softmin(rows: Any, columns: Any, potential: Array) -> Array:
            return operations.softmin(rows, columns, potential, epsilon, precise=True)

    f = [np.zeros(len(unit)) for _ in measures]
    g: list[Array] = [np.zeros(0)] * len(measures)
    log_d = np.zeros(len(unit))
    log_a = np.full(len(unit), np.log(mass / unit.sum()))
    lowest = float(log_a[0]) + FAINTEST
    residuals: list[float] = []
    for number in range(max_iter):
        sums, error = [], 0.0
        for k, (cloud, measure) in enumerate(zip(clouds, measures, strict=True)):
            arriving = softmin(cloud, places, f[k])
            if number:
                # The plan before this projection arrives in b exp((g_before - g_now) / epsilon).
                miss = np.expm1(np.minimum((g[k] - arriving) / epsilon, 50.0))
                error = max(error, float(measure.weights @ np.abs(miss)) / mass)
            g[k] = arriving
            sums.append(softmin(places, cloud, arriving))
        before = log_a
        log_a = (
            log_d - sum(share * each for share, each in zip(shares, sums, strict=True)) / epsilon
        )
        log_a = np.maximum(log_a, lowest)
        if debias:
            log_d = 0.5 * (log_d + log_a + softmin(places, places, epsilon * log_d) / epsilon)
        f = [epsilon * log_a + each for each in sums]
        change = float(unit @ np.abs(np.exp(log_a) - np.exp(before))) / mass
        residuals.append(max(error, change) if number else 1.0)
        done = residuals[-1] <= tol
        report(1.0 if done else (number + 1) / max_iter)
        if done:
            break
    status = "converged" if residuals[-1] <= tol else "max_iter"
    weights = unit * np.exp(log_a)
    weights *= mass / weights.sum()
    grid = support.with_masses(weights) if isinstance(support, Grid) else None
    return Barycenter(
        support.points, weights, None, status, len(residuals), residuals[-1], np.array(residuals),
        grid,
    )  # fmt: skip
