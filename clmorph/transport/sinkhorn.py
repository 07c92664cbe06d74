"""Unbalanced log-domain Sinkhorn (paper, 2.1 and 3.1), accelerated, on any backend."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, Progress
from clmorph._shared.validation import check_choice, check_flag, check_progress
from clmorph.backends.interface import Operations
from clmorph.backends.multi_device import for_one_solve
from clmorph.backends.records import LastPasses
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.measures.grid import are_grids
from clmorph.measures.measure import Measure
from clmorph.measures.points import MeasureLike, Pair, as_pair
from clmorph.transport._solver.iteration import SHORT, Iteration, Outcome
from clmorph.transport._solver.multiscale import Multiscale
from clmorph.transport._solver.problem import Problem, check_problem, choose_truncation, is_large
from clmorph.transport._solver.symmetric import is_symmetric, solve_symmetric
from clmorph.transport.options import AlgorithmOptions, Method, Precision, Reach, SolverOptions
from clmorph.transport.potentials import Potentials, check_potentials
from clmorph.transport.regularization import Goal, refuses_other_order, regularization

#: The residual that potentials may keep by their own rounding, relative to the largest one.
SIZE_ROUNDING = 32 * np.finfo(float).eps
#: Potentials of this many times the largest cost come from a reach of many blurs.
LARGE_POTENTIALS = 4.0


@refuses_other_order
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
    source, target : Measure, Grid, WeightedPoints, (weights (N,), points (N, D)), or (N, D) array
        Both in one space, with D from 1 to 1,024. Weights may be zero, and their sums may differ.
        Points alone weigh 1 / N each.
    blur : float, optional
        Entropic length scale, in the points' unit (for images: the longer side); 0.03 if neither
        `blur` nor `epsilon` is given.
    reach : float, None, or a pair (reach_source, reach_target)
        Length scale, in the points' unit, of the marginal penalty: beyond it mass is destroyed and
        created rather than moved. None, the default, is balanced transport, which needs equal
        masses: they may differ by a millionth, and by half of `tol`. With a pair, each half belongs
        to one measure; one None is semi-unbalanced transport.
    tol : float
        Residual at which the iteration stops, in units of epsilon.
    max_iter : int
        Largest number of iterations; one iteration updates both potentials.
    backend : str, object of pyopencl, or Operations
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
        A function that is called with the share of the work that is done, from 0 to 1.
    multiscale : {"auto", True, False}
        Whether the problem is solved through coarser problems (`_solver.multiscale`). "auto" means
        True with 2^27 pairs of points or more in up to 11 dimensions. `n_iter` counts the
        iterations over the points.
    truncation : float, "auto" or None
        Largest error, in nats, that the logarithm of a row's or column's sum may have because far
        pairs are left out; it is proven and must be less than `tol`. `truncation_error` of the
        result is its bound. "auto" is tol / 10 where `multiscale="auto"` means True, else None.
        None sums all pairs.
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
    AlgorithmOptions.checked("method", method)
    scaling = AlgorithmOptions.checked("scaling", scaling)
    if not isinstance(multiscale, bool | np.bool_):
        check_choice("multiscale", multiscale, ("auto",))
    goal = regularization(blur, reach, epsilon, rho, tol, max_iter, precision)
    verify = check_flag("verify", verify)
    report = check_progress(progress)
    pair = as_pair(source, target)
    if are_grids(*pair) and (multiscale is True or not isinstance(truncation, str | None)):
        raise InputError(
            "between grids all cells are summed, an axis after the other: expected truncation and "
            "multiscale as they are by default"
        )
    operations = for_one_solve(get_backend(backend))
    check_problem(pair, goal, operations)
    g = None
    if start is not None:
        g = check_potentials("start", start, (len(pair[0]), len(pair[1]))).g
    if method == "geomloss":
        choose_truncation(truncation, goal.tol, False)  # it is checked, and not used
        found = _geomloss(Problem.between(operations, *pair, goal.rho), goal, scaling, report)
    else:
        found = solve(
            operations, pair, goal, report, truncation=truncation, g=g, multiscale=multiscale,
            verify=verify, keep=True,
        )  # fmt: skip
        warn_unless_converged(found.status, found.message, 4)
    # Points of a cost with a metric for each source pixel have no coordinates of their own.
    foreign = isinstance(source, Measure) and source.has_metric_map
    return found if foreign else replace(found, measures=pair)


def solve(
    operations: Operations,
    pair: Pair,
    goal: Goal,
    report: Progress,
    *,
    truncation: Any = "auto",
    clouds: tuple[Any, Any] | None = None,
    g: Array | None = None,
    multiscale: bool | str = "auto",
    verify: bool = False,
    keep: bool = False,
    exact: bool = False,
) -> Potentials:
    """Solve one problem by the certified iteration from g, (M,), if given, without a warning.

    The problem of a measure with itself has equal potentials, unless it is solved through coarser
    problems or from g. With `keep` the result keeps the near pairs, if it has such.
    """
    many = is_large(pair, operations)
    limit = choose_truncation(truncation, goal.tol, many)
    problem = Problem.between(operations, *pair, goal.rho, limit, clouds)
    ended: Outcome
    if g is None and multiscale is not True and is_symmetric(pair, goal.rho):
        ended = solve_symmetric(problem, goal, report).outcome()
    elif many and goal.max_iter >= SHORT if multiscale == "auto" else multiscale:
        ended = Multiscale(problem, pair, goal, report).run(g)
    else:
        ended = Iteration(problem, goal, report, exact=exact).run(g).outcome()
    if verify and limit is not None:
        # The last softmins are computed once more, over all pairs.
        for softmin in problem.softmins:
            softmin.release()
        ended.state = problem.measured(ended.state.f, ended.state.g, goal.epsilon)
        if ended.state.residual > goal.tol and ended.status == "converged":
            ended.status = "precision"
    found = finish(ended, limit)
    return replace(found, passes=_passes(ended)) if keep else found


def _passes(ended: Outcome) -> LastPasses | None:
    """Return what the last softmins have found out; None if they have summed all pairs."""
    problem, state = ended.problem, ended.state
    near = problem.to_rows.near, problem.to_columns.near
    if near[0] is None or near[1] is None:
        return None
    return LastPasses(
        problem.operations, (state.f, state.g), (state.t_rows, state.t_columns),
        (near[0], near[1]), (problem.rows, problem.columns),
    )  # fmt: skip


def _geomloss(problem: Problem, goal: Goal, scaling: float, report: Progress) -> Potentials:
    """Run GeomLoss's schedule: one averaged step at each blur, without a test of convergence."""
    rounding = problem.rounding(goal.epsilon, precise=False)
    precise = goal.precision == "float64" or (
        goal.precision == "auto" and rounding > 0.1 * goal.tol
    )
    schedule = geomloss_blurs(float(np.sqrt(2 * problem.largest_cost)), goal.blur, scaling)

    def both(f: Array, g: Array, epsilon: float) -> tuple[Array, Array]:
        source, target = problem.damping(epsilon)
        new_f = source * problem.softmin(0, g, epsilon, precise)
        return new_f, target * problem.softmin(1, f, epsilon, precise)

    f, g = both(np.zeros(len(problem.a)), np.zeros(len(problem.b)), schedule[0] ** 2)
    for number, level in enumerate(schedule):
        new_f, new_g = both(f, g, level**2)
        f, g = 0.5 * (f + new_f), 0.5 * (g + new_g)
        report((number + 1) / len(schedule))
    f, g = both(f, g, goal.epsilon)
    n_iter = len(schedule) + 2
    state = problem.measured(f, g, goal.epsilon)
    residual = state.residual
    return Potentials(
        f, g, goal.blur, goal.reach,
        status="converged" if residual <= goal.tol else "schedule",
        message=f"GeomLoss's schedule, {n_iter} iterations, left a residual of {residual:.1e} "
        "epsilon; method='certified' goes on until it is small",
        n_iter=n_iter, residual=residual, residuals=np.array([residual]),
        certificate=problem.certificate(f, g, state.t_rows, state.t_columns, goal.epsilon),
        precise=precise,
        truncation_error=problem.error,
    )  # fmt: skip


def geomloss_blurs(diameter: float, blur: float, scaling: float) -> list[float]:
    """Return the diameter twice, then blurs that fall by `scaling`, then `blur`.

    Source: Feydy et al., "Interpolating between optimal transport and MMD using Sinkhorn
    divergences" (2019), and the GeomLoss library.
    """
    if diameter <= 0.0:
        return [blur, blur]
    # The schedule is computed from logarithms of epsilon, as in GeomLoss, because one step more or
    # less would change the result.
    falling = np.arange(2 * np.log(diameter), 2 * np.log(blur), 2 * np.log(scaling))
    return [diameter, *np.exp(falling / 2), blur]


def finish(ended: Outcome, truncation: float | None) -> Potentials:
    """Return the potentials that the iteration has reached."""
    problem, state, goal = ended.problem, ended.state, ended.goal
    return Potentials(
        state.f, state.g, goal.blur, goal.reach, ended.status, _how(ended), ended.n_iter,
        state.residual, np.array(ended.residuals),
        problem.certificate(state.f, state.g, state.t_rows, state.t_columns, goal.epsilon),
        ended.precise, truncation, problem.error, problem.visited,
    )  # fmt: skip


def _how(ended: Outcome) -> str:
    """Return how a solve ended, and a remedy if it missed; numbers are in units of epsilon."""
    reached = f"residual {ended.state.residual:.1e} epsilon"
    missed = (
        f"not converged after {ended.n_iter} iterations: {reached}, wanted {ended.goal.tol:.1e}"
    )
    other = "precision='auto'" if ended.goal.precision == "float32" else "'numpy'"
    rounding, remedy = ended.rounding, f"raise tol or blur, or use {other}"
    largest = max(float(np.abs(each).max()) for each in (ended.state.f, ended.state.g))
    of_size = SIZE_ROUNDING * largest / ended.goal.epsilon
    large = largest > LARGE_POTENTIALS * float(np.max(ended.problem.largest_cost))
    if of_size > rounding and large and ended.goal.reach is not None:
        rounding, remedy = of_size, "raise tol, or use a smaller reach"
    return {
        "converged": f"converged in {ended.n_iter} iterations ({reached})",
        "max_iter": f"{missed}; raise max_iter, or use a larger blur or a smaller reach",
        "precision": f"{missed}; rounding can leave {rounding:.0e} here, so {remedy}",
    }[ended.status]


def warn_unless_converged(status: str, message: str, frames: int = 3) -> None:
    """Warn the caller of the function that calls this; frames: one more if that is decorated."""
    if status != "converged":
        warnings.warn(message, ConvergenceWarning, stacklevel=frames)
