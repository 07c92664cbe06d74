"""Hessian-vector products of transport values and divergences, by implicit differentiation.

Along a direction the plan pi_ij = a_i b_j exp((f_i + g_j - C_ij) / epsilon) changes by

    d pi_ij = pi_ij ((df_i + dg_j - dC_ij) / epsilon + da_i / a_i + db_j / b_j),

and both marginals remain those of the optimum, r_i = a_i exp(-f_i / rho):

    (1 / epsilon + 1 / rho) r_i df_i + sum_j pi_ij dg_j / epsilon
        = sum_j pi_ij (dC_ij / epsilon - db_j / b_j),

and the same for columns. This system is symmetric and positive, but for a constant if balanced, and
is solved by conjugate gradients in float64. The product is the change of `clmorph.gradient`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph._shared.validation import shown
from clmorph.backends.arrays import as_floats
from clmorph.errors import InputError
from clmorph.measures.measure import Measure
from clmorph.measures.points import MeasureLike, Pair, as_pair
from clmorph.transport._solver.plan_softmin import check_marginal
from clmorph.transport.divergence import Divergence
from clmorph.transport.gradient import Gradient, joined_sides
from clmorph.transport.potentials import Potentials, check_potentials

#: Largest number of pairs, whose plan is kept in float64.
MAX_PAIRS = 1 << 27
#: Residual of the linear system, relative to its right side, and the largest number of iterations.
TOLERANCE, ITERATIONS = 1e-12, 20_000
#: Difference of both changes of mass in balanced transport, relative to the sum of their sizes.
MASS_ERROR = 1e-9


def hessian_product(
    source: MeasureLike, target: MeasureLike, solved: Potentials | Divergence, direction: Gradient
) -> Gradient:
    """Return the change of a gradient along a direction: the Hessian times a vector.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, (weights (N,), points (N, D)), or points (N, D)
        The measures of `solved`. Weights must be positive.
    solved : Potentials or Divergence
        Of `clmorph.sinkhorn`, for the second derivatives of the transport value (see
        `clmorph.gradient`), or of `clmorph.sinkhorn_divergence`, for those of the divergence. The
        error is of the size of its residual: a `tol` of 1e-9 with NumPy gives six digits.
    direction : Gradient
        Changes of points and weights of both measures. In balanced transport both changes of the
        mass must be equal.

    Returns
    -------
    Gradient
        The derivative, along the direction, of each derivative by points and weights. If both sides
        are balanced, those by weights have the mean 0.

    Raises
    ------
    InputError
        If an argument cannot be used, there are more than 2^27 pairs, whose plan is kept on the
        host, or the linear system cannot be solved.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> x, y = np.zeros((1, 1)), np.ones((1, 1))
    >>> solved = clmorph.sinkhorn(x, y, 0.1, backend="numpy")
    >>> moved = clmorph.Gradient(np.ones((1, 1)), np.zeros(1), np.zeros((1, 1)), np.zeros(1))
    >>> found = clmorph.hessian_product(x, y, solved, moved)
    >>> found.source_points.tolist(), found.target_points.tolist()  # of (x - y)^2 / 2
    ([[1.0]], [[-1.0]])
    """
    pair = as_pair(source, target)
    if isinstance(source, Measure) and source.has_metric_map:
        raise InputError("the cost has a metric for each source pixel: use one metric for all")
    if not isinstance(solved, Potentials | Divergence):
        raise InputError(f"solved={shown(solved)}: expected Potentials, or a Divergence")
    if any(float(each.weights.min()) <= 0 for each in pair):
        raise InputError("weights must be positive for second derivatives: remove points without")
    changes = _changes(pair, direction)
    if isinstance(solved, Potentials):
        return joined_sides(_product(pair, solved, changes), solved)
    cross = _product(pair, solved.cross, changes)
    # epsilon / 2 (m_a - m_b)^2, of which the weights' derivatives change by a constant.
    more = solved.cross.epsilon * (changes[0][1].sum() - changes[1][1].sum())
    sides = []
    for measure, change, own, there, constant in zip(
        pair, changes, (solved.source_self, solved.target_self), cross, (more, -more), strict=True
    ):
        within = _product((measure, measure), own, (change, change))[0]
        sides.append((there[0] - within[0], there[1] - within[1] + constant))
    return joined_sides(sides, solved.cross)


def _changes(pair: Pair, direction: Any) -> list[tuple[Array, Array]]:
    """Return the checked changes of points, (N, D), and weights, (N,), of both measures."""
    if not isinstance(direction, Gradient):
        raise InputError(f"direction={shown(direction)}: expected a Gradient")
    found = []
    for name, measure in zip(("source", "target"), pair, strict=True):
        points = as_floats(f"direction.{name}_points", getattr(direction, f"{name}_points"))
        weights = as_floats(f"direction.{name}_weights", getattr(direction, f"{name}_weights"))
        shapes = points.shape, weights.shape
        if shapes != (measure.points.shape, measure.weights.shape) or not (
            np.isfinite(points).all() and np.isfinite(weights).all()
        ):
            raise InputError(
                f"direction: {name}_points have shape {shapes[0]}, {name}_weights {shapes[1]}; "
                f"expected finite {measure.points.shape} and {measure.weights.shape}"
            )
        found.append((points, weights))
    return found


def _product(
    pair: Pair, potentials: Potentials, changes: Sequence[tuple[Array, Array]]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the changes of the derivatives by points and weights, for both sides."""
    from scipy.sparse.linalg import LinearOperator, cg  # takes long to import

    n, m = len(pair[0]), len(pair[1])
    check_potentials("solved", potentials, (n, m))
    if n * m > MAX_PAIRS:
        raise InputError(f"{n} x {m} points: expected at most 2^27 pairs for second derivatives")
    epsilon, rho = potentials.epsilon, np.broadcast_to(potentials.rho, 2)
    (x, y), (a, b) = (tuple(getattr(e, k) for e in pair) for k in ("points", "weights"))
    (dx, da), (dy, db) = changes
    balanced = bool(np.isinf(rho).all())
    size = np.abs(da).sum() + np.abs(db).sum()
    if balanced and abs(da.sum() - db.sum()) > MASS_ERROR * size:
        raise InputError("direction: balanced transport needs equal changes of both masses")
    cost, change = np.zeros((n, m)), np.zeros((n, m))
    for axis in range(x.shape[1]):
        apart = x[:, axis, None] - y[:, axis]
        cost += apart**2 / 2
        change += apart * (dx[:, axis, None] - dy[:, axis])
    for offsets, shape in ((pair[0].offsets, (n, 1)), (pair[1].offsets, (1, m))):
        cost += 0.0 if offsets is None else offsets.reshape(shape)
    plan = np.exp((potentials.f[:, None] + potentials.g - cost) / epsilon) * a[:, None] * b
    r, c = plan.sum(axis=1), plan.sum(axis=0)
    nats = 2.0 * potentials.truncation_error + (potentials.truncation or 0.0)
    for told, mass in ((potentials.row_mass, r), (potentials.column_mass, c)):
        check_marginal("solved: potentials", told, mass, nats)
    moved = plan * change
    right = np.concatenate(
        (moved.sum(axis=1) - epsilon * (plan @ (db / b)),
         moved.sum(axis=0) - epsilon * (da / a @ plan))
    )  # fmt: skip
    if balanced:
        # Opposite constants change nothing; errors of the marginals are no change of these.
        off = (right[:n].sum() - right[n:].sum()) / (n + m)
        right[:n] -= off
        right[n:] += off
    diagonal = np.concatenate((r * (1 + epsilon / rho[0]), c * (1 + epsilon / rho[1])))

    def applied(v: Array) -> Array:
        v = v.ravel()
        return diagonal * v + np.concatenate((plan @ v[n:], v[:n] @ plan))

    def scaled(v: Array) -> Array:
        return v.ravel() / diagonal

    if np.isfinite(diagonal).all() and diagonal.min() > 0:
        system, preconditioner = (
            LinearOperator((n + m,) * 2, matvec=each, dtype=float) for each in (applied, scaled)
        )
        both, status = cg(system, right, rtol=TOLERANCE, maxiter=ITERATIONS, M=preconditioner)
    else:
        both, status = right, 1
    left = np.abs(applied(both) - right).max()
    if status != 0 and not left <= 1e-8 * np.abs(right).max():
        raise InputError(
            "the linear system of the second derivatives is nearly singular; raise blur"
        )
    df, dg = both[:n], both[n:]
    plan_change = plan * ((df[:, None] + dg - change) / epsilon + (da / a)[:, None] + db / b)
    points = (
        plan_change.sum(axis=1)[:, None] * x - plan_change @ y + r[:, None] * dx - plan @ dy,
        plan_change.sum(axis=0)[:, None] * y - plan_change.T @ x + c[:, None] * dy - plan.T @ dx,
    )
    weights = [
        (1 + epsilon / each) * np.exp(-potential / each) * step + epsilon * other.sum()
        for potential, step, each, other in zip(
            (potentials.f, potentials.g), (df, dg), rho, (db, da), strict=True
        )
    ]
    return (points[0], weights[0]), (points[1], weights[1])
