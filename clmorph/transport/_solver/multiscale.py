"""Solve large problems through coarser ones.

Annealing in the blur and refinement in space go hand in hand: at each blur points are taken
together in cells of about its size (`measures.cluster`), and potentials are carried on to the next
blur and its finer cells by a softmin, evaluated at the new points. At the last blur the problem
of the points themselves is solved in cycles (a two-grid method): one iteration over the points
tells by how much the softmins of the cells are off; the problem of the cells is solved with this
correction; and what changes there is carried back. Each cycle leaves a few percent of the
residual, so a few iterations over the points are enough, and their residual, over the
points, decides when it is small. Where the blur is so small that cells save nothing, the problem
of the pairs that matter takes their place (`clmorph.transport._solver.coarse_grid`).

Sources of the ideas: Schmitzer, "Stabilized sparse scaling algorithms for entropy regularized
transport problems" (2019), for annealing with refinement; Brandt, "Multi-level adaptive
solutions to boundary-value problems" (1977), for the correction (his full approximation scheme).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.measures.cluster import Cells, make_cells
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.coarse_grid import CorrectedProblem, Grid, StoredProblem, stored_grid
from clmorph.transport._solver.iteration import (
    ROUNDING_MARGIN,
    TOP,
    Ascent,
    State,
    measured,
    needs_more,
    share_done,
)
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.softmin import LEAST_RESERVE, Softmin

Array = NDArray[np.float64]

#: Sides of the cells at the last blur, in units of it, the first that saves enough; and what is
#: enough: the share of pairs of points that are left as pairs of cells.
SIDES, ENOUGH = (0.5, 0.7, 1.0), (0.03, 0.03, 0.5)
#: Side of the cells at larger blurs.
ANNEALING_SIDE = 1.0
#: Annealing begins where no more pairs of cells than this are left.
FEW_PAIRS = 1 << 20
#: Residuals to reach at larger blurs, and over the cells before the points are looked at.
LEVEL_TOLERANCE, FIRST_TOLERANCE = 0.05, 1e-2
#: Truncation at larger blurs, and for what share of it pairs are chosen there.
LEVEL_TRUNCATION, LEVEL_RESERVE = 1e-2, 1e-20
#: Residual to reach in the smaller problem: this share of that over the points, and of `tol`.
CYCLE_SHARE, CYCLE_FLOOR = 0.02, 0.3
#: Cells serve, and stored pairs, as long as a cycle leaves at most this share of the residual;
#: after so many that left more nothing is left but iterations over the points.
PROGRESS, FAILURES = 0.5, 12
#: Stored pairs serve also while the points' residual is at most so many times theirs.
AGREEMENT = 2.0
#: Pairs to store at most, for every point, and whatever their number.
STORED_PER_POINT, STORED = 128, 1 << 24
#: Better exponents than float32 are taken below so many times its rounding, where needed at all.
SWITCH = 300.0
#: Problems with at least so many pairs are solved through coarser ones, if not told otherwise.
MANY_PAIRS = 1 << 27


class Multiscale:
    """One solve of a large problem; the attributes of `clmorph.transport._solver.iteration.Ascent`.

    Parameters
    ----------
    problem : Problem
    pair : (source, target)
        What it is about: Measure or WeightedPoints.
    blur, tol, max_iter, precision, report
        As in `clmorph.transport._solver.iteration.Ascent`; iterations are those over the points.
    """

    state: State
    status: str
    rounding: float
    precise: bool

    def __init__(
        self,
        problem: Problem,
        pair: tuple[AnyMeasure, AnyMeasure],
        blur: float,
        tol: float,
        max_iter: int,
        precision: str,
        report: Callable[[float], None],
    ) -> None:
        self.problem, self._pair = problem, pair
        self.tol, self.precision = tol, precision
        self.residuals: list[float] = []
        self._blur, self._max_iter, self._report, self._told = blur, max_iter, report, 0.0

    @property
    def n_iter(self) -> int:
        """Iterations over the points so far."""
        return -(-self.problem.n_softmin // 2)

    def run(self, start: Array | None) -> None:
        """Solve from potentials g, or from the top of the annealing."""
        cells = self._choose_cells()
        grid = None if cells is None else self._cells_grid(*cells)
        finest = self.problem if grid is None else grid.problem
        g = start
        if g is None:
            coarse = self._pair if cells is None else (cells[0].measure, cells[1].measure)
            g = self._anneal(coarse, finest)
            self._tell(0.2)
            if cells is not None and grid is not None:
                g = self._first(grid, cells, g)
                self._tell(0.3)
        if grid is None:
            _prepare(self.problem, LEAST_RESERVE)
        self._cycle(grid, g)
        self._tell(1.0)

    def _choose_cells(self) -> list[Cells] | None:
        """Return cells for the last blur; None if they would save too little."""
        pairs = len(self.problem.a) * len(self.problem.b)
        for side, enough in zip(SIDES, ENOUGH, strict=True):
            cells = [make_cells(measure, side * self._blur) for measure in self._pair]
            if len(cells[0].measure) * len(cells[1].measure) <= enough * pairs:
                return cells
        return None

    def _cells_grid(self, source: Cells, target: Cells) -> Grid:
        points = self.problem
        operations, rho, truncation = points.operations, points.rho, points.truncation
        cells = source.measure, target.measure
        few = len(cells[0]) * len(cells[1]) < MANY_PAIRS
        problem = CorrectedProblem.between(operations, *cells, rho, None if few else truncation)
        extensions = [
            Softmin(operations, rows, columns, weights, truncation)
            for rows, columns, weights in (
                (points.columns, problem.rows, (points.b, cells[0].weights)),
                (points.rows, problem.columns, (points.a, cells[1].weights)),
            )
        ]
        return Grid(problem, source, target, *extensions)

    def _stored_grid(self) -> Grid | None:
        """Return the problem of the pairs that matter now; None if they are too many."""
        f, g, t_rows, t_columns, _ = self.state
        most = max(STORED, STORED_PER_POINT * max(len(f), len(g)))
        return stored_grid(self.problem, f, g, (t_rows, t_columns), self._blur**2, most)

    def _anneal(self, pair: tuple[AnyMeasure, AnyMeasure], finest: Problem) -> Array:
        """Return potentials g for the finest problem, from larger blurs over larger cells."""
        top = TOP * np.sqrt(2 * self.problem.largest_cost)
        blur = self._blur
        levels: list[tuple[float, list[Cells]]] = []
        while len(pair[0]) * len(pair[1]) > FEW_PAIRS and blur < top:
            blur *= 2
            cells = [make_cells(measure, ANNEALING_SIDE * blur) for measure in pair]
            levels.append((blur, cells))
            pair = cells[0].measure, cells[1].measure
        g: Array | None = None
        carried: list[Array] | None = None
        problems = [finest]
        problems += [self._cells_problem(one.measure, other.measure) for _, (one, other) in levels]
        for (level, cells), problem in reversed(list(zip(levels, problems[1:], strict=True))):
            ascent = Ascent(
                problem, level, LEVEL_TOLERANCE, self._max_iter, "float32", _ignore, certify=False
            )
            ascent.run(g)
            state = ascent.state
            problems.pop()
            # Potentials are close to linear in epsilon, of which three quarters go each time: go
            # on along the line.
            reached = [state.t_rows, state.t_columns]
            begun = reached if carried is None else carried
            fine = problems[-1]
            carried = self._extended(problem, state, cells, fine, level)
            guesses = [
                there + 0.25 * (now - before)[own.labels]
                for there, now, before, own in zip(carried, reached, begun, cells, strict=True)
            ]
            fine.to_rows.guess, fine.to_columns.guess = guesses
            g = self.problem.damping(level**2)[1] * guesses[1]
        return np.zeros(len(finest.b)) if g is None else g

    def _level_truncation(self, rows: int, columns: int) -> float | None:
        """Return what to leave out for at larger blurs, between so many points."""
        if self.problem.truncation is None or rows * columns < MANY_PAIRS:
            return None
        return LEVEL_TRUNCATION

    def _cells_problem(self, source: AnyMeasure, target: AnyMeasure) -> Problem:
        truncation = self._level_truncation(len(source), len(target))
        problem = Problem.between(
            self.problem.operations, source, target, self.problem.rho, truncation
        )
        return _prepare(problem, LEVEL_RESERVE)

    def _extended(
        self, coarse: Problem, state: State, cells: list[Cells], fine: Problem, blur: float
    ) -> list[Array]:
        """Take the softmins of potentials at the points of a finer problem, rows and columns."""

        def softmin(rows: Any, columns: Any, weights: tuple[Array, Array], guess: Array) -> Softmin:
            truncation = self._level_truncation(len(weights[0]), len(weights[1]))
            result = Softmin(self.problem.operations, rows, columns, weights, truncation)
            # For once, and by a rough guess: what is left out is little all the same.
            result.guess, result.proven, result.reserve = guess, False, LEAST_RESERVE
            return result

        to_rows = softmin(
            fine.rows, coarse.columns, (fine.a, coarse.b), state.t_rows[cells[0].labels]
        )
        to_columns = softmin(
            fine.columns, coarse.rows, (fine.b, coarse.a), state.t_columns[cells[1].labels]
        )
        return [to_rows(state.g, blur**2), to_columns(state.f, blur**2)]

    def _first(self, grid: Grid, cells: list[Cells], g: Array) -> Array:
        """Return potentials g from the cells' problem alone, begun at potentials of its own."""
        epsilon = self._blur**2
        state = self._solve_grid(grid, g, FIRST_TOLERANCE)
        grid.to_target.guess = state.t_columns[cells[1].labels]
        grid.to_source.guess = state.t_rows[cells[0].labels]
        self.problem.to_rows.guess = grid.to_source(state.g, epsilon)
        self.problem.to_columns.guess = grid.to_target(state.f, epsilon)
        return self.problem.damping(epsilon)[1] * self.problem.to_columns.guess

    def _solve_grid(self, grid: Grid, g: Array, tol: float) -> State:
        done = -(-grid.problem.n_softmin // 2)
        # Exponents of stored pairs are small.
        stored = isinstance(grid.problem, StoredProblem)
        precise = not stored and needs_more(grid.problem, self.precision, self._blur**2, tol)
        ascent = Ascent(
            grid.problem, self._blur, tol, done + self._max_iter,
            "auto" if precise else "float32", _ignore, certify=False,
        )  # fmt: skip
        ascent.run(g)
        return ascent.state

    def _ascend(self, g: Array) -> None:
        """Go on over the points alone."""
        told = self._told
        _prepare(self.problem, LEAST_RESERVE)
        ascent = Ascent(
            self.problem, self._blur, self.tol, self._max_iter, self.precision,
            lambda share: self._tell(told + (1 - told) * share),
        )  # fmt: skip
        ascent.run(g)
        self.state, self.status, self.precise = ascent.state, ascent.status, ascent.precise
        self.rounding = ascent.rounding
        self.residuals += ascent.residuals

    def _cycle(self, grid: Grid | None, g: Array) -> None:
        """Iterate over the points, a smaller problem solved in between."""
        problem, epsilon = self.problem, self._blur**2
        before, reached, failures = np.inf, 0.0, 0
        while True:
            # Known better once there are lists of near pairs, which leave out large exponents.
            self.precise = needs_more(problem, self.precision, epsilon, self.tol)
            coarse = problem.rounding(epsilon, precise=False)
            precise = self.precise and before <= SWITCH * coarse
            f, g, t_rows = problem.update_f(g, problem.softmin_rows(g, epsilon, precise), epsilon)
            t_columns = problem.softmin_columns(f, epsilon, precise)
            residual = problem.residual(f, g, t_rows, t_columns, epsilon)
            self.state = State(f, g, t_rows, t_columns, residual)
            self.residuals.append(residual)
            self._tell(0.3 + 0.7 * share_done(self.residuals[0], residual, self.tol))
            rounding = problem.rounding(epsilon, precise)
            self.rounding = ROUNDING_MARGIN * rounding
            done = residual <= self.tol - (0.0 if precise else rounding)
            out = self.n_iter >= self._max_iter
            if done or out:
                self.state = measured(problem, f, g, epsilon)
                self.residuals[-1] = self.state.residual
                self.status = "converged" if self.state.residual <= self.tol else "max_iter"
                if out or self.status == "converged":
                    return
            image, _, _ = problem.update_g(f, t_columns, epsilon)
            if residual > PROGRESS * before:
                failures += 1
            if residual > max(PROGRESS * before, AGREEMENT * reached):
                # Cells serve no longer, or other pairs than the stored ones have come to matter.
                grid = None
            if failures > FAILURES:
                grid = None
            elif grid is None:
                grid = self._stored_grid()
            if grid is None:
                self._ascend(image)
                return
            g, reached = self._correct(grid, image)
            before = residual

    def _correct(self, grid: Grid, image: Array) -> tuple[Array, float]:
        """Return better potentials g than the image of the last iteration.

        And the residual that they leave in the smaller problem.
        """
        epsilon, smaller = self._blur**2, grid.problem
        f, g, t_rows, t_columns, residual = self.state
        own_f = grid.source.mean(f, self.problem.a)
        smaller.begin(own_f)
        own_g = grid.target.mean(g, self.problem.b)
        smaller.correct(
            grid.source.mean(t_rows, self.problem.a) - smaller.to_rows(own_g, epsilon),
            grid.target.mean(t_columns, self.problem.b) - smaller.to_columns(own_f, epsilon),
            epsilon,
        )
        tol = max(CYCLE_SHARE * residual, CYCLE_FLOOR * self.tol)
        solved = self._solve_grid(grid, grid.target.mean(image, self.problem.b), tol)
        new_f = smaller.nearer(solved.f, epsilon)
        change = grid.to_target(new_f, epsilon) - grid.to_target(own_f, epsilon)
        return self.problem.damping(epsilon)[1] * (t_columns + change), solved.residual

    def _tell(self, share: float) -> None:
        self._told = max(self._told, share)
        self._report(self._told)


def _prepare(problem: Problem, reserve: float) -> Problem:
    """Let near pairs be chosen that serve although potentials will move far."""
    for softmin in (problem.to_rows, problem.to_columns):
        softmin.reserve = reserve
    return problem


def _ignore(share: float) -> None:
    """Tell nobody: what is done over cells takes little of the time."""
