"""Unbalanced log-domain Sinkhorn (paper, 2.1 and 3.1), accelerated, on any backend."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from clmorph._shared.typing import Progress
from clmorph._shared.validation import (
    check_choice,
    check_flag,
    check_integer,
    check_number,
    check_progress,
    shown,
)
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import ConvergenceWarning, DeviceError, InputError
from clmorph.measures.points import AnyMeasure, MeasureLike, as_pair
from clmorph.transport._solver import geomloss as geomloss_schedule
from clmorph.transport._solver.iteration import SHORT, Iteration
from clmorph.transport._solver.multiscale import Multiscale
from clmorph.transport._solver.problem import Problem, largest_cost
from clmorph.transport._solver.softmin import MANY_PAIRS
from clmorph.transport._solver.state import measured
from clmorph.transport.options import (
    METHODS,
    PRECISIONS,
    AlgorithmOptions,
    Method,
    Precision,
    Reach,
    SolverOptions,
)
from clmorph.transport.potentials import Potentials, check_potentials
from clmorph.transport.regularization import Regularization, regularization

#: Values of `multiscale` beside True and False.
MULTISCALE = ("auto",)
#: Relative difference of masses up to which balanced transport is feasible.
MASS_TOLERANCE = 1e-6
#: Largest cost and largest rho, in units of epsilon: potentials are of their size, and beyond
#: this float64 itself leaves no digits for epsilon.
MAX_SPREAD = 1e12


def sinkhorn(
    source: MeasureLike,
    target: MeasureLike,
    blur: float | None = None,
    reach: Reach = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    method: Method = AlgorithmOptions.method,
    scaling: float = AlgorithmOptions.scaling,
    precision: Precision = AlgorithmOptions.precision,
    start: Potentials | None = None,
    progress: Progress | None = None,
    multiscale: bool | str = "auto",
    truncation: float | str | None = "auto",
    verify: bool = False,
) -> Potentials:
    """Solve unbalanced entropic optimal transport between two measures (paper, 2.1 and 3.1).

    It minimizes <C, pi> + rho KL(pi 1 | a) + rho KL(pi^T 1 | b) + epsilon KL(pi | a x b) over plans
    pi >= 0 with C = |X - Y|^2 / 2, epsilon = blur^2, rho = reach^2, in the log domain.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights (N,), points (N, D))
        Both in one space, with D from 1 to 11. Weights may be zero, and their sums may differ.
    blur : float, optional
        Entropic length scale, in the points' unit (for images: the longer side); 0.03 if neither
        `blur` nor `epsilon` is given.
    reach : float, None, or a pair (reach_source, reach_target)
        Length scale, in the points' unit, of the marginal penalty: beyond it mass is destroyed and
        created rather than moved. None, the default, is balanced transport, which needs equal
        masses. With a pair, each half belongs to one measure; one None is semi-unbalanced
        transport.
    tol : float
        Residual at which the iteration stops, in units of epsilon.
    max_iter : int
        Largest number of iterations; one iteration updates both potentials.
    backend : str or Operations
        See `clmorph.get_backend`.
    epsilon : float, optional
        blur^2, in place of `blur`.
    rho : float or a pair, optional
        reach^2, in place of `reach`; infinity is balanced.
    method : {"certified", "geomloss"}
        "certified" is accelerated and stops by the residual. "geomloss" runs the schedule of that
        library, which has no convergence test, to reproduce its numbers.
    scaling : float in (0, 1)
        Factor between the blurs of "geomloss".
    precision : {"auto", "float32", "float64"}
        Precision of exponents during the iteration. "auto" uses more than float32 only where `tol`
        needs it: float64 or, on a device without it, pairs of float32. The last softmins, from
        which residual and certificate follow, are more exact in any case.
    start : Potentials, optional
        Potentials of a similar problem with as many points, at which the iteration begins in place
        of annealing.
    progress : callable, optional
        Called with the share of the work that is done, from 0 to 1.
    multiscale : {"auto", True, False}
        Whether the problem is solved through coarser problems (`_solver.multiscale`); "auto" does
        so with 2^27 pairs of points or more. `n_iter` counts the iterations over the points.
    truncation : float, "auto" or None
        Largest error, in nats, that the logarithm of a row's or column's sum may have because far
        pairs are left out; it is proven and must be less than `tol`. `truncation_error` of the
        result is its bound. "auto" is tol / 10 with 2^27 pairs or more, else None. None sums all
        pairs.
    verify : bool
        Whether, with truncation, the last two softmins are computed once more over all pairs. The
        residual and the certificate are then those without truncation.

    Returns
    -------
    Potentials

    Raises
    ------
    InputError
        If an argument cannot be used, or the masses differ and `reach` is None.
    DeviceError
        If `precision` is "float64" and the device has none.

    Warns
    -----
    ConvergenceWarning
        If the residual does not reach `tol`.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, reach=0.3, backend="numpy")
    >>> potentials.converged, potentials.residual <= 1e-3
    (True, True)
    >>> round(potentials.transported_mass, 3)  # of 1: the rest is destroyed and created
    0.828
    >>> bool(potentials.dual <= potentials.primal)  # they enclose the optimal value
    True
    """
    given = regularization(blur, reach, epsilon, rho)
    tol, max_iter, scaling = check_solver_options(
        tol, max_iter, method, scaling, precision, multiscale
    )
    verify = check_flag("verify", verify)
    report = check_progress(progress)
    pair = as_pair(source, target)
    operations = get_backend(backend)
    check_problem(*pair, given, operations, precision)
    many = len(pair[0]) * len(pair[1]) >= MANY_PAIRS
    limit = choose_truncation(truncation, tol, many)
    g = None
    if start is not None:
        g = check_potentials("start", start, (len(pair[0]), len(pair[1]))).g
    problem = Problem.between(operations, *pair, given.rho, None if method == "geomloss" else limit)
    if method == "geomloss":
        return _geomloss(problem, given, scaling, tol, precision, report)
    iteration: Iteration | Multiscale
    options = given.blur, tol, max_iter, precision, report
    if multiscale == "auto":
        multiscale = many and max_iter >= SHORT
    iteration = Multiscale(problem, pair, *options) if multiscale else Iteration(problem, *options)
    iteration.run(g)
    if verify and limit is not None:
        _take_all_pairs(iteration, given.epsilon)
    return _finish(iteration, given, limit)


def check_solver_options(
    tol: Any = SolverOptions.tol,
    max_iter: Any = SolverOptions.max_iter,
    method: Any = "certified",
    scaling: Any = AlgorithmOptions.scaling,
    precision: Any = "auto",
    multiscale: Any = "auto",
) -> tuple[float, int, float]:
    """Check options of `sinkhorn` without doing any of its work.

    Returns
    -------
    tol, max_iter, scaling : float, int, float

    Raises
    ------
    InputError
        If one cannot be used.
    """
    check_choice("method", method, METHODS)
    check_choice("precision", precision, PRECISIONS)
    if not isinstance(multiscale, bool | np.bool_):
        check_choice("multiscale", multiscale, MULTISCALE)
    return (
        check_number("tol", tol, 0.0, 1e3, open_low=True),
        check_integer("max_iter", max_iter, 1, 10**9),
        check_number("scaling", scaling, 0.01, 0.999),
    )


def choose_truncation(truncation: Any, tol: float, many: bool) -> float | None:
    """Return the truncation in nats, see `sinkhorn`; None leaves out nothing."""
    if isinstance(truncation, str) and truncation == "auto":
        return 0.1 * tol if many else None
    if truncation is None:
        return None
    limit = check_number("truncation", truncation, 1e-9, 0.1)
    if limit >= tol:
        raise InputError(
            f"truncation={shown(truncation)}: it is part of the residual, so expected less than "
            f"tol={tol:g}; lower it (a tenth of tol is usual) or raise tol"
        )
    return limit


def _take_all_pairs(iteration: Iteration | Multiscale, epsilon: float) -> None:
    """Compute the last softmins once more, over all pairs."""
    problem, state = iteration.problem, iteration.state
    for softmin in (problem.to_rows, problem.to_columns):
        softmin.release()
    iteration.state = measured(problem, state.f, state.g, epsilon)
    if iteration.state.residual > iteration.tol and iteration.status == "converged":
        iteration.status = "precision"


def check_problem(
    source: AnyMeasure,
    target: AnyMeasure,
    given: Regularization,
    operations: Operations,
    precision: str,
) -> None:
    """Check that a problem has a solution, and that a backend can compute it.

    Raises
    ------
    InputError, DeviceError
        If not.
    """
    balanced = all(np.isinf(rho) for rho in given.rho)
    if balanced and abs(source.mass - target.mass) > MASS_TOLERANCE * source.mass:
        raise InputError(
            f"the masses {source.mass:g} and {target.mass:g} differ, so balanced transport is "
            "impossible: give a reach, or scale the weights to one mass"
        )
    largest = largest_cost(source.points, target.points)
    if largest > MAX_SPREAD * given.epsilon:
        enough = 1.1 * np.sqrt(largest / MAX_SPREAD)  # still enough when rounded
        raise InputError(
            f"blur={given.blur:g} is too small for points up to {np.sqrt(2 * largest):.3g} apart: "
            f"expected at least {enough:.2g}; raise it, or scale the points"
        )
    for rho in given.rho:
        if np.isfinite(rho) and rho > MAX_SPREAD * given.epsilon:
            raise InputError(
                f"reach={rho**0.5:g} is too large for blur={given.blur:g}: expected at most "
                f"{np.sqrt(MAX_SPREAD) * given.blur:g}, or None (balanced) for equal masses"
            )
    if precision == "float64" and not operations.has_float64:
        raise DeviceError(
            f"precision='float64': {operations.description} has no double precision; use "
            "'auto' (pairs of float32 where needed), another device, or the backend 'numpy'"
        )


def _geomloss(
    problem: Problem,
    given: Regularization,
    scaling: float,
    tol: float,
    precision: str,
    report: Progress,
) -> Potentials:
    rounding = problem.rounding(given.epsilon, precise=False)
    precise = precision == "float64" or (precision == "auto" and rounding > 0.1 * tol)
    f, g = geomloss_schedule.run(problem, given.blur, scaling, precise, report)
    n_iter = problem.n_softmin // 2
    state = measured(problem, f, g, given.epsilon)
    residual = state.residual
    return Potentials(
        f, g, given.blur, given.reach,
        status="converged" if residual <= tol else "schedule",
        message=f"GeomLoss's schedule, {n_iter} iterations, left a residual of {residual:.1e} "
        "epsilon; method='certified' goes on until it is small",
        n_iter=n_iter, residual=residual, residuals=np.array([residual]),
        certificate=problem.certificate(f, g, state.t_rows, state.t_columns, given.epsilon),
        precise=precise,
        truncation_error=problem.error,
    )  # fmt: skip


def _finish(
    iteration: Iteration | Multiscale, given: Regularization, truncation: float | None
) -> Potentials:
    """Return the potentials, and warn if they did not reach the tolerance."""
    problem, state = iteration.problem, iteration.state
    reached = f"residual {state.residual:.1e} epsilon"
    missed = (
        f"not converged after {iteration.n_iter} iterations: {reached}, wanted {iteration.tol:.1e}"
    )
    message = {
        "converged": f"converged in {iteration.n_iter} iterations ({reached})",
        "max_iter": f"{missed}; raise max_iter, or use a larger blur or a smaller reach",
        "precision": f"{missed}; rounding can leave {iteration.rounding:.0e} here, so raise tol or "
        "blur, or use " + ("precision='auto'" if iteration.precision == "float32" else "'numpy'"),
    }[iteration.status]
    warn_unless_converged(iteration.status, message)
    return Potentials(
        state.f, state.g, given.blur, given.reach, iteration.status, message, iteration.n_iter,
        state.residual, np.array(iteration.residuals),
        problem.certificate(state.f, state.g, state.t_rows, state.t_columns, given.epsilon),
        iteration.precise, truncation, problem.error, problem.visited,
    )  # fmt: skip


def warn_unless_converged(status: str, message: str) -> None:
    """Warn the caller of the public function that calls this through one private one."""
    if status != "converged":
        warnings.warn(message, ConvergenceWarning, stacklevel=4)
