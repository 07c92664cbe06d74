"""The paper's transport (2.1, 3.1, Eq. 1 and 2) in plain NumPy float64, dense.

This module iterates plain Sinkhorn from zero, forms the whole plan, and evaluates values by their
definitions.
"""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array
from clmorph.errors import InputError
from clmorph.measures.measure import Measure
from clmorph.measures.points import AnyMeasure, MeasureLike, as_measures
from clmorph.transport.certificate import Certificate
from clmorph.transport.options import PlanOptions, Reach, SolverOptions
from clmorph.transport.plan_building import no_pair_kept
from clmorph.transport.potentials import Potentials, check_potentials
from clmorph.transport.regularization import Goal, regularization

#: Largest number of pairs of a dense plan; coordinate differences alone then take 1.3 GB.
MAX_PAIRS = 1 << 25


def cost_matrix(source: MeasureLike, target: MeasureLike) -> Array:
    """Return the cost C_ij = |X_i - Y_j|^2 / 2 (paper, Eq. 1, with the factor 1/2).

    With a metric of color M_i for each source pixel (paper, 5) it is
    |x_i - y_j|^2 / 2 + lambda^2 (c_i - d_j)^T M_i (c_i - d_j) / 2.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights (N,), points (N, D))

    Returns
    -------
    (N, M) array
        Costs in the square of the points' unit.

    Raises
    ------
    InputError
        If the arguments are not measures, their dimensions differ, or there are too many pairs for
        a dense matrix.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph import reference
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> reference.cost_matrix(source, target).tolist()
    [[0.03125, 0.28125], [0.03125, 0.03125], [0.28125, 0.03125]]
    """
    source, target = as_measures(source, target)
    if len(source) * len(target) > MAX_PAIRS:
        raise InputError(
            f"{len(source)} x {len(target)} pairs are too many for a dense plan: expected at most "
            f"{MAX_PAIRS}; reduce the images, or use clmorph.morph"
        )
    if isinstance(source, Measure) and isinstance(target, Measure) and source.has_metric_map:
        difference = source.positions[:, None] - target.positions
        cost = 0.5 * np.sum(difference**2, axis=2)
        difference = source.coordinates[:, None] - target.coordinates
        metric = source.color_weight**2 * np.asarray(source.color_metric)
        cost += 0.5 * np.einsum("ijk,ikl,ijl->ij", difference, metric, difference)
        return cost
    return 0.5 * np.sum((source.points[:, None, :] - target.points[None, :, :]) ** 2, axis=2)


def _log_sum_exp(values: Array, axis: int) -> Array:
    largest = values.max(axis=axis, keepdims=True)
    total = np.log(np.sum(np.exp(values - largest), axis=axis))
    return total + np.squeeze(largest, axis=axis)


def _log(weights: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(weights)


def sinkhorn(
    source: MeasureLike,
    target: MeasureLike,
    blur: float | None = None,
    reach: Reach = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
) -> Potentials:
    """Iterate f = Delta T(g), g = Delta T(f) from zero until the residual is `tol` (paper, 3.1).

    Parameters
    ----------
    source, target, blur, reach, tol, max_iter, epsilon, rho
        As in `clmorph.sinkhorn`.

    Returns
    -------
    Potentials

    Raises
    ------
    InputError
        If an argument cannot be used, or there are too many pairs for a dense plan.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph import reference
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> potentials = reference.sinkhorn(source, target, blur=0.1, reach=0.3, tol=1e-9)
    >>> potentials.converged, round(potentials.transported_mass, 3)
    (True, 0.828)
    """
    given = regularization(blur, reach, epsilon, rho, tol, max_iter)
    tol, max_iter = given.tol, given.max_iter
    source, target = as_measures(source, target)
    epsilon = given.epsilon
    # Delta = rho / (rho + epsilon), the proximal step of the marginal penalty (math: damping)
    damping = [1.0 if np.isinf(value) else value / (value + epsilon) for value in given.rho]
    cost = cost_matrix(source, target)
    log_a, log_b = _log(source.weights), _log(target.weights)
    # T(g)_i = -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon) (paper, 3.1; math: softmin)
    g = np.zeros(len(target))
    f_next = -damping[0] * epsilon * _log_sum_exp((g - cost) / epsilon + log_b, 1)
    n_iter, residual = 0, np.inf
    residuals = []
    while n_iter < max_iter and residual > tol:
        f = f_next
        t_f = -epsilon * _log_sum_exp((f[:, None] - cost) / epsilon + log_a[:, None], 0)
        g = damping[1] * t_f
        f_next = -damping[0] * epsilon * _log_sum_exp((g - cost) / epsilon + log_b, 1)
        # g is exact for this f, so the residual is the error of f alone (math: residual).
        residual = float(np.max(np.abs(f_next - f)[source.weights > 0])) / epsilon
        residuals.append(residual)
        n_iter += 1
    return Potentials(
        f, g, given.blur, given.reach, "converged" if residual <= tol else "max_iter",
        f"plain iteration, residual {residual:.1e} epsilon", n_iter, residual,
        np.array(residuals), certificate(source, target, f, g, given), precise=True,
    )  # fmt: skip


def certificate(
    source: AnyMeasure, target: AnyMeasure, f: Array, g: Array, given: Goal
) -> Certificate:
    """Evaluate the primal and the dual of the problem (paper, 2.1) on the dense plan.

    primal = <C, pi> + rho KL(pi 1|a) + rho KL(pi^T 1|b) + epsilon KL(pi|a x b) (math: primal) of a
    plan that has the marginals of balanced sides, see `_feasible`.

    dual = rho <a, 1 - exp(-f/rho)> + rho <b, 1 - exp(-g/rho)> - epsilon (m_pi - m_a m_b) (math:
    dual), where <a, f> or <b, g> stands in place of the term of a balanced side.
    """
    epsilon = given.epsilon
    a, b = source.weights, target.weights
    plan = _exp(_log_plan(source, target, f, g, epsilon))
    reference = np.outer(a, b)
    dual = -epsilon * (float(plan.sum()) - float(reference.sum()))
    feasible = _feasible(plan, a, b, given)
    primal = float(np.sum(cost_matrix(source, target) * feasible))
    primal += epsilon * _kullback_leibler(feasible, reference)
    marginal_error = 0.0
    for axis, (potential, weights, rho) in enumerate(zip((f, g), (a, b), given.rho, strict=True)):
        if np.isinf(rho):
            dual += float(weights @ potential)
            marginal_error += float(np.abs(plan.sum(axis=1 - axis) - weights).sum())
        else:
            dual += rho * float(weights @ (1 - np.exp(-potential / rho)))
            primal += rho * _kullback_leibler(feasible.sum(axis=1 - axis), weights)
    return Certificate(
        primal, dual, primal - dual, marginal_error, plan.sum(axis=1), plan.sum(axis=0),
        float(plan.sum()), (float(a.sum()), float(b.sum())),
    )  # fmt: skip


def _feasible(plan: Array, a: Array, b: Array, given: Goal) -> Array:
    """Return a plan near this one that has the marginals of balanced sides.

    For two balanced sides the method is that of Altschuler, Weed, Rigollet, "Near-linear time
    approximation algorithms for optimal transport via Sinkhorn iteration" (2017).
    """
    balanced = [bool(np.isinf(rho)) for rho in given.rho]
    if balanced == [True, False]:
        return plan * _share(a, plan.sum(axis=1))[:, None]
    if balanced == [False, True]:
        return plan * _share(b, plan.sum(axis=0))
    if balanced == [True, True]:
        plan = plan * np.minimum(1.0, _share(a, plan.sum(axis=1)))[:, None]
        plan = plan * np.minimum(1.0, _share(b, plan.sum(axis=0)))
        missing = a - plan.sum(axis=1), b - plan.sum(axis=0)
        if missing[0].sum() > 0:
            plan = plan + np.outer(*missing) / missing[0].sum()
    return plan


def _share(weights: Array, marginal: Array) -> Array:
    """Return weights / marginal, and 0 where there is no mass."""
    return np.divide(weights, marginal, out=np.zeros(len(weights)), where=marginal > 0)


def _kullback_leibler(p: Array, q: Array) -> float:
    """Return KL(p | q) = sum p log(p / q) - p + q (paper, 2.1)."""
    positive = p > 0
    linear = float(q.sum() - p.sum())
    return float(np.sum(p[positive] * np.log(p[positive] / q[positive]))) + linear


def transport_plan(
    source: MeasureLike,
    target: MeasureLike,
    potentials: Potentials,
    *,
    log_threshold: float | None = None,
) -> Array:
    """Return the dense plan pi_ij = a_i b_j exp((f_i + g_j - C_ij) / epsilon) (paper, Eq. 2).

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights (N,), points (N, D))
        The measures for which the potentials were computed.
    potentials : Potentials
    log_threshold : float, optional
        The paper's tau (3.1): pairs whose log pi_ij is not above it become 0.

    Returns
    -------
    (N, M) array

    Raises
    ------
    InputError
        If an argument cannot be used, or no pair is above the threshold.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph import reference
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> potentials = reference.sinkhorn(source, target, blur=0.1, reach=0.3, tol=1e-9)
    >>> reference.transport_plan(source, target, potentials).round(3).tolist()
    [[0.27, 0.0], [0.144, 0.144], [0.0, 0.27]]
    """
    log_threshold = PlanOptions.checked("log_threshold", log_threshold)
    source, target = as_measures(source, target)
    check_potentials("potentials", potentials, (len(source), len(target)))
    log_plan = _log_plan(source, target, potentials.f, potentials.g, potentials.epsilon)
    if log_threshold is not None:
        largest = float(log_plan.max())
        if largest <= log_threshold:
            raise no_pair_kept(log_threshold, largest)
        log_plan[log_plan <= log_threshold] = -np.inf
    return _exp(log_plan)


def _exp(log_plan: Array) -> Array:
    with np.errstate(over="ignore"):  # far from a solution masses can be infinite
        return np.exp(log_plan)


def _log_plan(source: AnyMeasure, target: AnyMeasure, f: Array, g: Array, epsilon: float) -> Array:
    # log pi_ij = (f_i + g_j - C_ij) / epsilon + log a_i + log b_j (paper, Eq. 2)
    log_plan = (f[:, None] + g - cost_matrix(source, target)) / epsilon
    return log_plan + (_log(source.weights)[:, None] + _log(target.weights))
