"""POT's solvers, replaced by clmorph.

POT minimizes <M, pi> + reg KL(pi|c) + reg_m1 KL(pi 1|a) + reg_m2 KL(pi^T 1|b): strengths are in
the unit of M, so clmorph's cost is M itself, epsilon = reg and rho = reg_m. With c = a x b this
is clmorph's problem; any other c, of ones for the entropy, adds -epsilon log(c / (a x b)) to the
cost. POT's log u is f / epsilon for KL, and f / epsilon + log a in balanced transport, where its
plan is u exp(-M / reg) v.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import ot
import ot.backend
import ot.batch  # so that its modules are searched, too
import ot.gromov
import ot.utils
from ot.bregman._empirical import get_sinkhorn_lazytensor
from ot.unbalanced import _sinkhorn as unbalanced_module

from peers.bridge import TOLERANCE, Answer, Array, Declined, solve_matrix

#: The module whose functions are replaced.
PACKAGE = "ot"


def numbers(*arrays: Any) -> tuple[Any, list[Any]]:
    """Return POT's backend of some arrays, and them as NumPy's.

    Raises
    ------
    Declined
        If a gradient is asked of one, or its value is not known yet.
    """
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


def _histograms(a: Array, b: Array, M: Array) -> tuple[Array, Array]:
    """Return weights, uniform ones where none are given."""
    if len(a) == 0:
        a = np.full(M.shape[0], 1.0 / M.shape[0])
    if len(b) == 0:
        b = np.full(M.shape[1], 1.0 / M.shape[1])
    return a, b


def _log(weights: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(weights)


def _options(numItermax: int, stopThr: float, at_least: int = 1) -> dict[str, Any]:
    return {
        "max_iter": max(int(numItermax), at_least),
        "tol": TOLERANCE if stopThr > 0 else 1e-300,
    }


def _tell(answer: Answer, warn: bool = True) -> None:
    """Warn as POT does."""
    if warn and answer.potentials.status == "max_iter":
        warnings.warn(f"Sinkhorn did not converge: {answer.potentials.message}", stacklevel=3)


def sinkhorn(
    a: Any, b: Any, M: Any, reg: float, numItermax: int = 1000, stopThr: float = 1e-9,
    verbose: bool = False, log: bool = False, warn: bool = True, warmstart: Any = None,
    **kwargs: Any,
) -> Any:  # fmt: skip
    """Stand for POT's balanced solvers; the way there is clmorph's own."""
    _, _, M = ot.utils.list_to_array(a, b, M)
    nx, (a, b, cost) = numbers(a, b, M)
    a, b = _histograms(a, b, cost)
    reg, _ = strengths(reg)
    answers = []
    for weights in b.reshape(len(b), -1).T:
        options = _options(numItermax, stopThr)
        answers.append(solve_matrix(cost, a, weights, reg, (np.inf, np.inf), **options))
        _tell(answers[-1], warn)
    logu = np.stack([each.f / reg + _log(a) for each in answers], axis=-1)
    logv = np.stack(
        [each.g / reg + _log(w) for each, w in zip(answers, b.reshape(len(b), -1).T, strict=True)],
        axis=-1,
    )
    if b.ndim > 1:
        result = np.array([np.sum(each.plan * cost) for each in answers])
    else:
        result, logu, logv = answers[0].plan, logu[:, 0], logv[:, 0]
    result = nx.from_numpy(result, type_as=M)
    if not log:
        return result
    told = {name: nx.from_numpy(value, type_as=M) for name, value in (
        ("log_u", logu), ("log_v", logv), ("logu", logu), ("logv", logv),
        ("u", np.exp(logu)), ("v", np.exp(logv)), ("alpha", reg * logu), ("beta", reg * logv),
    )}  # fmt: skip
    told["warmstart"] = told["alpha"], told["beta"]
    told["err"] = [float(each) for each in answers[-1].potentials.residuals]
    told["niter"] = told["n_iter"] = answers[-1].potentials.n_iter
    return result, told


def greenkhorn(a: Any, b: Any, M: Any, reg: float, numItermax: int = 10000, **options: Any) -> Any:
    """Stand for POT's greedy solver, which refuses two of its backends."""
    if ot.backend.get_backend(*ot.utils.list_to_array(a, b, M)).__name__ in ("jax", "tf"):
        raise TypeError("greenkhorn takes neither JAX nor TF")
    return sinkhorn(a, b, M, reg, numItermax=numItermax, **options)


def sinkhorn_unbalanced(
    a: Any, b: Any, M: Any, reg: float, reg_m: Any, reg_type: str = "kl", c: Any = None,
    warmstart: Any = None, numItermax: int = 1000, stopThr: float = 1e-6, verbose: bool = False,
    log: bool = False, **kwargs: Any,
) -> Any:  # fmt: skip
    """Stand for POT's unbalanced solvers of all three kinds."""
    _, _, M = ot.utils.list_to_array(a, b, M)
    nx, (a, b, cost) = numbers(a, b, M)
    a, b = _histograms(a, b, cost)
    reg, rho = strengths(reg, reg_m)
    if reg_type.lower() == "entropy":
        warnings.warn("reg_type = entropy: the matrix c is overwritten by ones", stacklevel=2)
    many = b.ndim > 1
    reference: Array | None
    if many or reg_type.lower() == "entropy":
        reference = np.ones(cost.shape)
    else:
        reference = None if c is None else numbers(c)[1][0]
    answers = []
    for weights in b.reshape(len(b), -1).T:
        options = _options(numItermax, stopThr)
        answers.append(solve_matrix(cost, a, weights, reg, rho, **options, reference=reference))
        _tell(answers[-1])
    logu = np.stack([each.f / reg for each in answers], axis=-1)
    logv = np.stack([each.g / reg for each in answers], axis=-1)
    if many:
        result = np.array([np.sum(each.plan * cost) for each in answers])
    else:
        result, logu, logv = answers[0].plan, logu[:, 0], logv[:, 0]
    values = {"logu": logu, "logv": logv}
    if not many:
        values |= costs(result, cost, a, b, reg, rho, reference, mass=False)
    result = nx.from_numpy(result, type_as=M)
    if not log:
        return result
    told = {name: nx.from_numpy(np.asarray(value), type_as=M) for name, value in values.items()}
    told["err"] = [float(each) for each in answers[-1].potentials.residuals]
    return result, told


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


def _generic(
    a: Any,
    b: Any,
    M: Any,
    reg: float,
    reg_m: Any,
    c: Any,
    entropy: bool,
    log: bool,
    numItermax: int,
) -> Any:
    _, _, M = ot.utils.list_to_array(a, b, M)
    nx, (a, b, cost) = numbers(a, b, M)
    a, b = _histograms(a, b, cost)
    reg, rho = strengths(reg, reg_m)
    if reg == 0:
        raise Declined("no entropic regularization")
    reference = np.ones(cost.shape) if entropy else (None if c is None else numbers(c)[1][0])
    options = _options(numItermax, 1.0, 1000)
    answer = solve_matrix(cost, a, b, reg, rho, **options, reference=reference)
    plan = nx.from_numpy(answer.plan, type_as=M)
    if not log:
        return plan
    told: dict[str, Any] = {
        name: nx.from_numpy(np.asarray(value), type_as=M)
        for name, value in costs(answer.plan, cost, a, b, reg, rho, reference, mass=True).items()
    }
    told["res"], told["err"] = None, [float(each) for each in answer.potentials.residuals]
    return plan, told


def lbfgsb_unbalanced(
    a: Any, b: Any, M: Any, reg: float, reg_m: Any, c: Any = None, reg_div: Any = "kl",
    regm_div: str = "kl", G0: Any = None, numItermax: int = 1000, stopThr: float = 1e-15,
    method: str = "L-BFGS-B", verbose: bool = False, log: bool = False,
) -> Any:  # fmt: skip
    """Stand for the quasi-Newton solver where its divergences are clmorph's."""
    if isinstance(reg_div, tuple) or reg_div.lower() not in ("kl", "entropy"):
        raise Declined("another regularization than KL or entropy")
    if regm_div.lower() != "kl":
        raise Declined("another marginal divergence than KL")
    entropy = reg_div.lower() == "entropy"
    return _generic(a, b, M, reg, reg_m, c, entropy, log, numItermax)


def mm_unbalanced(
    a: Any, b: Any, M: Any, reg_m: Any, c: Any = None, reg: float = 0, div: str = "kl",
    G0: Any = None, numItermax: int = 1000, stopThr: float = 1e-15, verbose: bool = False,
    log: bool = False,
) -> Any:  # fmt: skip
    """Stand for the majorization-minimization solver where there is an entropy."""
    if div.lower() != "kl":
        raise Declined("another marginal divergence than KL")
    return _generic(a, b, M, reg, reg_m, c, False, log, numItermax)


def make_empirical(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return what stands for `empirical_sinkhorn`: lazily it iterates by itself.

    Otherwise it calls `sinkhorn`, which is replaced, so it is called as it is.
    """

    def empirical_sinkhorn(
        X_s: Any, X_t: Any, reg: float, a: Any = None, b: Any = None,
        metric: str = "sqeuclidean", numIterMax: int = 10000, stopThr: float = 1e-9,
        isLazy: bool = False, batchSize: Any = 100, verbose: bool = False, log: bool = False,
        warn: bool = True, warmstart: Any = None, **kwargs: Any,
    ) -> Any:  # fmt: skip
        if not isLazy:
            return original(
                X_s, X_t, reg, a, b, metric, numIterMax, stopThr, isLazy, batchSize, verbose,
                log, warn, warmstart, **kwargs,
            )  # fmt: skip
        if not isinstance(batchSize, int) and not (
            isinstance(batchSize, tuple) and len(batchSize) == 2
        ):
            raise ValueError("Batch size must be in integer or a tuple of two integers")
        a, b = ([] if weights is None else weights for weights in (a, b))
        M = ot.dist(X_s, X_t, metric=metric)
        _, told = sinkhorn(a, b, M, reg, numIterMax, stopThr, log=True, warn=warn)
        told["u"], told["v"] = f, g = told["log_u"], told["log_v"]
        told["lazy_plan"] = get_sinkhorn_lazytensor(X_s, X_t, f, g, metric, reg)
        return (f, g, told) if log else (f, g)

    return empirical_sinkhorn


def replacements() -> dict[Any, Any]:
    """Return what stands for each of POT's solvers."""
    bregman, unbalanced = ot.bregman, ot.unbalanced
    found = {
        getattr(bregman, name): sinkhorn
        for name in (
            "sinkhorn_knopp", "sinkhorn_log", "sinkhorn_stabilized", "sinkhorn_epsilon_scaling",
        )
    }  # fmt: skip
    found |= {
        getattr(unbalanced_module, name): sinkhorn_unbalanced
        for name in (
            "sinkhorn_knopp_unbalanced", "sinkhorn_stabilized_unbalanced",
            "sinkhorn_unbalanced_translation_invariant",
        )
    }  # fmt: skip
    found[bregman.greenkhorn] = greenkhorn
    found[unbalanced.lbfgsb_unbalanced] = lbfgsb_unbalanced
    found[unbalanced.mm_unbalanced] = mm_unbalanced
    found[bregman.empirical_sinkhorn] = make_empirical(bregman.empirical_sinkhorn)
    return found
