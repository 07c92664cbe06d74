"""OTT-JAX against clmorph in its place: no sdist of OTT's holds its tests, so these are ours.

Each problem is solved by OTT's own loop, to a small threshold, and by the adapter.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ott.geometry import costs, geometry, grid, pointcloud
from ott.problems.linear import linear_problem
from ott.solvers import linear
from ott.solvers.linear import sinkhorn

from peers import bridge
from peers.adapter_ott import replacements

EPSILON = 0.1
TAUS = [(1.0, 1.0), (0.9, 0.9), (0.95, 0.7), (1.0, 0.8), (0.6, 1.0)]


def measures(dimension: int = 3) -> tuple[Any, Any, Any, Any]:
    """Return points and weights, a zero among them."""
    rng = np.random.default_rng(dimension)
    x, y = rng.random((13, dimension)), rng.random((17, dimension)) + 0.2
    a, b = rng.random(13), rng.random(17)
    a[0] = b[3] = 0.0
    return x, y, a / a.sum(), b / b.sum()


def make(kind: str) -> tuple[Any, Any, Any]:
    """Return a geometry and weights."""
    if kind == "grid":
        axes = [jnp.linspace(0, 1, 4), jnp.linspace(0, 1, 5)]
        rng = np.random.default_rng(1)
        a, b = rng.random((2, 20))
        return grid.Grid(axes, epsilon=EPSILON), a / a.sum(), b / b.sum()
    x, y, a, b = measures(14 if kind == "14 dimensions" else 3)
    # Twelve points: whatever their costs, these are of rank 11 at most.
    if kind == "any matrix":
        matrix = np.random.default_rng(2).random((12, 17))
        return geometry.Geometry(jnp.asarray(matrix), epsilon=EPSILON), a[1:] / a.sum(), b
    if kind == "14 dimensions":
        return pointcloud.PointCloud(x[1:], y, epsilon=EPSILON), a[1:], b
    if kind == "matrix":
        matrix = pointcloud.PointCloud(x, y).cost_matrix
        return geometry.Geometry(matrix, epsilon=EPSILON), a, b
    if kind == "negative dot":
        return pointcloud.PointCloud(x, y, costs.NegDotProduct(), epsilon=EPSILON), a, b
    return pointcloud.PointCloud(x, y, epsilon=EPSILON), a, b


KINDS = ["points", "14 dimensions", "matrix", "any matrix", "negative dot", "grid"]


def both(solve: Any) -> tuple[Any, Any]:
    """Return what OTT answers, and what it does with clmorph in place of its loop."""
    ours = solve()
    with bridge.replaced("ott", {new: old for old, new in ORIGINALS}):
        return solve(), ours


ORIGINALS: list[tuple[Any, Any]] = []


@pytest.fixture(autouse=True, scope="module")
def adapter() -> Any:
    """Put the adapter in place, and remember what it stands for."""
    given = [(sinkhorn.iterations, 0), (sinkhorn._iterations_implicit, 1)]
    stand_ins = [
        functools.partial(new) for new in replacements().values()
    ]  # told apart by identity
    ORIGINALS[:] = [(old, stand_ins[number]) for old, number in given]
    with bridge.replaced("ott", dict(ORIGINALS)):
        yield


def compare(theirs: Any, ours: Any, balanced: bool) -> None:
    """Compare two outputs of OTT's."""
    names = ["reg_ot_cost", "ent_reg_cost", "transport_mass"]
    if not isinstance(theirs.geom, grid.Grid):  # whose plan OTT does not form
        names += ["matrix", "primal_cost"]
    for name in names:
        one, other = (np.asarray(getattr(each, name)) for each in (theirs, ours))
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-6, err_msg=name)
    f, g = (np.asarray(theirs.f - ours.f), np.asarray(theirs.g - ours.g))
    f, g = f[np.isfinite(f)], g[np.isfinite(g)]
    if balanced:
        f, g = f - f.mean(), g - g.mean()
    np.testing.assert_allclose(f, 0, atol=3e-5)
    np.testing.assert_allclose(g, 0, atol=3e-5)
    assert bool(ours.converged)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("tau_a", "tau_b"), TAUS)
@pytest.mark.parametrize("compiled", [False, True])
def test_linear_solve(kind: str, tau_a: float, tau_b: float, compiled: bool) -> None:
    """The one face of OTT's linear solvers, as it is and compiled."""
    geom, a, b = make(kind)

    def solve() -> Any:
        def run(geom: Any, a: Any, b: Any) -> Any:
            return linear.solve(
                geom, a, b, tau_a=tau_a, tau_b=tau_b, threshold=1e-6, max_iterations=20000
            )

        return (jax.jit(run) if compiled else run)(geom, jnp.asarray(a), jnp.asarray(b))

    compare(*both(solve), balanced=tau_a == tau_b == 1.0)


def test_solver_class() -> None:
    geom, a, b = make("points")
    problem = linear_problem.LinearProblem(geom, jnp.asarray(a), jnp.asarray(b), 0.9, 0.8)
    compare(*both(lambda: sinkhorn.Sinkhorn(threshold=1e-6)(problem)), balanced=False)


def test_high_rank_is_declined() -> None:
    matrix = jnp.asarray(np.random.default_rng(0).random((20, 20)))
    with pytest.raises(bridge.Declined, match="rank"):
        linear.solve(geometry.Geometry(matrix, epsilon=EPSILON))
