"""Compare barycenters with those of POT and OTT-JAX: ``python tools/compare_barycenters.py``.

    pip install -e ".[cpu,bench]"

Three random densities on a grid (fixed support), and three random clouds of the same size
(free support, not debiased, as the others have it). For a fixed support the table has the largest
difference of masses relative to the largest mass and, if debiased, the mean divergence, which a
barycenter minimizes, relative to ours. For a free one it has the mean transport value to the three
clouds by an independent solve, relative to ours: below 1 the other one found a better minimum.
Libraries that are not installed are left out.
"""

import argparse
import importlib.util
import warnings

import numpy as np
from scipy.ndimage import gaussian_filter

import clmorph

BLUR, SIDE, POINTS, SHARES = 0.1, 20, 40, np.array([0.5, 0.3, 0.2])


def densities() -> np.ndarray:
    """Return three smooth densities (3, SIDE, SIDE) of mass 1."""
    rng = np.random.default_rng(0)
    fields = [gaussian_filter(rng.random((SIDE, SIDE)) ** 8, 2.0) ** 3 for _ in SHARES]
    return np.array([field / field.sum() for field in fields])


def grid() -> np.ndarray:
    """Return the points of the grid, (SIDE^2, 2)."""
    return clmorph.density(np.ones((SIDE, SIDE))).points


def clouds() -> np.ndarray:
    """Return three clouds (3, POINTS, 2)."""
    rng = np.random.default_rng(1)
    return np.array([rng.random((POINTS, 2)) @ rng.normal(size=(2, 2)) for _ in SHARES])


def ott_fixed(fields: np.ndarray, debiased: bool) -> np.ndarray:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    from ott.geometry.pointcloud import PointCloud
    from ott.problems.linear.barycenter_problem import FixedBarycenterProblem
    from ott.solvers.linear.discrete_barycenter import FixedBarycenter

    problem = FixedBarycenterProblem(
        PointCloud(jnp.asarray(grid()), epsilon=2 * BLUR**2),
        jnp.asarray(fields.reshape(len(SHARES), -1)), jnp.asarray(SHARES),
    )  # fmt: skip
    # In the log domain its debiased barycenter is farther off.
    solver = FixedBarycenter(
        threshold=1e-12, max_iterations=5000, min_iterations=1000, debiased=debiased,
        lse_mode=not debiased,
    )  # fmt: skip
    return np.asarray(solver(problem).histogram)


def pot_fixed(fields: np.ndarray, debiased: bool) -> np.ndarray:
    import ot

    solve = ot.bregman.barycenter_debiased if debiased else ot.bregman.barycenter
    # Without debiasing the default method begins wrongly if shares are unequal (POT's PR 870).
    method = {} if debiased else {"method": "sinkhorn_log"}
    return solve(
        fields.reshape(len(SHARES), -1).T, ot.dist(grid(), grid()), 2 * BLUR**2, weights=SHARES,
        stopThr=1e-12, numItermax=5000, **method,
    )  # fmt: skip


def mean_divergence(weights: np.ndarray, fields: np.ndarray) -> float:
    """Return what a debiased barycenter minimizes."""
    flat, points = fields.reshape(len(SHARES), -1), grid()
    values = [
        clmorph.sinkhorn_divergence(
            (weights / weights.sum(), points), (field, points), BLUR, None, 1e-8, 10**4, "numpy"
        ).value
        for field in flat
    ]
    return float(SHARES @ values)


def ott_free(points: np.ndarray, start: np.ndarray) -> np.ndarray:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    from ott.problems.linear.barycenter_problem import FreeBarycenterProblem
    from ott.solvers.linear.continuous_barycenter import FreeWassersteinBarycenter
    from ott.solvers.linear.sinkhorn import Sinkhorn

    count = len(start)
    problem = FreeBarycenterProblem(
        jnp.asarray(points.reshape(-1, 2)),
        jnp.full(points.shape[0] * count, 1 / count),
        weights=jnp.asarray(SHARES),
        num_per_segment=(count,) * len(SHARES),
        epsilon=2 * BLUR**2,
    )
    solver = FreeWassersteinBarycenter(
        Sinkhorn(threshold=1e-6, max_iterations=5000), threshold=1e-7, max_iterations=100
    )
    return np.asarray(solver(problem, bar_size=count, x_init=jnp.asarray(start)).x)


def mean_value(points: np.ndarray, of: np.ndarray) -> float:
    """Return the mean transport value from points to the clouds."""
    weights = np.full(len(points), 1 / len(points))
    values = [
        clmorph.sinkhorn((weights, points), (weights, each), BLUR, None, 1e-8, 10**4, "numpy").dual
        for each in of
    ]
    return float(SHARES @ values)


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    warnings.simplefilter("ignore")
    fields, points = densities(), clouds()
    flat = [(field.ravel(), grid()) for field in fields]
    fixed = {
        debias: clmorph.barycenter(
            flat, SHARES, support=grid(), fixed=True, blur=BLUR, tol=1e-6, max_iter=5000,
            backend="numpy", debias=debias,
        )
        for debias in (True, False)
    }  # fmt: skip
    weights = np.full(POINTS, 1 / POINTS)
    free = clmorph.barycenter(
        [(weights, each) for each in points], SHARES, support=points[0], blur=BLUR, tol=1e-4,
        max_iter=500, backend="numpy", debias=False,
    )  # fmt: skip
    print("| support | compared with | |\n|---|---|---|")
    for name, module, function in (("OTT-JAX", "ott", ott_fixed), ("POT", "ot", pot_fixed)):
        if importlib.util.find_spec(module) is None:
            continue
        for debias, ours in fixed.items():
            theirs = function(fields, debias)
            told = (
                f"masses differ by {np.abs(theirs - ours.weights).max() / ours.weights.max():.1e}"
            )
            if debias:
                ratio = mean_divergence(theirs, fields) / mean_divergence(ours.weights, fields)
                told += f", mean divergence {ratio:.8f} of ours"
            print(f"| fixed{', debiased' * debias} | {name} | {told} |", flush=True)
    if importlib.util.find_spec("ott") is not None:
        found = ott_free(points, points[0])
        ratio = mean_value(found, points) / mean_value(free.points, points)
        off = np.abs(found - free.points).max()
        print(f"| free | OTT-JAX | value {ratio:.6f} of ours, points within {off:.1e} |")


if __name__ == "__main__":
    main()
