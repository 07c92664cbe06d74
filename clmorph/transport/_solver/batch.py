"""Many problems as one `Problem`, whose vectors hold the points of all of them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import Operations
from clmorph.backends.records import NearPairs
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.problem import Problem, cost_across
from clmorph.transport._solver.reductions import Segments
from clmorph.transport._solver.softmin import Softmin, overflow


class BatchSoftmin(Softmin):
    """The operators T of many problems, over all pairs; `numbers`, (B,), are theirs in a batch."""

    def __init__(
        self,
        operations: Operations,
        numbers: IntArray,
        clouds: tuple[Any, Any],
        weights: tuple[Array, Array],
        reductions: tuple[Any, Any],
    ) -> None:
        super().__init__(operations, *clouds, weights)
        self.numbers, self._starts = numbers, reductions[0].starts
        self.n_columns = reductions[1].counts

    def _over(
        self, near: NearPairs | None, potential: Array, epsilon: float, precise: bool, bounded: bool
    ) -> Array:
        arguments = self.rows, self.columns, potential, epsilon
        self.roundoff = 0.0
        if bounded:
            softmin, self.roundoff = self.operations.bounded_softmin_batch(*arguments)
        else:
            softmin = self.operations.softmin_batch(*arguments, precise)
        if not np.all(np.isfinite(softmin)):
            place = int(np.argmin(np.isfinite(softmin)))
            raise NotFiniteError(
                int(self.numbers[np.searchsorted(self._starts, place, side="right") - 1])
            )
        return softmin


class NotFiniteError(Exception):
    """A softmin of the problem with this number in the batch overflowed."""

    def __init__(self, problem: int) -> None:
        super().__init__(problem)
        self.problem = problem


def not_finite(problem: Problem, number: int) -> Exception:
    """Return the error for one of many problems, or the only one, whose softmin overflowed."""
    return (
        NotFiniteError(int(problem.to_rows.numbers[number]))
        if problem.of_rows.shape
        else overflow("points")
    )


class _Side(NamedTuple):
    """The sources, or the targets, of many problems."""

    of: Segments
    weights: Array
    cloud: Any
    corners: tuple[Array, Array]  #: of boxes around them, (B, D)
    ranges: Array  #: of their offsets, (B,)


def _uploaded(operations: Operations, measures: list[AnyMeasure]) -> _Side:
    of = Segments(np.array([len(measure) for measure in measures]))
    points, weights = (
        np.concatenate([getattr(measure, name) for measure in measures])
        for name in ("points", "weights")
    )
    offsets, ranges = None, np.zeros(len(measures))
    if any(measure.offsets is not None for measure in measures):
        offsets = np.concatenate([
            np.zeros(len(measure)) if measure.offsets is None else measure.offsets
            for measure in measures
        ])  # fmt: skip
        ranges = of.largest(offsets) + of.largest(-offsets)
    cloud = operations.upload_batch(points, weights, of.counts, offsets)
    corners = np.minimum.reduceat(points, of.starts), np.maximum.reduceat(points, of.starts)
    return _Side(of, weights, cloud, corners, ranges)


def problem_of_many(
    operations: Operations, pairs: Sequence[tuple[AnyMeasure, AnyMeasure]], rho: tuple[float, float]
) -> Problem:
    """Return the problems of many pairs (source, target), all in one dimension, as one."""
    rows = columns = _uploaded(operations, [source for source, _ in pairs])
    if any(source is not target for source, target in pairs):
        columns = _uploaded(operations, [target for _, target in pairs])
    (low, high), (other_low, other_high) = rows.corners, columns.corners
    largest = cost_across(np.minimum(low, other_low), np.maximum(high, other_high))
    return _problem(
        operations, np.arange(len(pairs)), (rows.cloud, columns.cloud),
        (rows.weights, columns.weights), (rows.of, columns.of), rho, largest,
        (largest + rows.ranges, largest + columns.ranges),
    )  # fmt: skip


def _problem(
    operations: Operations, numbers: IntArray, clouds: tuple[Any, Any],
    weights: tuple[Array, Array], reductions: tuple[Any, Any], rho: tuple[float, float],
    largest: Array, oscillations: tuple[Array, Array],
) -> Problem:  # fmt: skip
    sides = clouds, weights, reductions
    return Problem(
        BatchSoftmin(operations, numbers, *sides),
        BatchSoftmin(operations, numbers, *(each[::-1] for each in sides)),
        weights, rho, largest, reductions, oscillations,
    )  # fmt: skip


def some(problem: Problem, problems: IntArray, uploaded: bool = True) -> Problem:
    """Return some of many problems, or the only one; without softmins unless `uploaded`."""
    if len(problems) == np.size(problem.masses[0]) or not problem.of_rows.shape:
        return problem
    operations = problem.operations
    rows, columns = (of.points_of(problems) for of in problem.reductions)
    clouds = [
        operations.take_batch(cloud, problems) if uploaded else None
        for cloud in (problem.rows, problem.columns)
    ]
    one, other = problem.oscillations
    made = _problem(
        operations, problem.to_rows.numbers[problems], (clouds[0], clouds[1]),
        (problem.a[rows], problem.b[columns]),
        (problem.of_rows.some(problems), problem.of_columns.some(problems)), problem.rho,
        problem.largest_cost[problems], (one[problems], other[problems]),
    )  # fmt: skip
    if problem.to_columns is problem.to_rows:
        made.to_columns = made.to_rows
    made.exact_sums = problem.exact_sums
    return made


def one_of(problem: Problem, number: int, roundoffs: Array) -> Problem:
    """Return one problem, with the bounds of its last softmins; one of many has no clouds."""
    if not problem.of_rows.shape:
        return problem
    a, b = (
        of.part(weights, number)
        for of, weights in zip(problem.reductions, (problem.a, problem.b), strict=True)
    )
    softmins = [Softmin(problem.operations, None, None, each) for each in ((a, b), (b, a))]
    for softmin, roundoff in zip(softmins, roundoffs.tolist(), strict=True):
        softmin.roundoff = roundoff
    one, other = (float(each[number]) for each in problem.oscillations)
    return Problem(
        softmins[0], softmins[1], (a, b), problem.rho, float(problem.largest_cost[number]),
        oscillations=(one, other),
    )  # fmt: skip
