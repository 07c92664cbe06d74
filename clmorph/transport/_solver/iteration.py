"""The accelerated iteration behind `clmorph.sinkhorn`.

The solver maximizes the dual at a sequence of falling blurs (annealing). At each blur it
extrapolates the half-steps of Sinkhorn (`_solver.anderson`). It takes an extrapolation back if the
dual is then below the value that the plain half-step had reached, by more than rounding explains.
So but for rounding the dual never falls at one blur, and the limit is that of the plain iteration.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from clmorph._shared.progress import Share
from clmorph._shared.typing import Array
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.state import (
    ROUNDING_MARGIN,
    State,
    measured,
    needs_more,
    share_done,
    slack_of,
)
from clmorph.transport._solver.steps import Reached, Steps, new_steps

#: Factor between the blurs of the annealing.
ANNEALING = 0.5
#: The annealing begins below this share of the joint diameter of both measures.
TOP = 0.5
#: There is no annealing where damping alone contracts the iteration by at least this factor.
EASY = 0.5
#: Residual, in units of its own epsilon, at which the iteration leaves a level before the last.
LEVEL_TOLERANCE = 0.2
#: Largest share of the allowed iterations that the annealing takes.
ANNEALING_SHARE = 0.5
#: With fewer allowed iterations than this there is neither annealing nor extrapolation, because
#: they would cost more than they save.
SHORT = 20
#: The usual patience: iterations without a new best residual after which the iteration ends, as
#: rounding is then the reason. Residuals of balanced problems were seen to fall by less than a
#: tenth in twelve iterations and to go on falling.
STALLED = 25
#: Shares of the tolerance that are tried one after the other where the final residual, the bound
#: of its rounding included, is above the tolerance.
REPEATED = (0.8, 0.4)
#: Exact sums take over where the bound of their rounding is this share of the tolerance at most.
EXACT_SHARE = 0.5
#: A dual may fall by this many times the largest fall that was seen after a plain half-step.
NOISE_MARGIN = 2.0
#: The iteration changes from float32 to better exponents at this many times the measured rounding
#: of float32.
LEAVING_MARGIN = 4.0


class Iteration:
    """One solve by Sinkhorn's iteration, annealed and extrapolated.

    Parameters
    ----------
    problem : Problem
    blur : float
        Blur of the last level.
    tol : float
        Residual to reach there, in units of epsilon.
    max_iter : int
        Largest number of iterations, those of the annealing included; one iteration takes two
        softmins.
    precision : {"auto", "float32", "float64"}
    report : callable
        A function that is called with the share of the work that is done.
    certify : bool
        Whether the last softmins are `Problem.bounded_softmins`, which a certificate needs.
    patience : int
        Iterations without a new best residual after which the iteration ends, if rounding explains
        that.
    exact : bool
        Whether the levels before the last are solved to `tol`, too, and all with exact sums: where
        groups of points stand far apart, mass finds its way between them at large blurs alone.

    Attributes
    ----------
    state : State
        The result: potentials, softmins and residual.
    status : {"converged", "max_iter", "precision"}
    residuals : list of float
    rounding : float
        Largest residual that rounding alone can cause, in units of epsilon.
    precise : bool
        Whether float32 exponents were too coarse for `tol`.
    n_measured : int
        Number of softmins that only measured or certified: they are no iterations.
    """

    state: State
    status: str
    rounding: float
    precise: bool

    def __init__(
        self,
        problem: Problem,
        blur: float,
        tol: float,
        max_iter: int,
        precision: str,
        report: Callable[[float], None],
        certify: bool = True,
        patience: int = STALLED,
        exact: bool = False,
    ) -> None:
        self.problem, problem.exact_sums = problem, exact
        self._level_tol = tol if exact else LEVEL_TOLERANCE
        self.tol, self.precision, self._certify = tol, precision, certify
        self._patience = patience
        self.residuals: list[float] = []
        self._blur, self._max_iter, self._report = blur, max_iter, report
        self._done, self._level_share, self._reported = 0.0, 1.0, 0.0
        self.n_measured = 0

    @property
    def n_iter(self) -> int:
        """Iterations so far; softmins that only measure or certify do not count."""
        return -(-(self.problem.n_softmin - self.n_measured) // 2)

    def run(self, start: Array | None) -> None:
        """Iterate from potentials g, or from the largest blur of the annealing."""
        g = np.zeros(len(self.problem.b)) if start is None else start
        levels = []
        if start is None:
            levels = annealing(self.problem, self._blur, self.problem.largest_cost, self._max_iter)
        self._level_share = 1.0 / (len(levels) + 3)
        before: tuple[float, Array] | None = None
        for number, level in enumerate(levels):
            epsilon = level**2
            limit = int(ANNEALING_SHARE * self._max_iter)
            precise = needs_more(self.problem, self.precision, epsilon, self._level_tol)
            reached = self._iterate(g, epsilon, self._level_tol, limit, precise).g
            g = reached
            if before is not None:
                # Potentials are close to linear in epsilon, so the line through the last two
                # levels is continued to the next one.
                following = (levels[number + 1] if number + 1 < len(levels) else self._blur) ** 2
                g = g + (reached - before[1]) * (epsilon - following) / (before[0] - epsilon)
            before = epsilon, reached
            self._done += self._level_share
        self._level_share = 1.0 - self._done
        self._last_level(g)
        self._report_share(1.0)

    def _report_share(self, share: float) -> None:
        """Report the share of the work that is done, which never falls, and the residual."""
        self._reported = max(self._reported, share)
        note = f"residual {self.residuals[-1]:.0e} of {self.tol:.0e}" if self.residuals else ""
        self._report(Share(self._reported, note))

    def _last_level(self, g: Array) -> None:
        """Iterate in float32 as far as its rounding allows, then with better exponents."""
        epsilon, limit = self._blur**2, self._max_iter
        self.precise = needs_more(self.problem, self.precision, epsilon, self.tol)
        operations = self.problem.operations
        steps = new_steps(self.problem)
        if self.precision == "auto" and operations.exponent_roundoff > operations.precise_roundoff:
            coarse_tol = self.tol
            if self.precise:
                coarse_tol = max(self.tol, LEAVING_MARGIN * self._measured_rounding(g, epsilon))
            reached = self._iterate(
                g, epsilon, coarse_tol, limit, precise=False, steps=steps, leave=True
            )
            out = self.status == "max_iter" and reached.residual > coarse_tol
            if out or not self.precise:
                # Float32 was enough if precise softmins confirm the residual.
                self._measure(reached, epsilon, precise=True)
                if out or self.status == "converged":
                    return
            precise, g = True, reached.g
        else:
            precise = self.precise
        for share in (1.0, *REPEATED):
            reached = self._iterate(g, epsilon, share * self.tol, limit, precise, steps)
            converged = self.status == "converged"
            self._measure(reached, epsilon, precise)
            options = self.status, self.precision, self.tol, self.problem.error
            if self._certify and may_sum_exactly(self.problem, *options):
                self.problem.exact_sums, g = True, reached.g
                steps = new_steps(self.problem)
                continue
            if self.status == "converged" or not converged or self.n_iter >= limit:
                return
            # The bound of the rounding lifted the residual above the tolerance: iterate further.
            g = reached.g

    def _measure(self, reached: Reached, epsilon: float, precise: bool) -> None:
        """Compute the softmins of the potentials that are returned, and their residual."""
        f, g, t_columns, _, was_precise = reached
        if self._certify:
            self.state = measured(self.problem, f, g, epsilon)
        else:
            t_rows = self.problem.softmin_rows(g, epsilon, precise)
            self.n_measured += 1
            if precise != was_precise:
                t_columns = self.problem.softmin_columns(f, epsilon, precise)
                self.n_measured += 1
            residual = self.problem.residual(f, g, t_rows, t_columns, epsilon)
            self.state = State(f, g, t_rows, t_columns, residual)
        self.residuals.append(self.state.residual)
        if self.state.residual <= self.tol:
            self.status = "converged"
        elif self.status == "converged":
            # In exact arithmetic the last half-step can only lower the residual.
            self.status = "precision"

    def _measured_rounding(self, g: Array, epsilon: float) -> float:
        """Return by how much T(g) changes with precise exponents, in units of epsilon."""
        coarse = self.problem.softmin_rows(g, epsilon, precise=False)
        fine = self.problem.softmin_rows(g, epsilon, precise=True)
        self.n_measured += 2
        return float(np.abs(coarse - fine)[self.problem.a > 0].max() / epsilon)

    def _iterate(
        self,
        g: Array,
        epsilon: float,
        tol: float,
        limit: int,
        precise: bool,
        steps: Steps | None = None,
        leave: bool = False,
    ) -> Reached:
        """Iterate at one epsilon until the residual is `tol` or `limit` iterations are over.

        The iteration also ends where the residual no longer falls and rounding explains that. With
        `leave`, which means that better exponents can take over, it ends there for any reason:
        the residual of a slow problem falls by less in an iteration than float32 resolves.
        """
        problem = self.problem
        self.rounding = rounding = ROUNDING_MARGIN * problem.rounding(epsilon, precise)
        steps = steps or new_steps(problem)
        steps.begin(g, epsilon, precise)
        extrapolated = False
        floor = -np.inf  # the dual that the plain iteration had reached
        noise = 0.0
        first, best, since_best = 0.0, np.inf, 0
        while True:
            steps.update_rows()
            mass, dual = steps.row_dual
            if not extrapolated:
                # A half-step does not lower the dual: rounding does, or pairs left out.
                noise = max(noise, NOISE_MARGIN * (floor - dual))
            else:
                slack = noise + slack_of(problem, floor, rounding, mass, epsilon)
                if not dual >= floor - slack:
                    steps.take_back()
                    extrapolated = False
                    continue
                steps.accept()
            residual = steps.update_columns()
            self.residuals.append(residual)
            first = first or residual
            since_best = 0 if residual < 0.9 * best else since_best + 1
            best = min(best, residual)
            self._report_share(self._done + self._level_share * share_done(first, best, tol))
            stalled = since_best >= self._patience and (leave or residual <= rounding)
            ended = stalled or self.n_iter >= limit or steps.outside_trust_region()
            if residual <= tol or ended:
                self.status = "max_iter"
                if residual <= tol:
                    self.status = "converged"
                elif stalled:
                    self.status = "precision"
                return steps.reached(residual)
            problem.settle(residual)
            floor = steps.column_dual
            # An extrapolation can cost one softmin more, which the limit must allow.
            extrapolated = steps.go_on(self.n_iter + 1 < limit and self._max_iter >= SHORT)


def may_sum_exactly(problem: Problem, status: Any, precision: str, tol: float, error: Any) -> Any:
    """Return whether sums in float32 have ended a solve, whose tolerance exact sums can reach.

    Parameters
    ----------
    problem : Problem
    status : str, or an array of them
        As in `Iteration`.
    precision, tol
        As in `Iteration`.
    error : float, or an array of them
        Bounds of the errors of `bounded_softmins`.
    """
    operations = problem.operations
    coarse = operations.sum_roundoff > operations.precise_roundoff and not problem.exact_sums
    possible = coarse and precision == "auto" and problem.truncation is None
    return possible & (status == "precision") & (error < EXACT_SHARE * tol)


def annealing(problem: Problem, blur: float, largest_cost: float, max_iter: int) -> list[float]:
    """Return the blurs of the annealing, falling, without the last one.

    Parameters
    ----------
    problem : Problem
    blur : float
        The last blur.
    largest_cost : float
        Upper bound of the cost.
    max_iter : int
    """
    slowest = np.prod(problem.damping(blur**2))
    if slowest <= EASY or max_iter < SHORT:
        return []
    top = top_blur(largest_cost)
    level = blur / ANNEALING
    levels: list[float] = []
    while level < top and len(levels) < max_iter // 8:
        levels.append(level)
        level /= ANNEALING
    return levels[::-1]


def top_blur(largest_cost: Any) -> Any:
    """Return the blur below which the annealing begins, by the largest cost."""
    return TOP * np.sqrt(2 * largest_cost)
