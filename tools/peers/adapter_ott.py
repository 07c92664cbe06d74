"""OTT-JAX's Sinkhorn loop, solved by clmorph.

`sinkhorn.Sinkhorn` ends in `iterations`, and so does `linear.solve`. OTT's epsilon is in the unit
of its cost, tau = rho / (rho + epsilon), and the entropy is that against the counting measure, not
against a x b: f = tau (epsilon log a - epsilon log sum_j exp((g_j - C_ij) / epsilon)). That is
clmorph's problem with epsilon (log a_i + log b_j) added to the cost, and the same potentials. In
balanced transport the plan is the same either way; otherwise it is not. Under jit and vmap
clmorph is called back from the compiled program; a gradient through the loop is declined.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from ott.solvers.linear import sinkhorn

from peers.bridge import TALLY, Array, Declined, solve_matrix

PACKAGE = "ott"


def rho_of(epsilon: float, tau: float) -> float:
    """Return the marginal strength that OTT's tau stands for; 1 is balanced."""
    return np.inf if tau == 1.0 else epsilon * tau / (1.0 - tau)


def solve(
    cost: Any, a: Any, b: Any, epsilon: Any, tau_a: Any, tau_b: Any
) -> tuple[Array, Array, Array, Array]:
    """Return f, g, the residual and whether it is small: what OTT's loop ends with."""
    cost, a, b = (np.asarray(value) for value in (cost, a, b))
    strength = float(np.asarray(epsilon))
    rho = (rho_of(strength, float(tau_a)), rho_of(strength, float(tau_b)))
    answer = solve_matrix(cost, a, b, strength, rho, counting=True)
    f = np.where(a > 0, answer.f, -np.inf)
    g = np.where(b > 0, answer.g, -np.inf)
    found = answer.potentials
    done = found.status in ("converged", "precision")
    kind = cost.dtype
    return f.astype(kind), g.astype(kind), np.asarray(found.residual, kind), np.asarray(done)


def _called_back(*values: Any) -> tuple[Array, Array, Array, Array]:
    """Solve from inside a compiled program, through which no exception finds its way."""
    try:
        return solve(*values)
    except Declined as declined:
        TALLY.declined = declined.reason
        cost = np.asarray(values[0])
        nan = [np.full(size, np.nan, cost.dtype) for size in cost.shape]
        return nan[0], nan[1], np.asarray(np.nan, cost.dtype), np.asarray(False)


def _values(ot_prob: Any) -> tuple[Any, ...]:
    geom = ot_prob.geom
    try:
        cost = geom.cost_matrix
    except NotImplementedError:  # of a grid, whose costs are never all there
        cost = geom.apply_cost(jnp.eye(geom.shape[1]), axis=1)
    return cost, ot_prob.a, ot_prob.b, ot_prob.epsilon, ot_prob.tau_a, ot_prob.tau_b


def iterations(ot_prob: Any, solver: Any, init: Any) -> Any:
    """Stand for OTT's loop, compiled or not."""
    values = _values(ot_prob)
    if any(isinstance(value, jax.core.Tracer) for value in values):
        return _finish(solver, _compiled(*values))
    return _finish(solver, tuple(jnp.asarray(each) for each in solve(*values)))


@jax.custom_jvp
def _compiled(*values: Any) -> Any:
    cost = jnp.asarray(values[0])
    shapes = (
        jax.ShapeDtypeStruct((cost.shape[0],), cost.dtype),
        jax.ShapeDtypeStruct((cost.shape[1],), cost.dtype),
        jax.ShapeDtypeStruct((), cost.dtype),
        jax.ShapeDtypeStruct((), jnp.bool_),
    )
    return jax.pure_callback(_called_back, shapes, *values, vmap_method="sequential")


@_compiled.defjvp
def _no_gradient(primals: Any, tangents: Any) -> Any:
    raise Declined("gradients through jax")


def _finish(solver: Any, found: Any) -> Any:
    f, g, residual, done = found
    errors = -jnp.ones(solver.outer_iterations, f.dtype).at[0].set(-residual)
    return sinkhorn.SinkhornOutput(
        potentials=(f, g), errors=errors, threshold=solver.threshold, converged=done,
        inner_iterations=solver.inner_iterations,
    )  # fmt: skip


def replacements() -> dict[Any, Any]:
    """Return what stands for OTT's loop, with and without implicit gradients."""
    return {sinkhorn.iterations: iterations, sinkhorn._iterations_implicit: iterations}
