"""Unbalanced log-domain Sinkhorn (paper, 2.1 and 3.1), accelerated. Knows no device."""

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

#: Or a bool.
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
    """Solve unbalanced entropic optimal transport between two measures.

    Minimizes <C, pi> + rho KL(pi 1 | a) + rho KL(pi^T 1 | b) + epsilon KL(pi | a x b) with
    C = |X - Y|^2 / 2, epsilon = blur^2, rho = reach^2, in the log domain.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights (N,), points (N, D))
        Of one space: D from 1 to 11. Zero weights are legal, and so are any total masses.
    blur : float, optional
        Entropic length scale, in the points' unit (for images: the longer side); 0.03 if neither
        `blur` nor `epsilon` is given.
    reach : float, None, or a pair (reach_source, reach_target)
        Length scale beyond which mass is created and destroyed rather than moved, same unit. None,
        the default, is balanced transport: the masses must then be equal. With a pair, each half
        bounds one measure; one None is semi-unbalanced transport.
    tol : float
        Residual at which to stop, in units of epsilon.
    max_iter : int
        Iterations (one is both updates) after which to stop all the same.
    backend : str or Operations
        See `clmorph.get_backend`.
    epsilon : float, optional
        blur^2, in place of `blur`.
    rho : float or a pair, optional
        reach^2, in place of `reach`; infinity is balanced.
    method : {"certified", "geomloss"}
        "certified" accelerates and stops by the residual. "geomloss" runs that library's
        schedule, without a convergence test, to reproduce its numbers.
    scaling : float in (0, 1)
        Factor between the blurs of "geomloss".
    precision : {"auto", "float32", "float64"}
        Of exponents, while it iterates. "auto" takes more than float32 only where `tol` needs it,
        from float64 or, on a device without it, from pairs of float32. The last softmins, of which
        residual and certificate are made, are more exact in any case.
    start : Potentials, optional
        Of a similar problem with as many points: where to begin, instead of annealing.
    progress : callable, optional
        Called now and then with the share done.
    multiscale : {"auto", True, False}
        Whether to solve through coarser problems (`_solver.multiscale`); "auto" does with
        2^27 pairs of points or more. `n_iter` counts the iterations over the points.
    truncation : float, "auto" or None
        Far pairs are left out of the sums as long as this provably lowers no row's or column's
        logarithm by more than so many nats, fewer than `tol`; `truncation_error` says what was left
        out at most. "auto": tol / 10 with 2^27 pairs or more, else None, which leaves out nothing.
    verify : bool
        With truncation: take the last two softmins once more, over all pairs. The residual and
        the certificate are then those without truncation.

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
    """Return what pairs may be left out for, in nats; None for nothing."""
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
    """Replace the last softmins by such over all pairs."""
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
    """Put the result together, and warn if it is not what was asked for."""
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
