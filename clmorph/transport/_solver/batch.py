"""Many problems as one `Problem`, whose vectors hold the points of all of them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.boxes import boxes_of_runs
from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import Operations
from clmorph.measures.points import AnyMeasure, Pair
from clmorph.transport._solver.problem import Problem, cost_across
from clmorph.transport._solver.reductions import Segments
from clmorph.transport._solver.softmin import Softmin


class _Side(NamedTuple):
    """The sources, or the targets, of many problems."""

    of: Any
    weights: Array
    cloud: Any
    oscillations: Array  #: bounds of the changes of costs from one of these points to another, (B,)


class BatchSoftmin(Softmin):
    """The operators T of many problems, over all pairs; `numbers`, (B,), are theirs in a batch."""

    def __init__(
        self, operations: Operations, numbers: IntArray, rows: _Side, columns: _Side
    ) -> None:
        weights = rows.weights, columns.weights
        super().__init__(operations, rows.cloud, columns.cloud, weights)
        self.numbers, self._starts = numbers, rows.of.starts
        self.n_columns = columns.of.counts

    def checked(self, softmin: Array) -> Array:
        finite = np.isfinite(softmin)
        if not finite.all():
            problem = np.searchsorted(self._starts, int(np.argmin(finite)), side="right") - 1
            raise NotFiniteError(int(self.numbers[problem]))
        return softmin


class NotFiniteError(Exception):
    """A softmin of the problem with this number in the batch overflowed."""

    def __init__(self, problem: int) -> None:
        super().__init__(problem)
        self.problem = problem


def _uploaded(
    operations: Operations, measures: list[AnyMeasure]
) -> tuple[_Side, tuple[Array, Array]]:
    """Return one side, with the ranges of its offsets, and the corners of boxes, (B, D)."""
    of = Segments(np.array([len(measure) for measure in measures]))
    points = np.concatenate([measure.points for measure in measures])
    weights = np.concatenate([measure.weights for measure in measures])
    offsets, ranges = None, np.zeros(len(measures))
    if any(measure.offsets is not None for measure in measures):
        offsets = np.concatenate([
            np.zeros(len(measure)) if measure.offsets is None else measure.offsets
            for measure in measures
        ])  # fmt: skip
        ranges = of.largest(offsets) + of.largest(-offsets)
    cloud = operations.upload_batch(points, weights, of.counts, offsets)
    low, high = boxes_of_runs(points, of.starts)
    return _Side(of, weights, cloud, ranges), (low, high)


def problem_of_many(
    operations: Operations, pairs: Sequence[Pair], rho: tuple[float, float]
) -> Problem:
    """Return the problems of many pairs (source, target), all in one dimension, as one."""
    rows, (low, high) = columns, others = _uploaded(operations, [source for source, _ in pairs])
    if any(source is not target for source, target in pairs):
        columns, others = _uploaded(operations, [target for _, target in pairs])
    largest = cost_across(np.minimum(low, others[0]), np.maximum(high, others[1]))
    sides = [each._replace(oscillations=largest + each.oscillations) for each in (rows, columns)]
    return _problem(operations, np.arange(len(pairs)), sides, rho, largest)


def _problem(
    operations: Operations, numbers: IntArray, sides: list[_Side], rho: tuple[float, float],
    largest: Array,
) -> Problem:  # fmt: skip
    to_rows, to_columns = (
        BatchSoftmin(operations, numbers, *each) for each in (sides, sides[::-1])
    )
    one, other = sides
    reductions, oscillations = (one.of, other.of), (one.oscillations, other.oscillations)
    return Problem(to_rows, to_columns, rho, largest, reductions, oscillations)


def some(problem: Problem, problems: IntArray, uploaded: bool = True) -> Problem:
    """Return some of many problems, or the only one; without softmins unless `uploaded`."""
    if len(problems) == np.size(problem.masses[0]) or not problem.of_rows.shape:
        return problem
    operations, clouds = problem.operations, (problem.rows, problem.columns)
    before = problem.reductions, (problem.a, problem.b), clouds, problem.oscillations
    sides = [
        _Side(
            of.some(problems), weights[of.points_of(problems)],
            operations.take_batch(cloud, problems) if uploaded else None, oscillations[problems],
        )
        for of, weights, cloud, oscillations in zip(*before, strict=True)
    ]  # fmt: skip
    numbers, largest = problem.to_rows.numbers[problems], problem.largest_cost[problems]
    made = _problem(operations, numbers, sides, problem.rho, largest)
    if problem.to_columns is problem.to_rows:
        made.to_columns = made.to_rows
    made.exact_sums = problem.exact_sums
    return made


def one_of(problem: Problem, number: int, roundoffs: Array) -> Problem:
    """Return one problem, with the bounds of its last softmins; one of many has no clouds."""
    if not problem.of_rows.shape:
        return problem
    a, b = problem.of_rows.part(problem.a, number), problem.of_columns.part(problem.b, number)
    softmins = [Softmin(problem.operations, None, None, each) for each in ((a, b), (b, a))]
    for softmin, roundoff in zip(softmins, roundoffs.tolist(), strict=True):
        softmin.roundoff = roundoff
    one, other = (float(each[number]) for each in problem.oscillations)
    return Problem(
        softmins[0], softmins[1], problem.rho, float(problem.largest_cost[number]),
        oscillations=(one, other),
    )  # fmt: skip
