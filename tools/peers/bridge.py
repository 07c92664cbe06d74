"""The common solver of all adapters, which uses clmorph alone.

A cost matrix is answered through an exact factorization. clmorph's cost between two points is
C_ij = |x_i - y_j|^2 / 2 + r_i + s_j, which is any matrix whose doubly centered part has a rank
of at most 11: squared distances of points in up to 11 dimensions, and every matrix with at most
12 rows or columns. A cost of higher rank is declined.
"""

import contextlib
import os
import sys
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clmorph
from clmorph.backends.interface import MAX_DIMENSION
from clmorph.transport._solver.checks import MAX_SPREAD
from peers.outcomes import DECLINED

Array = NDArray[np.float64]

#: Residual to reach, in units of epsilon, and in units of the rounding of a device's sums: below
#: what rounding leaves, the shift between balanced potentials, which is free, only wanders.
TOLERANCE, ROUNDINGS = 1e-10, 16.0
#: Largest error of a factorized cost, in units of epsilon, for a cost in float64.
COST_ERROR = 1e-6
#: Relative error of a cost in float32.
SINGLE = 2.0**-22
#: `clmorph.transport_plan` refuses a plan with more than so many times the mass that is given.
MAX_MASS = 1e3
#: Environment variable with the backend's name.
DEVICE = "CLMORPH_PEER_DEVICE"


class Declined(pytest.skip.Exception):
    """The problem is none that clmorph solves, for a reason that is reported."""

    def __init__(self, reason: str) -> None:
        super().__init__(DECLINED + reason)
        self.reason = reason


@dataclass(frozen=True)
class Answer:
    """Potentials in the unit of the cost, and the plan exp((f + g - C) / epsilon) a b."""

    f: Array
    g: Array
    plan: Array
    potentials: clmorph.Potentials


class Tally:
    """Solves since `reset`, and why one was declined where no exception could be raised."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.calls = 0
        self.declined: str | None = None


TALLY = Tally()


def backend() -> str:
    """Return the name of clmorph's backend for this run."""
    return os.environ.get(DEVICE, "numpy")


def solve_matrix(
    cost: Any, a: Any, b: Any, epsilon: float, rho: tuple[float, float], max_iter: int = 10000,
    tol: float = TOLERANCE, *, counting: bool = False, reference: Array | None = None,
) -> Answer:  # fmt: skip
    """Minimize <C, pi> + rho_1 KL(pi 1|a) + rho_2 KL(pi^T 1|b) + epsilon KL(pi|a x b).

    With another reference c, -epsilon log(c / (a x b)) is added to the cost; the plan is then
    exp((f + g - C) / epsilon) c with the potentials that are returned.

    Parameters
    ----------
    cost : (N, M) array
    a, b : (N,) and (M,) arrays
    epsilon : float
        In the unit of the cost.
    rho : (rho_1, rho_2)
        In the unit of the cost; infinite is balanced.
    max_iter, tol
        As in `clmorph.sinkhorn`.
    counting : bool
        Take KL(pi|1), the entropy.
    reference : (N, M) array, optional
        Take KL(pi|c).

    Raises
    ------
    Declined
        If clmorph does not solve such a problem.
    """
    single = np.asarray(cost).dtype.itemsize < 8
    cost = np.asarray(cost, float)
    if reference is not None:
        if np.any(reference <= 0):
            raise Declined("a reference measure with zeros")
        cost = cost - epsilon * np.log(reference)
    if counting or reference is not None:
        cost = cost + epsilon * (_finite_log(a)[:, None] + _finite_log(b))
    if not np.all(np.isfinite(cost)):
        raise Declined("the cost holds infinities or NaN")
    check_strengths(epsilon, rho)
    if np.abs(cost).max() > MAX_SPREAD * epsilon:
        raise Declined("costs beyond 1e12 epsilon, which stand for pairs that are forbidden")
    x, y, r, s = factorize(cost)
    error = np.abs(0.5 * _squares(x, y) + r[:, None] + s - cost).max()
    allowed = COST_ERROR * epsilon
    if single:
        allowed = max(allowed, SINGLE * np.abs(cost).max())
    if error > allowed:
        raise Declined(f"the cost is no matrix of rank {MAX_DIMENSION} or less, once centered")
    return _solve((x, r), (y, s), a, b, epsilon, rho, max_iter, tol)


def solve_points(
    x: Any, y: Any, a: Any, b: Any, epsilon: float, rho: tuple[float, float],
    max_iter: int = 10000, tol: float = TOLERANCE,
) -> Answer:  # fmt: skip
    """Do as `solve_matrix` for C_ij = |x_i - y_j|^2 / 2, with points (N, D) and (M, D)."""
    x, y = (np.asarray(points, float) for points in (x, y))
    check_strengths(epsilon, rho)
    if x.shape[1] > MAX_DIMENSION:
        return solve_matrix(0.5 * _squares(x, y), a, b, epsilon, rho, max_iter, tol)
    return _solve((x, None), (y, None), a, b, epsilon, rho, max_iter, tol)


def _finite_log(weights: Any) -> Array:
    """Return logarithms, and 0 for no mass, where it does not matter."""
    weights = np.asarray(weights, float)
    return np.asarray(np.log(np.where(weights > 0, weights, 1.0)))


def check_strengths(epsilon: float, rho: tuple[float, float]) -> None:
    """Decline what is no entropic problem."""
    if not (np.isfinite(epsilon) and epsilon > 0):
        raise Declined("the entropic strength is not a positive number")
    if not all(value > 0 for value in rho):
        raise Declined("the marginal strength is not positive")


def factorize(cost: Array) -> tuple[Array, Array, Array, Array]:
    """Return x (N, D), y (M, D), r (N,), s (M,) with C about |x_i - y_j|^2 / 2 + r_i + s_j.

    The doubly centered matrix is -x y^T, of which the largest singular values are taken, as in
    classical multidimensional scaling.
    """
    rows, columns = cost.mean(axis=1), cost.mean(axis=0)
    centered = cost - rows[:, None] - columns + cost.mean()
    u, values, v = np.linalg.svd(-centered, full_matrices=False)
    rank = int(np.sum(values > 1e-15 * max(values[0], np.abs(cost).max(), 1e-300)))
    rank = max(1, min(rank, MAX_DIMENSION))
    roots = np.sqrt(values[:rank])
    x, y = u[:, :rank] * roots, v[:rank].T * roots
    r = rows - cost.mean() - 0.5 * np.sum(x**2, axis=1)
    s = columns - 0.5 * np.sum(y**2, axis=1)
    return x, y, r, s


def _squares(x: Array, y: Array) -> Array:
    return np.asarray(np.sum((x[:, None, :] - y[None, :, :]) ** 2, axis=2))


def _solve(
    source: tuple[Array, Array | None],
    target: tuple[Array, Array | None],
    a: Any,
    b: Any,
    epsilon: float,
    rho: tuple[float, float],
    max_iter: int,
    tol: float,
) -> Answer:
    a, b = np.asarray(a, float), np.asarray(b, float)
    if np.isinf(rho[0]) and np.isinf(rho[1]):
        if abs(a.sum() - b.sum()) > 1e-3 * a.sum():
            raise Declined("balanced transport between different masses has no solution")
        # Weights in float32 add up to one to its rounding; with masses that differ, however
        # little, balanced potentials go on drifting below that residual.
        b = b * (a.sum() / b.sum())
    # Beyond this a finite strength and the balanced limit are one in float64.
    rho = tuple(np.inf if value > MAX_SPREAD * epsilon else value for value in rho)
    pair = [
        clmorph.WeightedPoints(np.ascontiguousarray(points), weights, offsets)
        for (points, offsets), weights in ((source, a), (target, b))
    ]
    operations = clmorph.get_backend(backend())
    # A tolerance of nothing is asked for by who wants to see that it is not reached.
    if tol >= TOLERANCE:
        tol = max(tol, ROUNDINGS * operations.sum_roundoff)
    TALLY.calls += 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", clmorph.ConvergenceWarning)
        potentials = clmorph.sinkhorn(
            *pair, epsilon=epsilon, rho=rho, tol=tol, max_iter=max_iter, backend=operations
        )
        if potentials.transported_mass > MAX_MASS * max(a.sum(), b.sum()):
            raise Declined("a plan of far more mass than is given, as for very negative costs")
        # Every pair is kept: the libraries' plans are dense.
        plan = clmorph.transport_plan(*pair, potentials, log_threshold=-1e4, backend=operations)
    return Answer(potentials.f, potentials.g, plan.to_scipy().toarray(), potentials)


@contextlib.contextmanager
def replaced(package: str, replacements: dict[Any, Any]) -> Any:
    """Put functions in place of others, in every module of a package that names them.

    Parameters
    ----------
    package : str
        Modules of this name and below it are searched.
    replacements : dict
        From the original to what stands for it.
    """
    by_id = {id(original): (original, new) for original, new in replacements.items()}
    undone = []
    for name, module in list(sys.modules.items()):
        if module is None or not (name == package or name.startswith(package + ".")):
            continue
        for attribute, value in list(vars(module).items()):
            found = by_id.get(id(value))
            if found is not None:
                setattr(module, attribute, found[1])
                undone.append((module, attribute, value))
    try:
        yield
    finally:
        for module, attribute, value in undone:
            setattr(module, attribute, value)
