"""Many problems of unbalanced entropic optimal transport at once (paper, 2.1 and 3.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, overload

import numpy as np

from clmorph._shared.typing import Array, ArrayLike, IntArray, Progress
from clmorph._shared.validation import check_progress
from clmorph.backends.interface import MAX_BATCH, Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.many import Checked, as_many
from clmorph.measures.points import AnyMeasure, MeasureLike, as_pair
from clmorph.transport._solver.batch import NotFiniteError, one_measured, problem_of_many
from clmorph.transport._solver.batch_iteration import BatchIteration
from clmorph.transport._solver.batch_steps import segments
from clmorph.transport._solver.checks import (
    check_problem,
    check_solver_options,
    choose_truncation,
)
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.softmin import MANY_PAIRS, overflow
from clmorph.transport.options import AlgorithmOptions, Precision, Reach, SolverOptions
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Regularization, regularization
from clmorph.transport.sinkhorn import outcome, solve, warn_unless_converged

#: Argument of the functions for many measures.
MeasuresLike = tuple[ArrayLike, ArrayLike] | Iterable[MeasureLike]


class PotentialsBatch(Sequence[Potentials]):
    """The potentials of many problems, in the order of the problems.

    Each `clmorph.Potentials`, with its certificate, is made when it is first asked for.

    Attributes
    ----------
    statuses : list of str
        How each solve ended, see `clmorph.Potentials`.
    residuals : (B,) array
        Residual of each problem.
    n_iter : (B,) array of int
        Number of iterations of each problem.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> weights, points = np.full((4, 3), 1 / 3), np.linspace(0.0, 1.0, 12).reshape(4, 3)
    >>> found = clmorph.sinkhorn_batch(
    ...     (weights, points), (weights, points + 0.1), blur=0.1, reach=0.3, backend="numpy"
    ... )
    >>> found
    <PotentialsBatch of 4 problems, all converged>
    >>> [round(each.transported_mass, 2) for each in found[1:3]]
    [0.96, 0.96]
    """

    def __init__(self, parts: list[_Part], count: int) -> None:
        self._parts = parts
        self._place: dict[int, tuple[_Part, int]] = {}
        self.statuses = [""] * count
        self.residuals, self.n_iter = np.zeros(count), np.zeros(count, np.int64)
        for part in parts:
            for place, number in enumerate(part.numbers):
                self._place[int(number)] = part, place
                self.statuses[number] = part.statuses[place]
            self.residuals[part.numbers], self.n_iter[part.numbers] = part.residuals, part.n_iter
        self._made: dict[int, Potentials] = {}

    def __len__(self) -> int:
        return len(self.statuses)

    def __repr__(self) -> str:
        missed = len(self) - self.statuses.count("converged")
        how = f"{missed} not converged" if missed else "all converged"
        return f"<PotentialsBatch of {len(self)} problems, {how}>"

    @property
    def converged(self) -> bool:
        """Whether all residuals are at most the tolerance."""
        return all(status == "converged" for status in self.statuses)

    @overload
    def __getitem__(self, key: int) -> Potentials: ...
    @overload
    def __getitem__(self, key: slice) -> list[Potentials]: ...
    def __getitem__(self, key: int | slice) -> Potentials | list[Potentials]:
        """Return the potentials of a problem, or a list of those of some."""
        if isinstance(key, slice):
            return [self[number] for number in range(len(self))[key]]
        number = range(len(self))[key]
        if number not in self._made:
            part, place = self._place[number]
            self._made[number] = part.make(place)
        return self._made[number]

    def __iter__(self) -> Iterator[Potentials]:
        return (self[number] for number in range(len(self)))


class _Solved:
    """Problems that were solved together."""

    def __init__(self, numbers: IntArray, iteration: BatchIteration, given: Regularization) -> None:
        self.numbers, self._iteration, self._given = numbers, iteration, given
        self.statuses: list[str] = list(iteration.status)
        self.residuals, self.n_iter = iteration.residual, iteration.n_iter
        self._histories: list[Array] | None = None

    def make(self, place: int) -> Potentials:
        """Return the potentials of a problem, by its place among these."""
        of, given = self._iteration, self._given
        rows, columns = segments(of.problem)
        f, t_rows = rows.part(of.f, place), rows.part(of.t_rows, place)
        g, t_columns = columns.part(of.g, place), columns.part(of.t_columns, place)
        roundoffs = float(of.roundoffs[0, place]), float(of.roundoffs[1, place])
        problem = one_measured(of.problem, place, roundoffs)
        if self._histories is None:
            self._histories = of.histories()
        status, residual = self.statuses[place], float(of.residual[place])
        n_iter = int(self.n_iter[place])
        message = outcome(status, n_iter, residual, of.tol, float(of.rounding[place]), of.precision)
        return Potentials(
            f.copy(), g.copy(), given.blur, given.reach, status, message, n_iter,
            residual, self._histories[place].copy(),
            problem.certificate(f, g, t_rows, t_columns, given.epsilon),
            bool(of.precise[place]), None, problem.error, 1.0,
        )  # fmt: skip


class _Single:
    """A problem that was solved by itself."""

    def __init__(self, number: int, potentials: Potentials) -> None:
        self.numbers, self._potentials = np.array([number]), potentials
        self.statuses, self.n_iter = [potentials.status], np.array([potentials.n_iter])
        self.residuals = np.array([potentials.residual])

    def make(self, place: int) -> Potentials:
        """Return the potentials."""
        return self._potentials


_Part = _Solved | _Single


def sinkhorn_batch(
    sources: MeasuresLike,
    targets: MeasuresLike,
    blur: float | None = None,
    reach: Reach = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | tuple[float, float] | None = None,
    precision: Precision = AlgorithmOptions.precision,
    progress: Progress | None = None,
    **others: Any,
) -> PotentialsBatch:
    """Solve many problems of unbalanced entropic optimal transport at once (paper, 2.1 and 3.1).

    Problem b is the one that `clmorph.sinkhorn` solves between `sources[b]` and `targets[b]`, by
    the same iteration to the same residual and with the same certificate. One launch of a kernel
    takes a step of all problems, and each problem stops by itself. For small problems, this is many
    times as fast as a loop over `clmorph.sinkhorn`.

    Parameters
    ----------
    sources, targets : stacked arrays or lists of measures
        Stacked arrays are (weights (B, N), points (B, N, D)), or points (B, N) in one dimension; N
        of sources and targets may differ. A list holds what `clmorph.sinkhorn` takes, of any sizes.
    blur, reach, tol, max_iter, epsilon, rho, precision
        As in `clmorph.sinkhorn`, for all problems.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`. Several devices solve a batch on the one with the largest share.
    progress : callable, optional
        A function that is called with the share of the work that is done, from 0 to 1.
    **others
        Other options of `clmorph.sinkhorn` are for single problems, and are refused.

    Returns
    -------
    PotentialsBatch
        A sequence of B `clmorph.Potentials`, each made when it is asked for.

    Raises
    ------
    InputError
        If an argument cannot be used. The message says which problem cannot be solved.
    DeviceError
        If `precision` is "float64" and the device has none.

    Warns
    -----
    ConvergenceWarning
        If the residual of a problem does not reach `tol`.

    Notes
    -----
    Up to 2^18 points are solved together; more are taken in parts. Problems of more points, or of
    2^27 pairs of points or more, are solved one by one.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> sources = [(np.full(n, 1 / n), np.linspace(0.0, 1.0, n)) for n in (3, 5)]
    >>> targets = [(np.full(2, 1 / 2), np.array([0.25, 0.75]))] * 2
    >>> found = clmorph.sinkhorn_batch(sources, targets, blur=0.1, reach=0.3, backend="numpy")
    >>> len(found), found.converged, found[1].f.shape
    (2, True, (5,))
    >>> one = clmorph.sinkhorn(sources[0], targets[0], blur=0.1, reach=0.3, backend="numpy")
    >>> bool(abs(found[0].dual - one.dual) <= one.gap + found[0].gap)
    True
    """
    if others:
        name = next(iter(others))
        raise InputError(
            f"sinkhorn_batch has no option {name!r}: expected the options that define the problem, "
            "and precision, backend and progress; use clmorph.sinkhorn for a single problem"
        )
    given = regularization(blur, reach, epsilon, rho)
    tol, max_iter, _ = check_solver_options(tol, max_iter, precision=precision)
    report = check_progress(progress)
    pairs = _pairs(as_many("sources", sources), as_many("targets", targets))
    operations = get_backend(backend)
    found = solve_many(pairs, given, tol, max_iter, operations, precision, report)
    return _warned(found)


def _warned(found: PotentialsBatch) -> PotentialsBatch:
    """Return potentials, and warn if not all reached the tolerance."""
    if not found.converged:
        warn_unless_converged("missed", what_missed(found, _name))
    return found


def _name(number: int) -> str:
    """Return the name of a problem in messages."""
    return f"problem {number}"


def what_missed(found: PotentialsBatch, name: Callable[[int], str]) -> str:
    """Return how many solves did not converge, and how the first of them ended.

    Parameters
    ----------
    found : PotentialsBatch
        Not all converged.
    name : callable
        A function that returns the name of a problem.
    """
    missed = [number for number, each in enumerate(found.statuses) if each != "converged"]
    first = missed[0]
    return (
        f"{len(missed)} of {len(found)} solves did not converge; {name(first)}: "
        f"{found[first].message}"
    )


def _pairs(sources: list[Any], targets: list[Any]) -> list[tuple[AnyMeasure, AnyMeasure]]:
    """Return the checked measures of every problem."""
    if len(sources) != len(targets):
        raise InputError(
            f"there are {len(sources)} sources and {len(targets)} targets: expected as many, one "
            "pair for each problem"
        )
    both = list(zip(sources, targets, strict=True))
    if isinstance(sources, Checked) and isinstance(targets, Checked):
        dimensions = {measure.points.shape[1] for pair in both[:1] for measure in pair}
        if len(dimensions) == 1:
            return both
    pairs = []
    for number, pair in enumerate(both):
        try:
            pairs.append(as_pair(*pair))
        except InputError as error:
            raise InputError(f"{_name(number)}: {error}") from None
    return pairs


def solve_many(
    pairs: Sequence[tuple[AnyMeasure, AnyMeasure]],
    given: Regularization,
    tol: float,
    max_iter: int,
    operations: Operations,
    precision: str,
    report: Progress,
    name: Callable[[int], str] = _name,
) -> PotentialsBatch:
    """Solve the problems of checked pairs of measures, without a warning.

    Parameters
    ----------
    pairs : sequence of (source, target)
    given : Regularization
    tol, max_iter, precision, report
        Checked arguments of `sinkhorn_batch`.
    operations : Operations
    name : callable
        A function that returns the name of a problem for error messages.
    """
    for number, pair in enumerate(pairs):
        try:
            check_problem(*pair, given, operations, precision)
        except InputError as error:
            raise InputError(f"{name(number)}: {error}") from None
    done, parts = 0, list[_Part]()
    for numbers in together(pairs):
        own = [pairs[number] for number in numbers]

        def share(value: float, done: int = done, count: int = len(own)) -> None:
            report((done + value * count) / len(pairs))

        options = tol, max_iter, precision, share
        try:
            if _is_large(own[0]):
                parts.append(_Single(numbers[0], _solve_large(own[0], operations, given, *options)))
            else:
                problem = problem_of_many(operations, own, given.rho)
                iteration = BatchIteration(problem, given.blur, *options)
                iteration.run()
                parts.append(_Solved(np.array(numbers), iteration, given))
        except NotFiniteError as error:
            raise overflow(f"{name(numbers[error.problem])}: points") from None
        except InputError as error:
            raise InputError(f"{name(numbers[0])}: {error}") from None
        done += len(own)
    return PotentialsBatch(parts, len(pairs))


def _is_large(pair: tuple[AnyMeasure, AnyMeasure]) -> bool:
    """Return whether a problem is solved by itself."""
    sizes = [len(measure) for measure in pair]
    return sizes[0] * sizes[1] >= MANY_PAIRS or max(sizes) > MAX_BATCH


def _solve_large(
    pair: tuple[AnyMeasure, AnyMeasure],
    operations: Operations,
    given: Regularization,
    tol: float,
    *options: Any,
) -> Potentials:
    """Solve a problem by itself."""
    limit = choose_truncation("auto", tol, len(pair[0]) * len(pair[1]) >= MANY_PAIRS)
    problem = Problem.between(operations, *pair, given.rho, limit)
    return solve(problem, pair, given, tol, *options)


def together(pairs: Sequence[tuple[AnyMeasure, AnyMeasure]]) -> list[list[int]]:
    """Return the numbers of the problems that are solved together: lists of one dimension each.

    Parameters
    ----------
    pairs : sequence of (source, target)
    """
    lists: list[list[int]] = []
    #: The list of each dimension that is not full, and its numbers of points.
    open_lists: dict[int, tuple[list[int], list[int]]] = {}
    for number, pair in enumerate(pairs):
        sizes = [len(measure) for measure in pair]
        if _is_large(pair):
            lists.append([number])
            continue
        dimension = pair[0].points.shape[1]
        own, total = open_lists.get(dimension, ([], [0, 0]))
        total = [sum(both) for both in zip(total, sizes, strict=True)]
        if not own or max(total) > MAX_BATCH:
            own, total = [], sizes
            lists.append(own)
        own.append(number)
        open_lists[dimension] = own, total
    return lists
