"""GeomLoss's Sinkhorn loops, solved by clmorph.

Everything in GeomLoss ends in a Sinkhorn loop: `geomloss.ot` in one, `SamplesLoss` in another.
Both get logarithms of weights, costs as they are (with the 1/2 in `SamplesLoss`), the last
temperature epsilon and rho in the cost's unit, and KL against a x b: clmorph's own convention.
Checks of arguments, values and plans stay GeomLoss's, made from clmorph's potentials.
"""

from typing import Any

import numpy as np
from geomloss._legacy import samples_loss as legacy_samples  # so that its modules are searched
from geomloss._legacy import sinkhorn_divergence as legacy
from geomloss._typing import SinkhornPotentials
from geomloss.ot._abstract_solvers import sinkhorn_ot

from peers.bridge import Array, Declined, solve_matrix

PACKAGE = "geomloss"
_SEARCHED = (legacy_samples,)


def to_numpy(value: Any) -> Array:
    """Return a tensor as NumPy's array.

    Raises
    ------
    Declined
        If it is symbolic, or a gradient is asked of it.
    """
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, tuple) or not hasattr(value, "detach"):
        raise Declined("symbolic costs of KeOps")
    if value.requires_grad:
        raise Declined("gradients through autograd")
    return np.asarray(value.cpu().numpy())


def _solve_all(
    log_a: Any, log_b: Any, cost: Any, epsilon: float, rho: float | None, symmetric: bool = False
) -> tuple[Any, Any]:
    """Solve a batch of problems, or one without a batch's axis."""
    a, b = (np.exp(to_numpy(logs.detach() if hasattr(logs, "detach") else logs))
            for logs in (log_a, log_b))  # fmt: skip
    costs = to_numpy(cost)
    strength = np.inf if rho is None else float(rho)
    batch = costs.ndim == 3
    shapes = a.shape, b.shape
    costs, a, b = (v.reshape(-1, *v.shape[1:]) if batch else v[None] for v in (costs, a, b))
    found = []
    for each, source, target in zip(costs, a, b, strict=True):
        answer = solve_matrix(each, source, target, float(epsilon), (strength, strength))
        f, g = answer.f, answer.g
        if symmetric:
            f = g = 0.5 * (f + g)
        found.append((f, g))
    f, g = (np.stack([pair[side] for pair in found]).reshape(shapes[side]) for side in (0, 1))
    return _like(f, log_a), _like(g, log_b)


def _like(value: Array, other: Any) -> Any:
    """Return an array of another one's library and type."""
    if isinstance(other, np.ndarray):
        return value.astype(other.dtype)
    import torch

    return torch.as_tensor(value, dtype=other.dtype, device=other.device)


def sinkhorn_loop(
    *, softmin: Any, log_a_list: Any, log_b_list: Any, C_list: Any, descent: Any,
    debias: bool = True, **options: Any,
) -> SinkhornPotentials:  # fmt: skip
    """Stand for the loop of `geomloss.ot`."""
    log_a, log_b, cost = log_a_list[-1], log_b_list[-1], C_list[-1]
    strengths = descent.eps_list[-1], descent.rho_list[-1]
    f, g = _solve_all(log_a, log_b, cost.xy, *strengths)
    f_aa = g_bb = None
    if debias:
        f_aa, _ = _solve_all(log_a, log_a, cost.xx, *strengths, symmetric=True)
        g_bb, _ = _solve_all(log_b, log_b, cost.yy, *strengths, symmetric=True)
    return SinkhornPotentials(f_ba=f, g_ab=g, f_aa=f_aa, g_bb=g_bb)


def legacy_sinkhorn_loop(
    softmin: Any, a_logs: Any, b_logs: Any, C_xxs: Any, C_yys: Any, C_xys: Any, C_yxs: Any,
    eps_list: Any, rho: Any, *args: Any, debias: bool = True, **options: Any,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """Stand for the loop of `SamplesLoss`."""
    log_a, log_b, c_xx, c_yy, c_xy = (
        value[-1] if isinstance(value, list) else value
        for value in (a_logs, b_logs, C_xxs, C_yys, C_xys)
    )
    f, g = _solve_all(log_a, log_b, c_xy, eps_list[-1], rho)
    if not debias:
        return None, None, g, f
    f_aa, _ = _solve_all(log_a, log_a, c_xx, eps_list[-1], rho, symmetric=True)
    g_bb, _ = _solve_all(log_b, log_b, c_yy, eps_list[-1], rho, symmetric=True)
    return f_aa, g_bb, g, f


def replacements() -> dict[Any, Any]:
    """Return what stands for each of GeomLoss's loops."""
    return {
        sinkhorn_ot.sinkhorn_loop: sinkhorn_loop,
        legacy.sinkhorn_loop: legacy_sinkhorn_loop,
    }
