"""Barycenters whose points move.

The barycenter of measures b_k with the shares w_k minimizes F(a) = sum_k w_k S(a, b_k), where S is
the Sinkhorn divergence, or the entropic transport value OT itself without debiasing. With
r_k,i = a_i R_k,i, the mass that leaves point x_i for b_k, and T_k(x_i), the mean of where it goes,
and with R_s and T_s those of the transport of a to itself (`clmorph.transport.gradient`),

    dF / dx_i = a_i [sum_k w_k R_k,i (x_i - T_k(x_i)) - R_s,i (x_i - T_s(x_i))],
    dF / da_i = (rho + epsilon) [R_s,i - sum_k w_k R_k,i].

A step moves each point by its derivative over the mass that leaves it, which for OT is the mean
x_i <- sum_k w_k T_k(x_i) (Cuturi and Doucet, "Fast computation of Wasserstein barycenters", ICML
2014, algorithm 2). If masses are not fixed by balanced transport, a step multiplies a_i by
sum_k w_k R_k,i / R_s,i, whose fixed points are those where dF / da_i = 0. For Diracs at one place
it converges to the power mean a^kappa = sum_k w_k b_k^kappa, kappa = (rho + epsilon) /
(2 rho + epsilon), at the rate 1 - kappa.

Without debiasing points shrink together: OT(a, b) is least for an a narrower than b. Séjourné,
Feydy, Vialard, Trouvé and Peyré, "Sinkhorn divergences for unbalanced optimal transport" (2019);
Janati, Cuturi and Gramfort, "Debiased Sinkhorn barycenters", ICML 2020, section 3.
"""

import numpy as np

from clmorph._shared.typing import Progress
from clmorph.backends.interface import Operations
from clmorph.measures.points import WeightedPoints
from clmorph.transport._solver.annealing import ignore
from clmorph.transport._solver.plan_softmin import RowsOfPlan
from clmorph.transport._solver.problem import uploaded
from clmorph.transport.barycenters.result import Barycenter, BarycenterProblem, Call, check_mass
from clmorph.transport.potentials import Potentials
from clmorph.transport.sinkhorn import solve

#: Residual of the solves, in units of epsilon, and its largest share of the tolerance.
INNER_TOL, INNER_SHARE = 1e-4, 0.1
#: Largest number of iterations of a solve.
INNER_ITERATIONS = 2000
#: Largest factor by which a mass changes in one step.
MOST_GROWTH = 10.0
#: Shares of mass that are too small to divide by.
TINY = 1e-100


def free_support(
    problem: BarycenterProblem, call: Call, operations: Operations, report: Progress
) -> Barycenter:
    """Move points, and change their masses unless transport is balanced, until they rest."""
    measures, shares, start = problem
    goal, tol, debias = call.goal, call.goal.tol, call.debias
    epsilon, rho = goal.epsilon, goal.rho[0]
    balanced = bool(np.isinf(rho))
    inner = goal._replace(tol=min(INNER_TOL, INNER_SHARE * tol), max_iter=INNER_ITERATIONS)
    points, weights = start.points.copy(), start.weights.copy()
    found: list[Potentials | None] = [None] * len(measures)
    clouds = [uploaded(operations, measure) for measure in measures]
    residuals: list[float] = []
    mass = float(np.dot(shares, [each.mass for each in measures]))
    for number in range(goal.max_iter):
        here = WeightedPoints(points, weights)
        cloud = uploaded(operations, here)
        inexact = 0.0
        ratio, pull = np.zeros(len(points)), np.zeros_like(points)
        for k, (measure, share) in enumerate(zip(measures, shares, strict=True)):
            before, both = found[k], (cloud, clouds[k])
            g = None if before is None else before.g
            solved = solve(operations, (here, measure), inner, ignore, clouds=both, g=g)
            found[k], inexact = solved, max(inexact, solved.residual)
            going = RowsOfPlan(operations, (here, measure), solved, both).sent()
            ratio += share * going.ratio
            pull += (share * going.ratio)[:, None] * (going.mean - points)
        if debias:
            own = solve(operations, (here, here), inner, ignore)
            inexact = max(inexact, own.residual)
            within = RowsOfPlan(operations, (here, here), own, (cloud, cloud)).sent()
            pull -= within.ratio[:, None] * (within.mean - points)
            growth = np.divide(
                ratio, within.ratio, out=np.full(len(ratio), MOST_GROWTH), where=within.ratio > TINY
            )
        else:
            growth = ratio if balanced else ratio * (rho + epsilon) / (rho + epsilon * mass)
        # Points from which nothing travels stay, and their masses vanish.
        there = (ratio > TINY)[:, None]
        step = np.divide(pull, ratio[:, None], out=np.zeros_like(pull), where=there)
        changed = weights
        if not balanced:
            changed = weights * np.clip(growth, 1 / MOST_GROWTH, MOST_GROWTH)
            check_mass(changed, mass)
        moved = float(np.sqrt(weights @ (step**2).sum(axis=1) / weights.sum())) / goal.blur
        change = max(moved, float(np.abs(changed - weights).sum() / weights.sum()))
        residuals.append(max(change, inexact))
        points, weights = points + step, changed
        # Points that rest by inexact solves would rest in the next iteration, too.
        done = change <= tol
        report(1.0 if done else (number + 1) / goal.max_iter)
        if done:
            break
    status = "converged" if residuals[-1] <= tol else ("precision" if done else "max_iter")
    return Barycenter(
        points, weights, None, status, len(residuals), residuals[-1], np.array(residuals)
    )
