"""The accelerated iteration behind `clmorph.sinkhorn`.

The dual is climbed from level to level of a falling blur (annealing); inside a level the
half-steps of Sinkhorn are extrapolated (`_solver.anderson`), and an extrapolation after which
the dual is not at least what the plain half-step had reached is taken back. So the dual never
falls inside a level, and what is converged to is the plain iteration's.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import Share
from clmorph.transport._solver.anderson import Anderson
from clmorph.transport._solver.problem import Problem, inner

Array = NDArray[np.float64]

#: Factor between the blurs of the annealing.
ANNEALING = 0.5
#: The annealing begins below this share of the diameter.
TOP = 0.5
#: No annealing where damping alone contracts the iteration by at least this factor.
EASY = 0.5
#: Residual at which a level above the last one is left, in units of its epsilon.
LEVEL_TOLERANCE = 0.2
#: The annealing may take this share of the iterations; with a small limit it is cut short.
ANNEALING_SHARE = 0.5
#: With fewer iterations than this there is neither annealing nor extrapolation: what they
#: cost would not be won back.
SHORT = 20
#: Iterations without a new best residual after which rounding is held to be the reason. Balanced
#: problems have fallen by less than a tenth in twelve, and gone on.
STALLED = 25
#: A residual of so many times the bound on the rounding of one softmin can be due to it.
ROUNDING_MARGIN = 8.0
#: Shares of the tolerance to iterate to, one after the other, where the residual as measured in
#: the end, with the bound of its rounding, is above the tolerance.
REPEATED = (0.8, 0.4)
#: Float32 is left for better exponents at so many times its rounding as measured.
LEAVING_MARGIN = 4.0


class State(NamedTuple):
    """Potentials with their softmins, T(g) and T(f)."""

    f: Array
    g: Array
    t_rows: Array
    t_columns: Array
    residual: float


def measured(problem: Problem, f: Array, g: Array, epsilon: float) -> State:
    """Return potentials with softmins, and a residual, of which every rounding is bounded."""
    softmins = problem.bounded_softmins(f, g, epsilon)
    return State(f, g, *softmins, problem.residual(f, g, *softmins, epsilon))


class _Reached(NamedTuple):
    """Where a level was left: its last half-step taken, not yet measured."""

    f: Array
    g: Array
    t_columns: Array
    residual: float  # before that half-step
    precise: bool


class Ascent:
    """One solve.

    Parameters
    ----------
    problem : Problem
    blur : float
        Of the last level.
    tol : float
        Residual to reach there, in units of epsilon.
    max_iter : int
        Iterations, one is two softmins; the annealing's included.
    precision : {"auto", "float32", "float64"}
    report : callable
        Called with the share done.
    certify : bool
        Whether the last softmins are `Problem.bounded_softmins`, as certificates need them.

    Attributes
    ----------
    state : State
        What was reached.
    status : {"converged", "max_iter", "precision"}
    residuals : list of float
    rounding : float
        Residual that rounding alone can leave, in units of epsilon.
    precise : bool
        Whether float32 exponents were too coarse for `tol`.
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
    ) -> None:
        self.problem = problem
        self.tol, self.precision, self._certify = tol, precision, certify
        self.residuals: list[float] = []
        self._blur, self._max_iter, self._report = blur, max_iter, report
        self._done, self._level_share, self._told = 0.0, 1.0, 0.0
        self._measured = 0  # softmins that were no updates

    @property
    def n_iter(self) -> int:
        """Iterations so far; what only measures or certifies is not one."""
        return -(-(self.problem.n_softmin - self._measured) // 2)

    def run(self, start: Array | None) -> None:
        """Climb from potentials g, or from the top of the annealing."""
        g = np.zeros(len(self.problem.b)) if start is None else start
        levels = [] if start is not None else self._levels()
        self._level_share = 1.0 / (len(levels) + 3)
        before: tuple[float, Array] | None = None
        for number, level in enumerate(levels):
            epsilon = level**2
            limit = int(ANNEALING_SHARE * self._max_iter)
            precise = needs_more(self.problem, self.precision, epsilon, LEVEL_TOLERANCE)
            reached = self._climb(g, epsilon, LEVEL_TOLERANCE, limit, precise).g
            g = reached
            if before is not None:
                # Potentials are close to linear in epsilon: go on along the line.
                following = (levels[number + 1] if number + 1 < len(levels) else self._blur) ** 2
                g = g + (reached - before[1]) * (epsilon - following) / (before[0] - epsilon)
            before = epsilon, reached
            self._done += self._level_share
        self._level_share = 1.0 - self._done
        self._last_level(g)
        self._tell(1.0)

    def _tell(self, share: float) -> None:
        """Report the share done, which never falls, and the residual reached."""
        self._told = max(self._told, share)
        note = f"residual {self.residuals[-1]:.0e} of {self.tol:.0e}" if self.residuals else ""
        self._report(Share(self._told, note))

    def _levels(self) -> list[float]:
        """Blurs from about the diameter down to the last but one."""
        slowest = np.prod(self.problem.damping(self._blur**2))
        if slowest <= EASY or self._max_iter < SHORT:
            return []
        top = TOP * np.sqrt(2 * self.problem.largest_cost)
        level = self._blur / ANNEALING
        levels: list[float] = []
        while level < top and len(levels) < self._max_iter // 8:
            levels.append(level)
            level /= ANNEALING
        return levels[::-1]

    def _last_level(self, g: Array) -> None:
        """Climb in float32 as far as it goes, then precisely."""
        epsilon, limit = self._blur**2, self._max_iter
        self.precise = needs_more(self.problem, self.precision, epsilon, self.tol)
        operations = self.problem.operations
        memory = Anderson()
        if self.precision == "auto" and operations.exponent_roundoff > operations.precise_roundoff:
            coarse_tol = self.tol
            if self.precise:
                coarse_tol = max(self.tol, LEAVING_MARGIN * self._measured_rounding(g, epsilon))
            reached = self._climb(
                g, epsilon, coarse_tol, limit, precise=False, memory=memory, leave=True
            )
            out = self.status == "max_iter" and reached.residual > coarse_tol
            if out or not self.precise:
                # Float32 was enough, if precise softmins agree.
                self._measure(reached, epsilon, precise=True)
                if out or self.status == "converged":
                    return
            precise, g = True, reached.g
        else:
            precise = self.precise
        for share in (1.0, *REPEATED):
            reached = self._climb(g, epsilon, share * self.tol, limit, precise, memory)
            converged = self.status == "converged"
            self._measure(reached, epsilon, precise)
            if self.status == "converged" or not converged or self.n_iter >= limit:
                return
            # Rounding took back what was missing: ask for a little more.
            g = reached.g

    def _measure(self, reached: _Reached, epsilon: float, precise: bool) -> None:
        """Take the softmins of the potentials that are returned, and their residual."""
        f, g, t_columns, _, was_precise = reached
        if self._certify:
            self.state = measured(self.problem, f, g, epsilon)
        else:
            t_rows = self.problem.softmin_rows(g, epsilon, precise)
            self._measured += 1
            if precise != was_precise:
                t_columns = self.problem.softmin_columns(f, epsilon, precise)
                self._measured += 1
            residual = self.problem.residual(f, g, t_rows, t_columns, epsilon)
            self.state = State(f, g, t_rows, t_columns, residual)
        self.residuals.append(self.state.residual)
        if self.state.residual <= self.tol:
            self.status = "converged"
        elif self.status == "converged":
            # Exactly, the last half-step can only have lowered the residual.
            self.status = "precision"

    def _measured_rounding(self, g: Array, epsilon: float) -> float:
        """Difference that precise exponents make to T(g), in units of epsilon."""
        coarse = self.problem.softmin_rows(g, epsilon, precise=False)
        fine = self.problem.softmin_rows(g, epsilon, precise=True)
        self._measured += 2
        return float(np.abs(coarse - fine)[self.problem.a > 0].max() / epsilon)

    def _climb(
        self,
        g: Array,
        epsilon: float,
        tol: float,
        limit: int,
        precise: bool,
        memory: Anderson | None = None,
        leave: bool = False,
    ) -> _Reached:
        """Iterate at one epsilon until the residual is `tol`, or `limit` iterations are over.

        Or until it falls no more, for rounding; or, if better exponents can take over (`leave`),
        whatever the reason: a slow problem falls by less in an iteration than float32 can tell.
        """
        problem = self.problem
        self.rounding = rounding = ROUNDING_MARGIN * problem.rounding(epsilon, precise)
        memory = memory or Anderson()
        fallback: Array | None = None  # what the plain iteration would have gone on with
        floor = -np.inf  # the dual that it had reached
        first, best, since_best = 0.0, np.inf, 0
        while True:
            f, g_shifted, t_rows = problem.update_f(
                g, problem.softmin_rows(g, epsilon, precise), epsilon
            )
            if fallback is not None:
                mass = float(problem.row_mass(f, t_rows, epsilon).sum())
                dual = problem.dual(f, g_shifted, mass, epsilon)
                slack = 1e-12 * abs(floor) + 1e-2 * rounding * epsilon * mass
                slack += problem.left_out * epsilon * mass
                if not dual >= floor - slack:
                    g, fallback = fallback, None
                    memory.rejected()
                    continue
                memory.accepted()
            t_columns = problem.softmin_columns(f, epsilon, precise)
            residual = problem.residual(f, g_shifted, t_rows, t_columns, epsilon)
            image, f, t_columns = problem.update_g(f, t_columns, epsilon)
            self.residuals.append(residual)
            first = first or residual
            since_best = 0 if residual < 0.9 * best else since_best + 1
            best = min(best, residual)
            self._tell(self._done + self._level_share * share_done(first, best, tol))
            stalled = since_best >= STALLED and (leave or residual <= rounding)
            ended = stalled or self.n_iter >= limit or problem.is_astray(f, epsilon)
            if residual <= tol or ended:
                self.status = "max_iter"
                if residual <= tol:
                    self.status = "converged"
                elif stalled:
                    self.status = "precision"
                return _Reached(f, image, t_columns, residual, precise)
            column_mass = problem.column_mass(image, t_columns, epsilon)
            floor = problem.dual(f, image, float(column_mass.sum()), epsilon)
            # An extrapolation may cost a softmin more, which must be left.
            guess = None
            if self.n_iter + 1 < limit and self._max_iter >= SHORT:
                guess = memory.extrapolate(g, image, column_mass)
            if guess is not None and not any(problem.inverse_rho):
                # Balanced potentials are free up to a constant, along which nothing holds an
                # extrapolation back; far out float64 has no digits left for the rest.
                mean = inner(column_mass, guess - image) / float(column_mass.sum())
                guess = guess - mean
            g, fallback = (image, None) if guess is None else (guess, image)


def share_done(first: float, residual: float, tol: float) -> float:
    """Share done, as residuals fall geometrically."""
    if residual <= tol or first <= tol:
        return 1.0
    return float(np.clip(np.log(first / residual) / np.log(first / tol), 0.0, 1.0))


def needs_more(problem: Problem, precision: str, epsilon: float, tol: float) -> bool:
    """Whether float32 exponents are too coarse for a tolerance, and better ones allowed."""
    if precision != "auto":
        return precision == "float64"
    operations = problem.operations
    if operations.exponent_roundoff == operations.precise_roundoff:
        return True
    return problem.rounding(epsilon, precise=False) > 0.25 * tol
