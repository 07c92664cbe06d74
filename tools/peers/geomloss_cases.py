"""Problems and checks in place of those that GeomLoss's sdist leaves out.

GeomLoss's test modules take their problems from a package `generators` and compare results by a
module `check_ot_result`; the sdist holds the test modules alone. These are problems of ours with
the same face: what a test asks of the solver is GeomLoss's, which problems it is asked about,
and what is expected, are ours. Expected values are known in closed form or within bounds:

* one point each: log m = ((rho + epsilon)(log a + log b) - C) / (2 rho + epsilon);
* assignments: 0 <= OT_epsilon - OT <= epsilon H(weights), balanced, KL against a x b;
* Gaussians on a line: potentials are quadratic (Janati, Muzellec, Peyré, Cuturi 2020).
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

#: Small sizes, and how many problems of one size are solved at once; 0 is one, without an axis.
SIZES, BATCHES = st.integers(1, 5), st.integers(0, 2)
#: Kinds of arrays.
KINDS = st.tuples(st.sampled_from(["numpy", "torch"]), st.sampled_from([np.float32, np.float64]))
st_method = st.just("auto")


@dataclass(frozen=True)
class Expected:
    """What is expected of a result; None is not compared."""

    value: Any = None
    plan: Any = None
    marginal_a: Any = None
    marginal_b: Any = None


@dataclass(frozen=True)
class OTExperimentConfig:
    """Arguments of a solve, what is expected, and how closely."""

    a: Any = None
    b: Any = None
    C: Any = None
    CT: Any = None
    X_a: Any = None
    X_b: Any = None
    cost: str = "sqeuclidean"
    reg: float = 1.0
    unbalanced: float | None = None
    max_iter: int = 100
    atol: float = 1e-3
    rtol: float = 1e-3
    result: Expected = Expected()


def cast(value: Any, library: str, dtype: Any) -> Any:
    """Return arrays of a kind, in place of NumPy's in float64."""
    if isinstance(value, OTExperimentConfig | Expected):
        names = [field.name for field in fields(value)]
        return replace(value, **{n: cast(getattr(value, n), library, dtype) for n in names})
    if not isinstance(value, np.ndarray | np.float64):
        return value
    value = np.asarray(value, dtype)
    return torch.from_numpy(value.copy()) if library == "torch" else value


def _finished(draw: Any, batch: int, experiment: OTExperimentConfig) -> OTExperimentConfig:
    """Drop the axis of a batch where there is none, and draw a kind of arrays."""

    def first(value: Any) -> Any:
        if isinstance(value, Expected):
            return Expected(**{f.name: first(getattr(value, f.name)) for f in fields(value)})
        return value[0] if isinstance(value, np.ndarray) else value

    if batch == 0:
        names = [field.name for field in fields(experiment)]
        experiment = replace(experiment, **{n: first(getattr(experiment, n)) for n in names})
    library, dtype = draw(KINDS)
    return cast(experiment, library, dtype)


def _rng(draw: Any) -> np.random.Generator:
    return np.random.default_rng(draw(st.integers(0, 2**32 - 1)))


@st.composite
def st_simple_matrix(draw: Any) -> OTExperimentConfig:
    """Any costs and weights, balanced or not: nothing is known of the result."""
    batch, n, m, rng = draw(BATCHES), draw(SIZES), draw(SIZES), _rng(draw)
    unbalanced = draw(st.none() | st.floats(1e-2, 10.0))
    # The plan's mass grows with exp(-C / 2 rho).
    low = -10.0 if unbalanced is None else max(-10.0, -4.0 * unbalanced)
    cost = rng.uniform(low, 10, (max(1, batch), n, m))
    a, b = (rng.uniform(0.1, 10, (max(1, batch), size)) for size in (n, m))
    if unbalanced is None:
        b *= (a.sum(1) / b.sum(1))[:, None]
    experiment = OTExperimentConfig(
        a=a, b=b, C=cost, CT=cost.transpose(0, 2, 1).copy(), unbalanced=unbalanced,
        reg=draw(st.floats(0.05, 10.0)), max_iter=draw(st.integers(1, 100)),
    )  # fmt: skip
    return _finished(draw, batch, experiment)


def _one_point_each(
    cost: np.ndarray, a: np.ndarray, b: np.ndarray, reg: float, rho: float | None
) -> Expected:
    """Return the result for (B, 1, 1) costs and (B, 1) masses, equal ones if balanced."""
    c = cost[:, 0]
    if rho is None:
        mass, value = a, a * c + reg * a * np.log(1.0 / a)
    else:
        mass = np.exp(((rho + reg) * (np.log(a) + np.log(b)) - c) / (2 * rho + reg))
        value = rho * (a + b - 2 * mass) + reg * (a * b - mass)
    return Expected(value=value[:, 0], plan=mass[:, :, None], marginal_a=mass, marginal_b=mass)


@st.composite
def st_diracs_matrix(draw: Any) -> OTExperimentConfig:
    """One point each, at any cost."""
    batch, rng = draw(BATCHES), _rng(draw)
    unbalanced = draw(st.none() | st.floats(0.1, 10.0))
    a, b = rng.uniform(0.1, 3.0, (2, max(1, batch), 1))
    b = a if unbalanced is None else b
    low = -50.0 if unbalanced is None else -4.0 * unbalanced
    cost = rng.uniform(low, 50, (max(1, batch), 1, 1))
    reg = draw(st.floats(1e-2, 10.0))
    experiment = OTExperimentConfig(
        a=a, b=b, C=cost, reg=reg, unbalanced=unbalanced, atol=1e-2, rtol=1e-2,
        result=_one_point_each(cost, a, b, reg, unbalanced),
    )  # fmt: skip
    return _finished(draw, batch, experiment)


@st.composite
def st_diracs_sample(draw: Any) -> OTExperimentConfig:
    """One point each, in up to four dimensions."""
    rng, dimension = _rng(draw), draw(st.integers(1, 4))
    x, y = rng.uniform(-3, 3, (2, 1, 1, dimension))
    unbalanced = draw(st.none() | st.floats(0.1, 10.0))
    a, b = rng.uniform(0.1, 3.0, (2, 1, 1))
    b = a if unbalanced is None else b
    reg = draw(st.floats(1e-2, 10.0))
    cost = np.sum((x - y) ** 2, axis=2, keepdims=True)
    experiment = OTExperimentConfig(
        X_a=x, X_b=y, a=a, b=b, reg=reg, unbalanced=unbalanced, atol=1e-2, rtol=1e-2,
        result=_one_point_each(cost, a, b, reg, unbalanced),
    )  # fmt: skip
    return _finished(draw, 0, experiment)


@st.composite
def st_permutations_matrix(draw: Any) -> OTExperimentConfig:
    """Costs that are low for one permutation: it is the plan."""
    batch, n, rng = draw(BATCHES), draw(SIZES), _rng(draw)
    size, reg = max(1, batch), 0.05
    cost = rng.uniform(2, 3, (size, n, n))
    plan = np.zeros(cost.shape)
    for k in range(size):
        chosen = np.arange(n), rng.permutation(n)
        cost[k][chosen] = rng.uniform(0, 1, n)
        plan[k][chosen] = 1 / n
    weights = np.full((size, n), 1 / n)
    value = np.sum(cost * plan, axis=(1, 2)) + reg * np.log(n)
    result = Expected(value=value, plan=plan, marginal_a=weights, marginal_b=weights)
    given = draw(st.sampled_from([weights, None]))
    return _finished(
        draw, batch, OTExperimentConfig(a=given, b=given, C=cost, reg=reg, result=result)
    )


def _assignment(cost: np.ndarray, weights: np.ndarray, values: np.ndarray, reg: float) -> Any:
    """Return a problem whose value lies within reg H(weights) above `values`."""
    entropy = -np.sum(weights * np.log(weights), axis=1)
    result = Expected(value=values + 0.5 * reg * entropy, marginal_a=weights, marginal_b=weights)
    return OTExperimentConfig(
        a=weights, b=weights, C=cost, reg=reg, atol=0.5 * reg * float(entropy.max()) + 1e-3,
        rtol=0.0, result=result,
    )  # fmt: skip


@st.composite
def st_random_matrix(draw: Any) -> OTExperimentConfig:
    """Any costs between as many points of equal weight: the best assignment is scipy's."""
    batch, n, rng = draw(BATCHES), draw(SIZES), _rng(draw)
    cost = rng.uniform(-1, 1, (max(1, batch), n, n))
    values = np.array([each[linear_sum_assignment(each)].mean() for each in cost])
    weights = np.full(cost.shape[:2], 1 / n)
    return _finished(draw, batch, _assignment(cost, weights, values, 0.02))


@st.composite
def st_convex_gradients_matrix(draw: Any) -> OTExperimentConfig:
    """Points and their images under the gradient of a convex function: no other map is better."""
    batch, n, dimension, rng = draw(BATCHES), draw(SIZES), draw(st.integers(1, 3)), _rng(draw)
    size = max(1, batch)
    x = rng.uniform(0, 1, (size, n, dimension))
    root = rng.normal(size=(size, dimension, dimension))
    y = np.einsum("bij,bkj,bnk->bni", root, root, x) + rng.normal(size=(size, 1, dimension))
    cost = 0.5 * np.sum((x[:, :, None] - y[:, None]) ** 2, axis=3)
    weights = rng.uniform(0.1, 1.0, (size, n))
    weights /= weights.sum(axis=1, keepdims=True)
    values = np.einsum("bii,bi->b", cost, weights)
    return _finished(draw, batch, _assignment(cost, weights, values, 0.02))


def gaussian_potentials(
    masses: tuple[float, float], means: tuple[float, float], variances: tuple[float, float],
    reg: float, rho: float,
) -> list[np.ndarray]:  # fmt: skip
    """Return (F, l, c) of f = -F x^2 / 2 + l x + c, and of g, for C = |x - y|^2 / 2 on a line.

    A soft minimum of such a potential over a Gaussian is another one, so Sinkhorn's iteration is
    one of three numbers.
    """
    damping = rho / (rho + reg)
    potentials = [np.zeros(3), np.zeros(3)]
    for number in range(4000):
        side = number % 2  # of the potential that is set
        curvature, slope, constant = potentials[1 - side]
        mass, mean, variance = (v[1 - side] for v in (masses, means, variances))
        precision = 1 / variance + (curvature + 1) / reg
        shift = mean / variance + slope / reg
        exponent = 0.5 * shift**2 / precision - 0.5 * mean**2 / variance
        inner = np.log(mass) - 0.5 * np.log(variance * precision) + exponent
        potentials[side] = damping * np.array(
            [1 / (reg * precision) - 1, -shift / precision, -reg * inner - constant]
        )
    return potentials


@st.composite
def st_gaussians_matrix(draw: Any) -> OTExperimentConfig:
    """Two Gaussians on a line, of any masses."""
    rng, reg, rho = _rng(draw), draw(st.floats(0.1, 0.5)), draw(st.floats(0.1, 2.0))
    # GeomLoss forms exp((f + g - C) / reg) first, which must be finite in float32.
    axis = np.linspace(-1.5, 2.5, 101)
    step = axis[1] - axis[0]
    masses, means, deviations = rng.uniform([0.3, 0.0, 0.2], [2.0, 1.0, 0.3], (2, 3)).T
    log_a, log_b = (
        np.log(m * step / (s * np.sqrt(2 * np.pi))) - 0.5 * ((axis - mean) / s) ** 2
        for m, mean, s in zip(masses, means, deviations, strict=True)
    )
    a, b = np.exp(log_a), np.exp(log_b)
    potentials = gaussian_potentials(tuple(masses), tuple(means), tuple(deviations**2), reg, rho)
    f, g = (-0.5 * p[0] * axis**2 + p[1] * axis + p[2] for p in potentials)
    cost = 0.5 * (axis[:, None] - axis) ** 2
    plan = np.exp((f[:, None] + g - cost) / reg + log_a[:, None] + log_b)
    left = np.exp(log_a - f / rho).sum() + np.exp(log_b - g / rho).sum()
    value = rho * masses.sum() + reg * masses.prod() - (rho + reg / 2) * left
    result = Expected(np.array([value]), plan[None], plan.sum(1)[None], plan.sum(0)[None])
    experiment = OTExperimentConfig(
        a=a[None], b=b[None], C=cost[None], reg=reg, unbalanced=rho, result=result
    )
    return _finished(draw, 0, experiment)


def _numbers(value: Any) -> np.ndarray:
    return np.asarray(value.detach().cpu().numpy() if hasattr(value, "detach") else value, float)


def _close(ours: Any, expected: Any, atol: float, rtol: float) -> None:
    if expected is not None:
        assert tuple(np.shape(ours)) == tuple(np.shape(expected))
        np.testing.assert_allclose(_numbers(ours), _numbers(expected), atol=atol, rtol=rtol)


def check_ot_result(ours: Any, expected: Expected, atol: float, rtol: float) -> None:
    """Compare a result of GeomLoss with what is expected."""
    for field in fields(expected):
        wanted = getattr(expected, field.name)
        if wanted is not None:
            found = getattr(ours, field.name)
            assert type(found) is type(wanted) or np.isscalar(found) or np.ndim(found) == 0
            assert found.dtype == wanted.dtype
            _close(found, wanted, atol, rtol)


def check_ot_result_symmetric(
    ours: Any, reverse: Any, transpose: Any, atol: float, rtol: float
) -> None:
    """Compare a result with that for exchanged measures."""
    for one, other in (
        (ours.value, reverse.value), (ours.plan, transpose(reverse.plan)),
        (ours.marginal_a, reverse.marginal_b), (ours.marginal_b, reverse.marginal_a),
    ):  # fmt: skip
        _close(one, other, atol, rtol)


def check_ot_result_cost_linearity(
    ours: Any, scaled: Any, scaling: float, offset: float, atol: float, rtol: float
) -> None:
    """Compare a result with that for costs and strengths multiplied by a number."""
    _close(scaling * _numbers(ours.value) + offset, _numbers(scaled.value), atol * scaling, rtol)
    _close(ours.plan, scaled.plan, atol, rtol)
    # One of a pair of balanced potentials may be shifted against the other.
    for one, other in ((ours.potential_a, scaled.potential_a),):
        _close(np.ptp(scaling * _numbers(one), -1), np.ptp(_numbers(other), -1),
               atol * scaling, rtol)  # fmt: skip
