"""Annealing of large problems: larger blurs are solved over larger clusters of points.

Source of the idea: Schmitzer, "Stabilized sparse scaling algorithms for entropy regularized
transport problems" (2019).
"""

from typing import NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.measures.cluster import Clusters, make_clusters
from clmorph.measures.points import Pair
from clmorph.transport._solver.coarse_grid import expanded
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport._solver.problem import Problem, State
from clmorph.transport._solver.softmin import Softmin, many_pairs
from clmorph.transport.regularization import Goal

#: Side of the clusters at a level, in units of its blur.
ANNEALING_SIDE = 1.0
#: A level has the points of the next finer one where clusters would leave more than this share of
#: the pairs. Its potentials then need not be prolonged.
FEWER = 0.7
#: Annealing begins at a level with at most this number of pairs of clusters.
FEW_PAIRS = 1 << 20
#: Residual to reach at a level, in units of its epsilon.
CLUSTER_TOLERANCE = 0.05
#: Iterations at a level without a new best residual after which it ends, if rounding explains that:
#: the next level goes on anyway.
LEVEL_PATIENCE = 10
#: Truncation at the levels, in nats, and the share of it for which near pairs are chosen there;
#: the smaller one where a level has the points of the next finer one, and potentials move farther.
LEVEL_TRUNCATION, LEVEL_RESERVE, FAR_RESERVE = 1e-2, 1e-10, 1e-20


class _Level(NamedTuple):
    """A larger blur, with the clusters of the points of the next finer level, if they are fewer."""

    blur: float
    pair: Pair
    clusters: tuple[Clusters, Clusters] | None
    points: Pair


def _coarser(pair: Pair, blur: float) -> _Level:
    """Return the level of a blur above a pair of measures."""
    source, target = (make_clusters(measure, ANNEALING_SIDE * blur) for measure in pair)
    pairs = len(source.measure) * len(target.measure)
    if pairs > FEWER * len(pair[0]) * len(pair[1]):
        return _Level(blur, pair, None, pair)
    return _Level(blur, (source.measure, target.measure), (source, target), pair)


def anneal(problem: Problem, pair: Pair, finest: Problem, goal: Goal) -> Array:
    """Return initial potentials g, (M,), from larger blurs over larger clusters.

    The measures `pair` are those of the problem `finest`: the points, or clusters of them. Its
    softmins receive first guesses.
    """
    top, blur = problem.top_blur, goal.blur
    levels: list[_Level] = []
    problems = [finest]
    while len(pair[0]) * len(pair[1]) > FEW_PAIRS and blur < top:
        blur *= 2
        levels.append(_coarser(pair, blur))
        problems.append(_level_problem(problem, levels[-1], problems[-1]))
        pair = levels[-1].pair
    g: Array | None = None
    prolonged: list[Array] | None = None
    while levels:
        level, coarse, fine = levels.pop(), problems.pop(), problems[-1]
        aim = goal._replace(blur=level.blur, tol=CLUSTER_TOLERANCE, precision="float32")
        iteration = Iteration(coarse, aim, ignore, certify=False, patience=LEVEL_PATIENCE)
        state = iteration.run(g).outcome().state
        # Potentials are close to linear in epsilon, of which three quarters go at each level, so
        # the line through the last two levels is continued to the next one.
        reached = [state.t_rows, state.t_columns]
        begun = reached if prolonged is None else prolonged
        changes = [now - before for now, before in zip(reached, begun, strict=True)]
        if level.clusters is None:
            prolonged = reached
        else:
            prolonged = _prolong(problem, coarse, state, level, fine)
            changes = [of[each.labels] for of, each in zip(changes, level.clusters, strict=True)]
        guesses = [there + 0.25 * change for there, change in zip(prolonged, changes, strict=True)]
        fine.to_rows.guess, fine.to_columns.guess = guesses
        g = problem.damping(level.blur**2)[1] * guesses[1]
    return np.zeros(len(finest.b)) if g is None else g


def _level_truncation(problem: Problem, rows: int, columns: int) -> float | None:
    """Return the truncation at a level of this many points; None takes all pairs."""
    if problem.truncation is None or rows * columns < many_pairs(problem.operations):
        return None
    return LEVEL_TRUNCATION


def _level_problem(problem: Problem, level: _Level, finer: Problem) -> Problem:
    """Return the problem of the clusters of a level, given that of the next finer level."""
    source, target = level.pair
    truncation = _level_truncation(problem, len(source), len(target))
    if level.clusters is None:
        return prepare(finer.with_truncation(truncation), FAR_RESERVE)
    coarse = Problem.between(problem.operations, source, target, problem.rho, truncation)
    return prepare(coarse, LEVEL_RESERVE)


def _prolong(
    problem: Problem, coarse: Problem, state: State, level: _Level, fine: Problem
) -> list[Array]:
    """Evaluate the softmins of coarse potentials at the points of a finer problem.

    Near pairs are chosen by the expansion around the clusters. At a few points that is off by
    tens of nats, too much to take the place of the softmins.
    """
    assert level.clusters is not None
    result, epsilon = [], level.blur**2
    for side, potential in enumerate((state.g, state.f)):
        softmin, own = coarse.softmins[side], fine.softmins[side]
        weights = own.weights[0], softmin.weights[1]
        truncation = _level_truncation(problem, len(weights[0]), len(weights[1]))
        of_points = Softmin(problem.operations, own.rows, softmin.columns, weights, truncation)
        # The softmin is computed once, from an estimate, so its truncation is not proven.
        of_points.reserve, of_points.proven = LEVEL_RESERVE, False
        if truncation is not None:
            near = level.clusters[side], level.points[side]
            of_points.guess = expanded(softmin, potential, epsilon, *near)
        result.append(of_points(potential, epsilon))
    return result


def prepare(problem: Problem, reserve: float) -> Problem:
    """Make the problem choose near pairs that remain valid although potentials will move far."""
    for softmin in (problem.to_rows, problem.to_columns):
        softmin.reserve = reserve
    return problem


def ignore(share: float) -> None:
    """Report nothing: work over clusters takes little of the time."""
