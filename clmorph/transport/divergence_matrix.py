"""The Sinkhorn divergences between all pairs of many measures (paper, 2.2; math: S)."""

from __future__ import annotations

from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array, Progress
from clmorph._shared.validation import check_progress, errors_about
from clmorph.backends.select import Backend, get_backend
from clmorph.measures.many import as_many
from clmorph.measures.points import AnyMeasure, as_pair
from clmorph.transport._solver.checks import check_solver_options
from clmorph.transport._solver.symmetric import are_equal
from clmorph.transport.divergence import Divergence, check_symmetric, combined, one_regularization
from clmorph.transport.divergence_batch import solve_further
from clmorph.transport.options import Precision, SolverOptions
from clmorph.transport.potentials import Potentials
from clmorph.transport.potentials_batch import PotentialsBatch
from clmorph.transport.regularization import Regularization
from clmorph.transport.sinkhorn_batch import MeasuresLike, solve_many, warn_of_missed


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

    def __init__(self, solved: PotentialsBatch, places: AnyArray, given: Regularization) -> None:
        self._solved, self._places, self._given = solved, places, given
        count = len(places)
        self.values, self.low, self.high = (np.zeros((count, count)) for _ in range(3))
        for i in range(count):
            for j in range(i, count):
                found = self[i, j]
                for array, value in zip(
                    (self.values, self.low, self.high), (found.value, *found.interval), strict=True
                ):
                    array[i, j] = array[j, i] = value
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
        i, j = (range(len(self))[number] for number in pair)
        return combined(self._between(i, j), self._between(i, i), self._between(j, j), self._given)

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
    given = one_regularization(blur, reach, epsilon, rho)
    tol, max_iter, _ = check_solver_options(tol, max_iter, precision=precision)
    report = check_progress(progress)
    own = as_many("measures", measures)
    # Pairs (i, j) of measures, and the measures.
    between = [(i, i) for i in range(len(own))]
    pairs = [_pair(i, i, own[i], own[i]) for i in range(len(own))]
    checked = [pair[0] for pair in pairs]
    places = np.diag(np.arange(len(own)))
    for i, j in zip(*np.triu_indices(len(own), 1), strict=True):
        if are_equal(checked[i], checked[j]):
            places[i, j] = places[i, i]
            continue
        places[i, j] = len(pairs)
        between.append((int(i), int(j)))
        pairs.append(_pair(int(i), int(j), checked[i], checked[j]))
    operations = get_backend(backend)

    def name(number: int) -> str:
        return _name(*between[number])

    solved = solve_many(pairs, given, tol, max_iter, operations, precision, report, name)
    selves = {number: (solved[i], solved[j]) for number, (i, j) in enumerate(between) if i != j}
    solve_further(solved, selves, pairs, given, tol, max_iter, operations, precision, name)
    warn_of_missed(solved, name)
    return DivergenceMatrix(solved, places, given)


def _name(i: int, j: int) -> str:
    """Return the name of a pair of measures in messages."""
    return f"measure {i} with itself" if i == j else f"measures {i} and {j}"


def _pair(i: int, j: int, source: Any, target: Any) -> tuple[AnyMeasure, AnyMeasure]:
    """Return the checked measures i and j."""
    with errors_about(_name(i, j)):
        pair = as_pair(source, target)
        check_symmetric(*pair)
    return pair
