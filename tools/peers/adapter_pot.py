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
from peers.pot_values import costs, histograms, log_of, numbers, strengths

#: The module whose functions are replaced.
PACKAGE = "ot"


def _options(numItermax: int, stopThr: float, at_least: int = 1) -> dict[str, Any]:
    return {
        "max_iter": max(int(numItermax), at_least),
        "tol": TOLERANCE if stopThr > 0 else 1e-300,
    }


def _solved(
    cost: Array, a: Array, b: Array, reg: float, rho: tuple[float, float], shift: bool,
    warn: bool = True, **options: Any,
) -> tuple[list[Answer], Array, Array, Array]:  # fmt: skip
    """Solve for each column of b; return POT's result and logarithms, and warn as POT does.

    The result is the plan, or the costs of the plans if b has several columns. With `shift` log u
    is f / epsilon + log a.
    """
    answers, logarithms = [], []
    for weights in b.reshape(len(b), -1).T:
        answer = solve_matrix(cost, a, weights, reg, rho, **options)
        if warn and answer.potentials.status == "max_iter":
            words = f"Sinkhorn did not converge: {answer.potentials.message}"
            warnings.warn(words, stacklevel=3)
        answers.append(answer)
        more = (log_of(a), log_of(weights)) if shift else (0, 0)
        logarithms.append(
            [p / reg + log for p, log in zip((answer.f, answer.g), more, strict=True)]
        )
    logu, logv = (np.stack(side, axis=-1) for side in zip(*logarithms, strict=True))
    if b.ndim > 1:
        return answers, np.array([np.sum(each.plan * cost) for each in answers]), logu, logv
    return answers, answers[0].plan, logu[:, 0], logv[:, 0]


def sinkhorn(
    a: Any, b: Any, M: Any, reg: float, numItermax: int = 1000, stopThr: float = 1e-9,
    verbose: bool = False, log: bool = False, warn: bool = True, warmstart: Any = None,
    **kwargs: Any,
) -> Any:  # fmt: skip
    """Stand for POT's balanced solvers; the way there is clmorph's own."""
    _, _, M = ot.utils.list_to_array(a, b, M)
    nx, (a, b, cost) = numbers(a, b, M)
    a, b = histograms(a, b, cost)
    reg, _ = strengths(reg)
    options = _options(numItermax, stopThr)
    answers, result, logu, logv = _solved(cost, a, b, reg, (np.inf, np.inf), True, warn, **options)
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
    a, b = histograms(a, b, cost)
    reg, rho = strengths(reg, reg_m)
    if reg_type.lower() == "entropy":
        warnings.warn("reg_type = entropy: the matrix c is overwritten by ones", stacklevel=2)
    many = b.ndim > 1
    reference: Array | None
    if many or reg_type.lower() == "entropy":
        reference = np.ones(cost.shape)
    else:
        reference = None if c is None else numbers(c)[1][0]
    options = _options(numItermax, stopThr) | {"reference": reference}
    answers, result, logu, logv = _solved(cost, a, b, reg, rho, False, **options)
    values = {"logu": logu, "logv": logv}
    if not many:
        values |= costs(result, cost, a, b, reg, rho, reference, mass=False)
    result = nx.from_numpy(result, type_as=M)
    if not log:
        return result
    told = {name: nx.from_numpy(np.asarray(value), type_as=M) for name, value in values.items()}
    told["err"] = [float(each) for each in answers[-1].potentials.residuals]
    return result, told


def _generic(
    a: Any, b: Any, M: Any, reg: float, reg_m: Any, c: Any, entropy: bool, log: bool,
    numItermax: int,
) -> Any:  # fmt: skip
    _, _, M = ot.utils.list_to_array(a, b, M)
    nx, (a, b, cost) = numbers(a, b, M)
    a, b = histograms(a, b, cost)
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
    kinds = ("knopp", "log", "stabilized", "epsilon_scaling")
    found = {getattr(bregman, f"sinkhorn_{kind}"): sinkhorn for kind in kinds}
    kinds = ("knopp_unbalanced", "stabilized_unbalanced", "unbalanced_translation_invariant")
    found |= {getattr(unbalanced_module, f"sinkhorn_{kind}"): sinkhorn_unbalanced for kind in kinds}
    return found | {
        bregman.greenkhorn: greenkhorn,
        unbalanced.lbfgsb_unbalanced: lbfgsb_unbalanced,
        unbalanced.mm_unbalanced: mm_unbalanced,
        bregman.empirical_sinkhorn: make_empirical(bregman.empirical_sinkhorn),
    }
