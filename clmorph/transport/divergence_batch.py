"""The Sinkhorn divergences of many pairs, or of all pairs, of measures (paper, 2.2; math: S)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clmorph._shared.items import place_of
from clmorph._shared.typing import AnyArray, Array, Progress
from clmorph._shared.validation import check_flag, check_progress, errors_about, shown
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.measures.points import Pair, are_equal, as_many, as_pair
from clmorph.transport.divergence import (
    Divergence,
    better,
    check_symmetric,
    combined,
    further_tol,
    one_regularization,
)
from clmorph.transport.gradient import divergence_gradient
from clmorph.transport.options import Precision, SolverOptions
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Goal
from clmorph.transport.sinkhorn_batch import (
    MeasuresLike,
    PotentialsBatch,
    checked_pairs,
    problem_name,
    solve_many,
    warn_of_missed,
)

#: The share of the work that solving is, beside derivatives.
SOLVING = 0.8


def sinkhorn_divergence_batch(
    sources: MeasuresLike,
    targets: MeasuresLike,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | None = None,
    precision: Precision = "auto",
    progress: Progress | None = None,
    gradient: bool = False,
) -> list[Divergence]:
    """Return the Sinkhorn divergences of many pairs of measures, solved at once (paper, 2.2).

    Divergence b is that of `clmorph.sinkhorn_divergence` between `sources[b]` and `targets[b]`. The
    problems between them and those of each measure with itself are solved together, as by
    `clmorph.sinkhorn_batch`; a measure that occurs several times is solved with itself once.

    Parameters
    ----------
    sources, targets : stacked arrays or lists of measures
        As in `clmorph.sinkhorn_batch`; as many of both.
    blur, reach, tol, max_iter, backend, epsilon, rho, precision
        As in `clmorph.sinkhorn_divergence`, for all pairs.
    progress : callable, optional
        A function that is called with the share of the work that is done, from 0 to 1.
    gradient : bool
        Whether to compute the derivatives by points and weights too, as in
        `clmorph.sinkhorn_divergence`.

    Returns
    -------
    list of Divergence

    Raises
    ------
    InputError
        If an argument cannot be used, or no bound can be proven for a part of the result.

    Warns
    -----
    ConvergenceWarning
        If a residual does not reach `tol`.

    Examples
    --------
    >>> import clmorph
    >>> sources = [([0.5, 0.5], [0.0, x]) for x in (0.2, 0.4)]
    >>> targets = [([1.0], [0.1])] * 2
    >>> found = clmorph.sinkhorn_divergence_batch(sources, targets, 0.1, 0.3, backend="numpy")
    >>> [round(float(each), 4) for each in found]
    [0.0021, 0.0183]
    """
    goal = one_regularization(blur, reach, epsilon, rho, tol, max_iter, precision)
    report = check_progress(progress)
    gradient = check_flag("gradient", gradient)
    pairs = checked_pairs(as_many("sources", sources), as_many("targets", targets))
    operations = get_backend(backend)

    problems: list[Pair] = []
    names: list[str] = []
    known: dict[tuple[bytes, ...], int] = {}

    def place(pair: Pair, name: str) -> int:
        """Return the place of a problem among those to solve, in which it stands once."""
        key = tuple(
            part.tobytes() for measure in pair for part in (measure.points, measure.weights)
        )
        if key not in known:
            known[key] = len(problems)
            problems.append(pair)
            names.append(name)
        return known[key]

    places = []
    for number, pair in enumerate(pairs):
        with errors_about(problem_name(number)):
            check_symmetric(*pair)
        own = (
            place((measure, measure), f"{problem_name(number)}, {which} with itself")
            for measure, which in zip(pair, ("source", "target"), strict=True)
        )
        places.append((place(pair, problem_name(number)), *own))
    share = SOLVING if gradient else 1.0
    name = names.__getitem__
    solved = solve_divergences(
        problems, {cross: (source, target) for cross, source, target in places}, goal, operations,
        lambda done: report(share * done), name,
    )  # fmt: skip
    found = []
    for number, (pair, numbers) in enumerate(zip(pairs, places, strict=True)):
        cross, own_source, own_target = (solved[each] for each in numbers)
        with errors_about(problem_name(number)):
            divergence = combined(cross, own_source, own_target)
        if gradient:
            derivatives = divergence_gradient(pair, cross, (own_source, own_target), operations)
            divergence = replace(divergence, gradient=derivatives)
            report(share + (1 - share) * (number + 1) / len(pairs))
        found.append(divergence)
    warn_of_missed(solved, name)
    return found


def solve_divergences(
    pairs: Sequence[Pair],
    selves: Mapping[int, tuple[Any, Any]],
    goal: Goal,
    operations: Operations,
    report: Progress,
    name: Callable[[int], str],
) -> PotentialsBatch:
    """Solve problems, and those with wide divergences further; see `further_tol`.

    selves: for each problem between two measures those of both with themselves, by their numbers
    or solved.
    """
    solved = solve_many(pairs, goal, operations, report, name)
    wide: dict[int, float] = {}
    for number, both in selves.items():
        own = [each if isinstance(each, Potentials) else solved[each] for each in both]
        if not np.isfinite(solved[number].gap) or solved[number] in own:
            continue
        smaller = further_tol(combined(solved[number], *own), goal.tol)
        if smaller is not None:
            wide[number] = smaller
    if not wide:
        return solved
    numbers = list(wide)
    again = solve_many(
        [pairs[number] for number in numbers], goal._replace(tol=min(wide.values())), operations,
        lambda share: None, lambda number: name(numbers[number]), exact=True,
    )  # fmt: skip
    for number, further in zip(numbers, again, strict=True):
        solved._put(number, better(solved[number], further, goal.tol))
    return solved


class DivergenceMatrix:
    """The Sinkhorn divergences between all pairs of B measures.

    ``matrix[i, j]`` is the `clmorph.Divergence` of a pair, with its potentials, and
    ``numpy.asarray(matrix)`` is `values`.

    Attributes
    ----------
    values : (B, B) array
        Cost units times mass; symmetric, never negative, and 0 on the diagonal.
    low, high : (B, B) arrays
        Bounds of the true values, rounding included, as in `clmorph.Divergence.interval`.
    converged : bool
        Whether all solves reached their tolerance.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> weights, points = np.full((3, 4), 1 / 4), np.linspace(0.0, 1.0, 12).reshape(3, 4)
    >>> matrix = clmorph.divergence_matrix((weights, points), 0.1, 0.3, backend="numpy")
    >>> matrix
    <DivergenceMatrix of 3 measures, all converged>
    >>> matrix[0, 2].closer_than(matrix[0, 1])
    False
    """

    def __init__(self, solved: PotentialsBatch, places: AnyArray) -> None:
        self._solved, self._places = solved, places
        count = len(places)
        self.values, self.low, self.high = whole = np.zeros((3, count, count))
        for i, j in np.transpose(np.triu_indices(count)).tolist():
            found = self[i, j]
            whole[:, i, j] = whole[:, j, i] = found.value, *found.interval
        self.converged = solved.converged

    def __len__(self) -> int:
        return len(self._places)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.values, dtype)

    def __repr__(self) -> str:
        how = "all converged" if self.converged else "not all converged"
        return f"<DivergenceMatrix of {len(self)} measures, {how}>"

    def __getitem__(self, pair: tuple[int, int]) -> Divergence:
        """Return the divergence of a pair of measures."""
        try:
            first, second = pair
        except (TypeError, ValueError):
            raise TypeError(
                f"index {shown(pair)}: expected two, as in matrix[0, 1]; numpy.asarray(matrix) has "
                "all values"
            ) from None
        i, j = (place_of(number, len(self)) for number in (first, second))
        return combined(self._between(i, j), self._between(i, i), self._between(j, j))

    def _between(self, i: int, j: int) -> Potentials:
        potentials = self._solved[int(self._places[min(i, j), max(i, j)])]
        return potentials.swapped() if i > j else potentials


def divergence_matrix(
    measures: MeasuresLike,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: Backend = "auto",
    *,
    epsilon: float | None = None,
    rho: float | None = None,
    precision: Precision = "auto",
    progress: Progress | None = None,
) -> DivergenceMatrix:
    """Return the Sinkhorn divergences between all pairs of many measures (paper, 2.2).

    All problems, those of each measure with itself once, are solved at once, as by
    `clmorph.sinkhorn_batch`. The divergence of a pair is that of `clmorph.sinkhorn_divergence`.

    Parameters
    ----------
    measures : stacked arrays or a list of measures
        Stacked arrays are (weights (B, N), points (B, N, D)), or points (B, N) in one dimension. A
        list holds what `clmorph.sinkhorn` takes, of any sizes.
    blur, reach, tol, max_iter, backend, epsilon, rho, precision
        As in `clmorph.sinkhorn_divergence`, for all pairs.
    progress : callable, optional
        A function that is called with the share of the work that is done, from 0 to 1.

    Returns
    -------
    DivergenceMatrix

    Raises
    ------
    InputError
        If an argument cannot be used, or no bound can be proven for a part of the result.

    Warns
    -----
    ConvergenceWarning
        If a residual does not reach `tol`.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> measures = [([0.5, 0.5], [0.0, x]) for x in (0.2, 0.4, 0.8)]
    >>> matrix = clmorph.divergence_matrix(measures, 0.1, 0.3, backend="numpy")
    >>> matrix.values.round(4).tolist()
    [[0.0, 0.0089, 0.0466], [0.0089, 0.0, 0.0314], [0.0466, 0.0314, 0.0]]
    """
    goal = one_regularization(blur, reach, epsilon, rho, tol, max_iter, precision)
    report = check_progress(progress)
    own = as_many("measures", measures)
    # Pairs (i, j) of measures, and the measures.
    between: list[tuple[int, int]] = []
    pairs: list[Pair] = []

    def name(number: int) -> str:
        i, j = between[number]
        return f"measure {i} with itself" if i == j else f"measures {i} and {j}"

    def add(i: int, j: int, source: Any, target: Any) -> None:
        between.append((i, j))
        with errors_about(name(-1)):
            pairs.append(as_pair(source, target))
            check_symmetric(*pairs[-1])

    for i, each in enumerate(own):
        add(i, i, each, each)
    places = np.diag(np.arange(len(own)))
    for i, j in np.transpose(np.triu_indices(len(own), 1)).tolist():
        places[i, j] = i if are_equal(pairs[i][0], pairs[j][0]) else len(pairs)
        if places[i, j] != i:
            add(i, j, pairs[i][0], pairs[j][0])
    operations = get_backend(backend)
    selves = {number: pair for number, pair in enumerate(between) if pair[0] != pair[1]}
    solved = solve_divergences(pairs, selves, goal, operations, report, name)
    warn_of_missed(solved, name)
    return DivergenceMatrix(solved, places)
