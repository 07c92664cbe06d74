"""Solvers of other libraries, with which `bench_solver.py` compares.

Each returns a function that solves, and gives f, g (ours: the plan is exp((f + g - C) / epsilon)
a b) and its number of iterations.
"""

import numpy as np

BLUR, REACH = 0.05, 0.3
EPSILON, RHO = BLUR**2, REACH**2


def geomloss(backend: str):
    """GeomLoss, at the paper's scaling."""
    import torch
    from geomloss import SamplesLoss

    loss = SamplesLoss(
        "sinkhorn", p=2, blur=BLUR, reach=REACH, scaling=0.9, debias=False, potentials=True,
        backend=backend,
    )  # fmt: skip

    def solve(source, target):
        tensors = [
            torch.tensor(array, dtype=torch.float32)[None] if backend == "tensorized"
            else torch.tensor(array, dtype=torch.float32)
            for array in (source.weights, source.points, target.weights, target.points)
        ]  # fmt: skip
        f, g = loss(*tensors)
        return f.numpy().ravel().astype(float), g.numpy().ravel().astype(float), None

    return solve


def pot(method: str):
    """POT, with the cost of ours (so with our epsilon and rho)."""
    import ot

    def solve(source, target):
        cost = 0.5 * ot.dist(source.points, target.points)
        _, log = ot.unbalanced.sinkhorn_unbalanced(
            source.weights, target.weights, cost, EPSILON, RHO, method=method, reg_type="kl",
            log=True,
        )  # fmt: skip
        return EPSILON * log["logu"], EPSILON * log["logv"], len(log["err"])

    return solve


def ott():
    """OTT-JAX on a point cloud, float32.

    Its entropy is taken against the counting measure; for uniform weights 1 / N that is KL
    against a x b once masses are scaled by N^(-epsilon / rho).
    """
    import jax
    import jax.numpy as jnp
    from ott.geometry.pointcloud import PointCloud
    from ott.problems.linear.linear_problem import LinearProblem
    from ott.solvers.linear.sinkhorn import Sinkhorn

    tau = RHO / (RHO + EPSILON)

    @jax.jit
    def run(x, y, a, b):
        geometry = PointCloud(x, y, epsilon=2 * EPSILON)
        out = Sinkhorn()(LinearProblem(geometry, a, b, tau_a=tau, tau_b=tau))
        return out.f, out.g, out.n_iters

    def solve(source, target):
        n, m = len(source), len(target)
        arguments = [jnp.asarray(part, jnp.float32) for part in (
            source.points, target.points, source.weights * n ** (-EPSILON / RHO),
            target.weights * m ** (-EPSILON / RHO),
        )]  # fmt: skip
        f, g, count = (np.asarray(part, float) for part in run(*arguments))
        return f / 2 + EPSILON * np.log(n), g / 2 + EPSILON * np.log(m), int(count)

    return solve


PEERS = {
    "GeomLoss tensorized": lambda: geomloss("tensorized"),
    "GeomLoss online": lambda: geomloss("online"),
    "OTT-JAX": ott,
    "POT translation invariant": lambda: pot("sinkhorn_translation_invariant"),
    "POT sinkhorn": lambda: pot("sinkhorn"),
}
