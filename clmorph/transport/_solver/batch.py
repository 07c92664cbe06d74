"""Many problems as one `Problem`, whose vectors hold the points of all of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import Operations
from clmorph.backends.rounding import rounding_error
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.problem import Problem, cost_across
from clmorph.transport._solver.reductions import WHOLE, Segments


class BatchSoftmin:
    """The operators T of many problems, over all pairs of points of each problem.

    It has the attributes of `clmorph.transport._solver.softmin.Softmin` that `Problem` needs.

    Parameters
    ----------
    operations : Operations
    rows, columns
        Batches of clouds that the backend holds.
    of_rows, of_columns : Segments
    numbers : (B,) array
        Numbers of the problems in the whole batch.
    """

    #: All pairs are summed.
    truncation: float | None = None
    left_out, visited = 0.0, 1.0

    def __init__(
        self,
        operations: Operations,
        rows: Any,
        columns: Any,
        of_rows: Segments,
        of_columns: Segments,
        numbers: IntArray,
    ) -> None:
        self.operations, self.rows, self.columns = operations, rows, columns
        self.of_rows, self.of_columns, self.numbers = of_rows, of_columns, numbers
        #: As in `Softmin`, a bound for each problem.
        self.roundoff: Any = 0.0

    def __call__(
        self, potential: Array, epsilon: float, precise: bool = False, bounded: bool = False
    ) -> Array:
        """Return T(potential) of every problem; see `Softmin`."""
        arguments = self.rows, self.columns, potential, epsilon
        self.roundoff = 0.0
        if bounded:
            softmin, self.roundoff = self.operations.bounded_softmin_batch(*arguments)
        else:
            softmin = self.operations.softmin_batch(*arguments, precise)
        if not np.all(np.isfinite(softmin)):
            place = int(np.argmin(np.isfinite(softmin)))
            problem = int(np.searchsorted(self.of_rows.starts, place, side="right")) - 1
            raise NotFiniteError(int(self.numbers[problem]))
        return softmin

    def settle(self, residual: Any) -> None:
        """Choose nothing: all pairs are summed."""

    def rounding(
        self,
        n_columns: int,
        largest_cost: Array,
        epsilon: float,
        precise: bool,
        exact: bool = False,
    ) -> Any:
        """Return the largest effect of rounding on a softmin, in nats, for each problem."""
        counts = self.of_columns.counts
        return rounding_error(self.operations, counts, largest_cost / epsilon, precise, exact)


class NotFiniteError(Exception):
    """A softmin of a problem overflowed.

    Parameters
    ----------
    problem : int
        Its number in the batch.
    """

    def __init__(self, problem: int) -> None:
        super().__init__(problem)
        self.problem = problem


def problem_of_many(
    operations: Operations,
    pairs: Sequence[tuple[AnyMeasure, AnyMeasure]],
    rho: tuple[float, float],
) -> Problem:
    """Return the problems of many pairs of measures as one.

    Parameters
    ----------
    operations : Operations
    pairs : sequence of (source, target)
        All in one dimension.
    rho : (rho_source, rho_target)
    """
    rows = columns = _Side(operations, [source for source, _ in pairs])
    if any(source is not target for source, target in pairs):
        columns = _Side(operations, [target for _, target in pairs])
    low, high = np.minimum(rows.low, columns.low), np.maximum(rows.high, columns.high)
    largest, numbers = cost_across(low, high), np.arange(len(pairs))
    made = Problem(
        BatchSoftmin(operations, rows.cloud, columns.cloud, rows.of, columns.of, numbers),
        BatchSoftmin(operations, columns.cloud, rows.cloud, columns.of, rows.of, numbers),
        (rows.weights, columns.weights), rho, largest, (rows.of, columns.of),
    )  # fmt: skip
    made.oscillations = largest + rows.range_of_offsets, largest + columns.range_of_offsets
    return made


class _Side:
    """The sources, or the targets, of many problems."""

    def __init__(self, operations: Operations, measures: list[AnyMeasure]) -> None:
        self.of = Segments(np.array([len(measure) for measure in measures]))
        points = np.concatenate([measure.points for measure in measures])
        self.weights = np.concatenate([measure.weights for measure in measures])
        self.low = np.minimum.reduceat(points, self.of.starts)
        self.high = np.maximum.reduceat(points, self.of.starts)
        offsets = None
        self.range_of_offsets: Any = 0.0
        if any(measure.offsets is not None for measure in measures):
            offsets = np.concatenate(
                [
                    np.zeros(len(measure)) if measure.offsets is None else measure.offsets
                    for measure in measures
                ]
            )
            self.range_of_offsets = self.of.largest(offsets) + self.of.largest(-offsets)
        self.cloud = operations.upload_batch(points, self.weights, self.of.counts, offsets)


def some(problem: Problem, problems: IntArray) -> Problem:
    """Return some of many problems; the only one as it is.

    Parameters
    ----------
    problem : Problem
        One problem, or made by this function or by `problem_of_many`.
    problems : (k,) array
        Their numbers, ascending.
    """
    if len(problems) == np.size(problem.masses[0]) or not problem.of_rows.shape:
        return problem
    sides = []
    for of, weights, cloud in (
        (problem.of_rows, problem.a, problem.rows), (problem.of_columns, problem.b, problem.columns)
    ):  # fmt: skip
        assert isinstance(of, Segments)
        kept = problem.operations.take_batch(cloud, problems)
        sides.append((of.some(problems), weights[of.points_of(problems)], kept))
    (of_rows, a, rows), (of_columns, b, columns) = sides
    numbers, operations = problem.to_rows.numbers[problems], problem.operations
    to_rows = BatchSoftmin(operations, rows, columns, of_rows, of_columns, numbers)
    to_columns = to_rows
    if problem.to_columns is not problem.to_rows:
        to_columns = BatchSoftmin(operations, columns, rows, of_columns, of_rows, numbers)
    made = Problem(
        to_rows, to_columns, (a, b), problem.rho, problem.largest_cost[problems],
        (of_rows, of_columns),
    )  # fmt: skip
    one, other = problem.oscillations
    made.oscillations = one[problems], other[problems]
    made.exact_sums = problem.exact_sums
    return made


class _Measured:
    """What is known of one problem's last softmins."""

    truncation: float | None = None
    left_out, visited = 0.0, 1.0

    def __init__(self, roundoff: float) -> None:
        self.roundoff = roundoff


def one_measured(problem: Problem, number: int, roundoffs: tuple[float, float]) -> Problem:
    """Return one of many problems, for its certificate alone.

    Parameters
    ----------
    problem : Problem
    number : int
    roundoffs : (of T(g), of T(f))
        The bounds that came with its last bounded softmins.
    """
    of_rows, of_columns = problem.reductions
    assert isinstance(of_rows, Segments)
    assert isinstance(of_columns, Segments)
    weights = of_rows.part(problem.a, number), of_columns.part(problem.b, number)
    made = Problem(
        _Measured(roundoffs[0]), _Measured(roundoffs[1]), weights, problem.rho,
        float(problem.largest_cost[number]), (WHOLE, WHOLE),
    )  # fmt: skip
    rows, columns = problem.oscillations
    made.oscillations = float(rows[number]), float(columns[number])
    return made
