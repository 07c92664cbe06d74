"""Solve large problems through coarser ones.

Annealing in the blur and refinement in space go together (`_solver.annealing`). At the last blur
the problem of the points is solved in cycles of a two-grid method: one iteration over the points
shows by how much the softmins of the clusters are off; the problem of the clusters is solved with
this correction; and the change of its solution is prolonged to the points by a softmin. Each cycle
leaves a few percent of the residual. Where clusters save little, because the blur is small, the
problem of the pairs with notable mass takes their place (`_solver.coarse_grid`).

Sources of the ideas: Schmitzer, "Stabilized sparse scaling algorithms for entropy regularized
transport problems" (2019), for annealing with refinement; Brandt, "Multi-level adaptive solutions
to boundary-value problems" (1977), for the correction (his full approximation scheme).
"""

from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array, Progress
from clmorph.measures.cluster import Clusters, join_points, label_cubes
from clmorph.measures.points import Pair
from clmorph.transport._solver.annealing import anneal, ignore, prepare
from clmorph.transport._solver.coarse_grid import (
    STORED_CHOICES,
    CoarseGrid,
    CorrectedProblem,
    StoredProblem,
    expanded,
    stored_grid,
)
from clmorph.transport._solver.iteration import Iteration, Outcome, share_done
from clmorph.transport._solver.problem import ROUNDING_MARGIN, Problem, State
from clmorph.transport._solver.softmin import (
    LEAST_RESERVE,
    RESERVE,
    SETTLED_RESERVE,
    Softmin,
    many_pairs,
)
from clmorph.transport.regularization import Goal

#: Candidate sides of the clusters at the last blur, in units of this blur, and a bound for each:
#: the number of pairs of clusters as a share of the number of pairs of points. The first side
#: within its bound is used.
SIDES, ENOUGH = (0.5, 0.7, 1.0), (0.03, 0.03, 0.4)
#: The last bound above some numbers of points: the more points, the fewer pairs can be stored for
#: each of them at large residuals, and the better must the first potentials be.
ENOUGH_OF_MANY = ((1 << 19, 0.7), (1 << 17, 0.5))
#: Residual to reach over the clusters before the first iteration over the points.
FIRST_TOLERANCE = 5e-2
#: Truncation of the softmins of clusters, as a multiple of that of the points: they choose the way,
#: and not where it ends.
COARSER = 10.0
#: Nats that the softmins which prolong changes of coarse potentials may miss, at least: two of them
#: are subtracted, and they miss the same pairs.
PROLONGATION_TRUNCATION = 3e-3
#: Residual to reach in the coarse problem: this share of the residual over the points, and at
#: least this share of `tol`. With few clusters the coarse level is solved further, to the last
#: share: its iterations are cheap, a tenth of those over the points.
CYCLE_SHARE, CYCLE_FLOOR, FEW_CLUSTERS_FLOOR = 0.02, 0.4, 0.1
#: Where this share of the residual is below this many times `tol`, stored pairs are solved to the
#: least residual at once: they are nearly all of the problem, so that the cycle can be the last.
ALMOST = 1.5
#: A coarse problem is kept as long as a cycle leaves at most this share of the residual. After
#: this many cycles that left more, only iterations over the points follow. A cycle that has ended
#: at the edge of the trust region counts as this share of one: islands of color that move far take
#: many such cycles, which take less time than iterations over the points.
PROGRESS, FAILURES, AT_THE_EDGE = 0.3, 12, 0.2
#: Where a choice of pairs to store waits for a smaller residual, iterations over the points go on
#: to this one. They leave a few iterations of the limit to the rest of the solve.
STORED_FROM, SPARE_ITERATIONS = 0.2, 3
#: The last iterations over the points choose near pairs for far moves if the residual is above
#: this.
FAR = 1.0
#: Stored pairs are also kept while the residual over the points is at most this many times theirs.
AGREEMENT = 2.0
#: Largest number of stored pairs: for each point, and a number that is always allowed. Up to the
#: last number there may be twice as many for each point.
STORED_PER_POINT, STORED, MANY_STORED = 160, 1 << 24, 1 << 27
#: Where better exponents than float32 are needed, they are used below this many times its rounding.
SWITCH = 300.0


class Fineness(NamedTuple):
    """How clusters are used, by their number of pairs as a share of the pairs of points."""

    most: float  #: the largest share
    clusters: float  #: the reserve of softmins between clusters: see `Softmin.reserve`
    points: float  #: the reserve of softmins between points, after the clusters are solved
    cycles: bool  #: whether cycles correct the clusters; if not, they give only first potentials
    #: The residual below which clusters are not solved further, as a share of `tol`.
    floor: float = CYCLE_FLOOR


#: Potentials were seen to move after clusters by 0.5 to 1 nat, by 1 to 2 nats, and by more. While
#: clusters are solved, they move by 10 nats and more.
FINENESSES = (
    Fineness(0.03, 1e-6, RESERVE, True, FEW_CLUSTERS_FLOOR), Fineness(0.3, 1e-6, 3e-2, True),
    Fineness(1.0, 1e-12, 3e-6, False),
)  # fmt: skip


class Multiscale(Outcome):
    """One solve of a large problem between two measures, by iterations over its points."""

    def __init__(self, problem: Problem, pair: Pair, goal: Goal, report: Progress) -> None:
        none = State(*(np.zeros(0),) * 4, np.inf)
        super().__init__(problem, goal, none, "max_iter", [], 0, 2, 0.0, False)
        self._pair, self._report, self._reported = pair, report, 0.0
        self._floor = CYCLE_FLOOR  # of the clusters
        #: The choices of pairs to store that are not known to have too many.
        self._choices = list(STORED_CHOICES)

    def run(self, start: Array | None) -> Outcome:
        """Solve from potentials g, or from the largest blur of the annealing."""
        self._cycle(*self._begin(start))
        self._report_share(1.0)
        return self

    def _begin(self, start: Array | None) -> tuple[CoarseGrid | None, Array]:
        """Return the problem of the clusters, if cycles correct it, and first potentials g."""
        clusters = self._choose_clusters()
        if clusters is None:
            if start is None:
                start = anneal(self.problem, self._pair, self.problem, self.goal)
            prepare(self.problem, LEAST_RESERVE)
            return None, start
        grid = self._clusters_grid(*clusters)
        sizes = zip(clusters, self._pair, strict=True)
        share = np.prod([len(own.measure) / len(points) for own, points in sizes])
        fineness = next(each for each in FINENESSES if share <= each.most)
        prepare(grid.problem, fineness.clusters)
        self._floor = fineness.floor
        g = start
        if g is None:
            coarse = clusters[0].measure, clusters[1].measure
            g = anneal(self.problem, coarse, grid.problem, self.goal)
            self._report_share(0.2)
            g = self._first(grid, clusters, g)
            self._report_share(0.3)
        prepare(self.problem, fineness.points)
        # A start may be far from the solution, and nothing else corrects it as a whole.
        return grid if fineness.cycles or start is not None else None, g

    def _choose_clusters(self) -> list[Clusters] | None:
        """Return clusters for the last blur; None if they would save too little."""
        sizes = len(self.problem.a), len(self.problem.b)
        many = (enough for points, enough in ENOUGH_OF_MANY if max(sizes) > points)
        bounds = *ENOUGH[:-1], next(many, ENOUGH[-1])
        pairs = sizes[0] * sizes[1]
        for side, enough in zip(SIDES, bounds, strict=True):
            cubes = [label_cubes(measure.points, side * self.goal.blur) for measure in self._pair]
            if cubes[0][1] * cubes[1][1] <= enough * pairs:
                own = zip(self._pair, cubes, strict=True)
                return [join_points(measure, *each) for measure, each in own]
        return None

    def _clusters_grid(self, source: Clusters, target: Clusters) -> CoarseGrid:
        """Return the problem of the clusters, with the softmin that prolongs its solution."""
        points = self.problem
        operations, rho, truncation = points.operations, points.rho, points.truncation
        clusters = source.measure, target.measure
        coarser = None
        pairs = len(clusters[0]) * len(clusters[1])
        if truncation is not None and pairs >= many_pairs(operations):
            coarser = COARSER * truncation
        problem = CorrectedProblem.between(operations, *clusters, rho, coarser)
        missing = None if truncation is None else max(truncation, PROLONGATION_TRUNCATION)
        to_target = Softmin(
            operations, points.columns, problem.rows, (points.b, clusters[0].weights), missing
        )
        return CoarseGrid(problem, source, target, to_target)

    def _stored_grid(self) -> CoarseGrid | None:
        """Return the problem of the pairs that have notable mass now; None if they are too many."""
        usual = STORED_PER_POINT * max(len(self.state.f), len(self.state.g))
        most = max(STORED, usual, min(2 * usual, MANY_STORED))
        choices = [each for each in self._choices if self.state.residual <= each.residual]
        grid = stored_grid(self.problem, self.state, self.goal.epsilon, most, choices)
        # A choice that has had too many pairs is not tried again.
        too_many = choices
        if grid is not None:
            assert isinstance(grid.problem, StoredProblem)
            too_many = choices[: choices.index(grid.problem.choice)]
        self._choices = [each for each in self._choices if each not in too_many]
        return grid

    def _first(self, grid: CoarseGrid, clusters: list[Clusters], g: Array) -> Array:
        """Solve the problem of the clusters from potentials g and prolong them to the points."""
        epsilon = self.goal.epsilon
        state = self._solve_grid(grid, g, FIRST_TOLERANCE)
        own, coarse = self._pair, grid.problem
        self.problem.to_rows.guess = expanded(coarse.to_rows, state.g, epsilon, clusters[0], own[0])
        grid.to_target.guess = expanded(coarse.to_columns, state.f, epsilon, clusters[1], own[1])
        self.problem.to_columns.guess = grid.to_target(state.f, epsilon)
        return self.problem.damping(epsilon)[1] * self.problem.to_columns.guess

    def _solve_grid(self, grid: CoarseGrid, g: Array, tol: float) -> State:
        """Solve a coarse problem from potentials g to a residual."""
        # Exponents of stored pairs are small, so float32 is enough for them.
        stored = isinstance(grid.problem, StoredProblem)
        precision, epsilon = self.goal.precision, self.goal.epsilon
        precise = not stored and grid.problem.needs_more(precision, epsilon, tol)
        goal = self.goal._replace(tol=tol, precision="auto" if precise else "float32")
        return Iteration(grid.problem, goal, ignore, certify=False).run(g).outcome().state

    def _iterate_points(self, tol: float, g: Array, last: bool) -> Outcome:
        """Continue from potentials g with iterations over the points alone, to a residual."""
        reported = end = self._reported
        end = (
            1.0 if last else max(end, 0.3 + 0.7 * share_done(self.residuals[0], tol, self.goal.tol))
        )
        most = self.goal.max_iter - (0 if last else SPARE_ITERATIONS)
        iteration = Iteration(
            self.problem, self.goal._replace(tol=tol, max_iter=most),
            lambda share: self._report_share(reported + (end - reported) * share),
            certify=last, begun=self.n_softmin,
        )  # fmt: skip
        found = iteration.run(g).outcome()
        self.n_softmin = found.n_softmin
        # The last one is measured again, unless this is the end.
        self.residuals += found.residuals[: None if last else -1]
        return found

    def _cycle(self, grid: CoarseGrid | None, g: Array) -> None:
        """Alternate one iteration over the points with a solve of the coarse problem."""
        problem, epsilon, own_tol = self.problem, self.goal.epsilon, self.goal.tol
        before, expected, reached, failures = np.inf, np.inf, 0.0, 0.0
        failure = 1.0  # what a failure of the last cycle counts
        waits = True  # whether iterations over the points may lead to pairs that can be stored
        while True:
            # Lists of near pairs leave out large exponents, so the bound can fall meanwhile.
            self.precise = problem.needs_more(self.goal.precision, epsilon, own_tol)
            coarse = problem.rounding(epsilon, precise=False)
            precise = self.precise and before <= SWITCH * coarse
            # The iteration that is likely to be the last one computes what a certificate needs.
            last = expected <= own_tol
            t_rows = problem.softmin(0, g, epsilon, precise, last)
            f, g, t_rows, _ = problem.half_step(0, g, t_rows, epsilon)
            t_columns = problem.softmin(1, f, epsilon, precise, last)
            self.n_softmin += 2
            residual = problem.residual(f, g, t_rows, t_columns, epsilon)
            self.state = State(f, g, t_rows, t_columns, residual)
            self.residuals.append(residual)
            self._report_share(0.3 + 0.7 * share_done(self.residuals[0], residual, own_tol))
            rounding = problem.rounding(epsilon, precise)
            self.rounding = ROUNDING_MARGIN * rounding
            done = residual <= own_tol - (0.0 if precise or last else rounding)
            out = self.n_iter >= self.goal.max_iter
            if done or out:
                if not last:
                    self.state = problem.measured(f, g, epsilon)
                    self.residuals[-1] = self.state.residual
                self.status = "converged" if self.state.residual <= own_tol else "max_iter"
                if out or self.status == "converged":
                    return
            image = problem.half_step(1, f, t_columns, epsilon).new
            if residual > PROGRESS * before:
                failures += failure
            if residual > max(PROGRESS * before, AGREEMENT * reached):
                # The clusters are too coarse, or pairs that are not stored have gained mass.
                grid = None
            if failures > FAILURES:
                grid = None
            elif grid is None:
                grid = self._stored_grid()
            if grid is None:
                more = self.n_iter + SPARE_ITERATIONS < self.goal.max_iter
                if waits and more and any(each.residual < residual for each in self._choices):
                    # Once the residual is small, one of these choices may have few enough pairs.
                    tol, waits = max(STORED_FROM, own_tol), False
                    g = self._iterate_points(tol, image, last=False).state.g
                    before = expected = np.inf
                    continue
                prepare(
                    self.problem, LEAST_RESERVE if self.residuals[-1] > FAR else SETTLED_RESERVE
                )
                found = self._iterate_points(own_tol, image, last=True)
                self.state, self.status, self.precise = found.state, found.status, found.precise
                self.rounding = found.rounding
                return
            g, reached, left = self._correct(grid, image)
            failure = AT_THE_EDGE if left else 1.0
            expected = np.inf if np.isinf(before) else residual * min(1.0, residual / before)
            if isinstance(grid.problem, StoredProblem) and reached <= own_tol:
                expected = reached
            before = residual

    def _correct(self, grid: CoarseGrid, image: Array) -> tuple[Array, float, bool]:
        """Return g after a two-grid cycle, the coarse residual, and if the edge has ended it."""
        epsilon, own_tol, coarse = self.goal.epsilon, self.goal.tol, grid.problem
        f, g, t_rows, t_columns, residual = self.state
        own_f = grid.source.restrict(f, self.problem.a)
        own_g = grid.target.restrict(g, self.problem.b)
        coarse.correct(
            grid.source.restrict(t_rows, self.problem.a) - coarse.to_rows(own_g, epsilon),
            grid.target.restrict(t_columns, self.problem.b) - coarse.to_columns(own_f, epsilon),
            epsilon,
        )
        if isinstance(coarse, StoredProblem):
            coarse.center, floor = own_f, CYCLE_FLOOR * own_tol
            tol = max(CYCLE_SHARE * residual, floor)
            tol = floor if tol <= ALMOST * own_tol else tol
        else:
            tol = max(CYCLE_SHARE * residual, self._floor * own_tol)
        solved = self._solve_grid(grid, grid.target.restrict(image, self.problem.b), tol)
        new_f, left = solved.f, False
        if isinstance(coarse, StoredProblem):
            new_f, left = coarse.held(solved.f, epsilon)
        change = grid.prolong(new_f, own_f, epsilon)
        return self.problem.damping(epsilon)[1] * (t_columns + change), solved.residual, left

    def _report_share(self, share: float) -> None:
        """Report the share of the work that is done, which never falls."""
        self._reported = max(self._reported, share)
        self._report(self._reported)
