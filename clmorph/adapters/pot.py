"""POT's `ot.solve_sample` with clmorph as its solver, lazy and unbalanced too, without POT."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array
from clmorph._shared.validation import check_flag, check_number, shown
from clmorph.backends.arrays import as_floats
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.points import WeightedPoints, as_pair
from clmorph.transport.barycentric import barycentric_plan
from clmorph.transport.options import SolverOptions
from clmorph.transport.plan_building import transport_plan
from clmorph.transport.potentials import Potentials
from clmorph.transport.sinkhorn import sinkhorn

__all__ = ["LazyPlan", "OTResult", "UnsupportedError", "solve_sample"]


class UnsupportedError(InputError, NotImplementedError):
    """A problem of POT that this interface does not solve; POT raises NotImplementedError, too."""


#: Residual at which the solver stops, in units of epsilon.
TOL = 1e-6


@dataclass(frozen=True, repr=False, eq=False)
class LazyPlan:
    """A transport plan of which only the entries that are asked for are computed.

    Attributes
    ----------
    source, target : WeightedPoints
    potentials : Potentials

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph.pot
    >>> x, y = np.array([[0.0], [0.5], [1.0]]), np.array([[0.25], [0.75]])
    >>> plan = clmorph.pot.solve_sample(x, y, reg=0.02, lazy=True, backend="numpy").lazy_plan
    >>> plan.shape, plan[1:].shape, plan[0, :].shape
    ((3, 2), (2, 2), (1, 2))
    """

    source: WeightedPoints
    target: WeightedPoints
    potentials: Potentials

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return len(self.source), len(self.target)

    def __repr__(self) -> str:
        return f"<LazyPlan {self.shape[0]} x {self.shape[1]}>"

    def __getitem__(self, key: Any) -> Array:
        """Return the block of some rows and columns: slices, integers, or arrays of indices.

        An integer keeps its axis, with one entry, as in POT.
        """
        keys = key if isinstance(key, tuple) else (key,)
        if not 1 <= len(keys) <= 2:
            raise IndexError("a plan has two axes")  # as indexing does everywhere
        rows, columns = (
            np.atleast_1d(np.arange(size)[each])
            for size, each in zip(self.shape, (*keys, slice(None))[:2], strict=True)
        )
        x, y = self.source.points[rows], self.target.points[columns]
        found = self.potentials
        exponents = found.f[rows, None] + found.g[columns] - np.zeros((len(rows), 1))
        for along_x, along_y in zip(x.T, y.T, strict=True):
            exponents -= 0.5 * (along_x[:, None] - along_y) ** 2
        exponents /= found.epsilon
        with np.errstate(divide="ignore"):
            exponents += np.log(self.source.weights[rows])[:, None]
            exponents += np.log(self.target.weights[columns])
        return np.asarray(np.exp(exponents))


@dataclass(frozen=True, repr=False, eq=False)
class OTResult:
    """What `solve_sample` returns, with the names and conventions of POT's `OTResult`.

    Attributes
    ----------
    value : float
        Optimal value in POT's units: twice that of `clmorph.sinkhorn`.
    lazy_plan : LazyPlan
    solved : Potentials
        clmorph's own result, with its certificate.
    backend : Operations

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph.pot
    >>> x, y = np.array([[0.0], [0.5], [1.0]]), np.array([[0.25], [0.75]])
    >>> found = clmorph.pot.solve_sample(x, y, reg=0.02, unbalanced=0.2, backend="numpy")
    >>> found.plan.round(3).tolist()
    [[0.275, 0.0], [0.146, 0.146], [0.0, 0.275]]
    """

    value: float
    lazy_plan: LazyPlan
    solved: Potentials
    backend: Any
    is_lazy: bool = True

    def __repr__(self) -> str:
        return f"<OTResult {self.value:.6g}, {self.solved.message}>"

    @property
    def potentials(self) -> tuple[Array, Array]:
        """U and v with plan = exp(u + v - cost / reg), or c exp(u + v - cost / reg) if unbalanced.

        c is the product of the weights. These are the logarithms of POT's scalings.
        """
        found = self.solved
        uv = found.f / found.epsilon, found.g / found.epsilon
        if found.reach is not None:
            return uv
        weights = self.lazy_plan.source.weights, self.lazy_plan.target.weights
        with np.errstate(divide="ignore"):
            return uv[0] + np.log(weights[0]), uv[1] + np.log(weights[1])

    @property
    def potential_a(self) -> Array:
        """(N,) first of the potentials."""
        return self.potentials[0]

    @property
    def potential_b(self) -> Array:
        """(M,) second of the potentials."""
        return self.potentials[1]

    @property
    def marginals(self) -> tuple[Array, Array]:
        """(N,) and (M,) marginals of the plan."""
        return self.solved.row_mass, self.solved.column_mass

    @property
    def marginal_a(self) -> Array:
        """(N,) mass that leaves each source point."""
        return self.solved.row_mass

    @property
    def marginal_b(self) -> Array:
        """(M,) mass that arrives at each target point."""
        return self.solved.column_mass

    @cached_property
    def plan(self) -> AnyArray:
        """(N, M) array; InputError for a lazy result, whose plan is not to be formed."""
        if self.is_lazy:
            raise UnsupportedError(
                "the result is lazy: take parts of lazy_plan, or sparse_plan, or solve with "
                "lazy=False"
            )
        return self.lazy_plan[:]

    @cached_property
    def sparse_plan(self) -> Any:
        """`scipy.sparse.csr_array` of the pairs that matter, as `clmorph.transport_plan` keeps."""
        plan = self.lazy_plan
        pair = plan.source, plan.target
        return transport_plan(*pair, self.solved, backend=self.backend).to_scipy()

    @cached_property
    def value_linear(self) -> float:
        """Transport cost <C, plan> with the squared distance, over all pairs, without the plan."""
        plan = self.lazy_plan
        means = barycentric_plan(plan.source, plan.target, self.solved, backend=self.backend)
        squares = np.sum((plan.source.points - means.positions) ** 2, axis=1)
        spread = np.trace(means.covariance, axis1=1, axis2=2)
        return float(means.row_mass @ (squares + spread))

    @property
    def status(self) -> str:
        """How the solve ended: "Converged", or a sentence."""
        return "Converged" if self.solved.converged else self.solved.message

    @property
    def log(self) -> dict[str, Any]:
        """Number of iterations and residuals."""
        return {"niter": self.solved.n_iter, "err": self.solved.residuals}


def solve_sample(
    X_a: Any,
    X_b: Any,
    a: Any = None,
    b: Any = None,
    metric: str = "sqeuclidean",
    reg: float | None = None,
    c: Any = None,
    reg_type: str = "KL",
    unbalanced: Any = None,
    unbalanced_type: str = "KL",
    lazy: bool = False,
    batch_size: int | None = None,
    *,
    max_iter: int | None = None,
    tol: float | None = None,
    backend: Backend = "auto",
) -> OTResult:
    """Solve entropic transport between samples with the arguments and conventions of POT.

    It minimizes <C, P> + reg KL(P | a b^T) + unbalanced (KL(P 1 | a) + KL(P^T 1 | b)) with
    C_ij = |x_i - y_j|^2, so reg = 2 blur^2 and unbalanced = 2 reach^2.

    Parameters
    ----------
    X_a, X_b : (N, D) and (M, D) arrays
        Samples, in 1 to 1,024 dimensions.
    a, b : (N,) and (M,) arrays, optional
        Weights; uniform with sum 1 if not given.
    metric : str
        Only "sqeuclidean".
    reg : float
        Entropic regularization in units of C. It must be given: exact transport is not solved.
    c : None
        Only None: the reference is a b^T.
    reg_type : str
        Only "KL".
    unbalanced : float or a pair, optional
        Penalty of the marginals in units of C; None is balanced, as is None or infinity in a pair.
    unbalanced_type : str
        Only "KL".
    lazy : bool
        Whether `plan` of the result is refused; nothing else differs: no solve forms the plan.
    batch_size : int, optional
        Accepted and without effect.
    max_iter, tol, backend
        As in `clmorph.sinkhorn`; `tol` is 1e-6 if not given.

    Returns
    -------
    OTResult

    Raises
    ------
    InputError
        If an argument cannot be used. It is a NotImplementedError too if POT solves such problems.

    Warns
    -----
    ConvergenceWarning
        If the residual does not reach `tol`.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph.pot
    >>> x, y = np.array([[0.0], [0.5], [1.0]]), np.array([[0.25], [0.75]])
    >>> found = clmorph.pot.solve_sample(x, y, reg=0.02, unbalanced=0.2, lazy=True, backend="numpy")
    >>> found.status, found.lazy_plan[:2].round(3).tolist()
    ('Converged', [[0.275, 0.0], [0.146, 0.146]])
    """
    for name, word, only in (
        ("metric", metric, "sqeuclidean"), ("reg_type", reg_type, "kl"),
        ("unbalanced_type", unbalanced_type, "kl"),
    ):  # fmt: skip
        if not isinstance(word, str) or word.lower() != only:
            raise UnsupportedError(
                f"{name}={shown(word)}: expected {only!r}; use POT itself for others"
            )
    if c is not None:
        raise UnsupportedError(
            "c: expected None, the product of the weights; use POT itself for others"
        )
    if reg is None:
        raise UnsupportedError(
            "reg is missing: expected a positive number, as exact transport needs POT"
        )
    lazy = check_flag("lazy", lazy)
    # 1e-24 to 1e24: squares of lengths that the solver checks more closely
    epsilon = 0.5 * check_number("reg", reg, 1e-24, 1e24)
    source, target = as_pair(_samples("X_a", X_a, a), _samples("X_b", X_b, b))
    assert isinstance(source, WeightedPoints)
    assert isinstance(target, WeightedPoints)
    operations = get_backend(backend)
    solved = sinkhorn(
        source, target, epsilon=epsilon, rho=_penalties(unbalanced), backend=operations,
        tol=TOL if tol is None else tol,
        max_iter=SolverOptions.max_iter if max_iter is None else max_iter,
    )  # fmt: skip
    value = solved.dual
    if solved.reach is None:
        # POT's divergence of the balanced problem has no term of masses.
        value += epsilon * (solved.transported_mass - source.mass * target.mass)
    plan = LazyPlan(source, target, solved)
    return OTResult(2.0 * value, plan, solved, operations, is_lazy=lazy)


def _samples(name: str, points: Any, weights: Any) -> WeightedPoints:
    """Return samples as a measure, uniform if no weights are given."""
    points = as_floats(name, points, "samples (N, D)")
    if points.ndim != 2 or not len(points):
        raise InputError(f"{name} has shape {points.shape}: expected samples (N, D) with N > 0")
    if weights is None:
        weights = np.full(len(points), 1.0 / len(points))
    return WeightedPoints(points, as_floats(f"weights of {name}", weights, "weights (N,)"))


def _penalties(unbalanced: Any) -> Any:
    """Return rho, which is half of POT's penalties, as `clmorph.sinkhorn` takes it."""
    if unbalanced is None:
        return np.inf
    try:
        sides = [float(np.inf if each is None else each) for each in np.ravel(unbalanced).tolist()]
    except (TypeError, ValueError, OverflowError):
        sides = []
    if len(sides) not in (1, 2) or not all(side > 0 for side in sides):
        raise InputError(
            f"unbalanced={shown(unbalanced)}: expected a positive number, a pair of them, or None"
        )
    return 0.5 * sides[0] if len(set(sides)) == 1 else (0.5 * sides[0], 0.5 * sides[1])
