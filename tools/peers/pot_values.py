"""POT's arrays and numbers as NumPy's, and its values of a plan."""

from typing import Any

import numpy as np
import ot.backend
import ot.utils

from peers.bridge import Array, Declined


def numbers(*arrays: Any) -> tuple[Any, list[Any]]:
    """Return POT's backend of some arrays, and them as NumPy's; decline gradients."""
    # Of a single array it makes no list.
    found = ot.utils.list_to_array(*arrays)
    arrays = tuple(found) if len(arrays) > 1 else (found,)
    nx = ot.backend.get_backend(*arrays)
    for array in arrays:
        if getattr(array, "requires_grad", False):
            raise Declined("gradients through autograd")
        if "Tracer" in type(array).__name__:
            raise Declined("gradients or jit of jax")
    return nx, [nx.to_numpy(array) for array in arrays]


def strengths(reg: Any, reg_m: Any = np.inf) -> tuple[float, tuple[float, float]]:
    """Return reg and the pair of reg_m as numbers, whatever library's they are."""
    pair = ot.utils.get_parameter_pair(reg_m)
    source, target = (_plain(value) for value in pair)
    return float(_plain(reg)), (float(source), float(target))


def _plain(value: Any) -> Any:
    if isinstance(value, int | float | np.generic | np.ndarray):
        return np.asarray(value).item()
    return numbers(value)[1][0].item()


def histograms(a: Array, b: Array, M: Array) -> tuple[Array, Array]:
    """Return weights, uniform ones where none are given."""
    if len(a) == 0:
        a = np.full(M.shape[0], 1.0 / M.shape[0])
    if len(b) == 0:
        b = np.full(M.shape[1], 1.0 / M.shape[1])
    return a, b


def log_of(weights: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(weights)


def kl(p: Array, q: Array, mass: bool) -> float:
    """Return sum p log(p / q), and with the masses sum p log(p / q) - p + q."""
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(p > 0, p * np.log(np.where(p > 0, p, 1.0) / q), 0.0)
    return float(np.sum(terms - p + q) if mass else np.sum(terms))


def costs(
    plan: Array, M: Array, a: Array, b: Array, reg: float, rho: tuple[float, float],
    c: Array | None, mass: bool,
) -> dict[str, float]:  # fmt: skip
    """Return POT's linear and total cost of a plan.

    The total cost of POT's Sinkhorn solvers has no terms of masses, that of its others has them.
    """
    linear = float(np.sum(plan * M))
    total = linear + reg * kl(plan, a[:, None] * b if c is None else c, mass)
    for strength, marginal, weights in ((rho[0], plan.sum(1), a), (rho[1], plan.sum(0), b)):
        if np.isfinite(strength):
            total += strength * kl(marginal, weights, mass)
    return {"cost": linear, "total_cost": total}
