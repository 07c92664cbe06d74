"""The matrix of Sinkhorn divergences on many workers (paper, 2.2; math: S)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph._shared.validation import check_integer, errors_about
from clmorph.backends.select import get_backend
from clmorph.batch.extra import TURN, check_client, check_device, on_workers
from clmorph.errors import ConvergenceWarning
from clmorph.measures.points import AnyMeasure, Pair, are_equal, as_many, as_pair
from clmorph.transport.divergence import check_symmetric, combined, one_regularization
from clmorph.transport.divergence_batch import solve_divergences
from clmorph.transport.options import Precision, SolverOptions
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Goal
from clmorph.transport.sinkhorn_batch import MeasuresLike

#: Measures along a side of a block.
BLOCK = 16


def divergence_matrix(
    measures: MeasuresLike,
    blur: float | None = None,
    reach: float | None = None,
    tol: float = SolverOptions.tol,
    max_iter: int = SolverOptions.max_iter,
    backend: str = "auto",
    *,
    client: Any,
    epsilon: float | None = None,
    rho: float | None = None,
    precision: Precision = "auto",
    block: int = BLOCK,
) -> Array:
    """Return the Sinkhorn divergences between all pairs of measures, from Dask's workers.

    Each measure is solved with itself once, and the results stay on the workers. Then each task
    solves a block of pairs at once, as `clmorph.divergence_matrix` does, and sends only its
    divergences.

    Parameters
    ----------
    measures : stacked arrays or a list of measures
    blur, reach, tol, max_iter, epsilon, rho, precision
        As in `clmorph.divergence_matrix`.
    backend : str
        The device of each worker, as `clmorph.get_backend` takes it.
    client : distributed.Client
        The client of a running scheduler.
    block : int
        Number of measures along a side of a block, 1 to 1024.

    Returns
    -------
    (B, B) array
        Cost units times mass; symmetric, never negative, and 0 on the diagonal.

    Raises
    ------
    InputError
        If an argument cannot be used, or no bound can be proven for a part of the result.
    DeviceError
        If a worker's device fails, or the scheduler ends.

    Warns
    -----
    ConvergenceWarning
        If a residual does not reach `tol`.

    Examples
    --------
    >>> import clmorph.batch
    >>> try:
    ...     clmorph.batch.divergence_matrix([([1.0], [0.0])], 0.1, client=None)
    ... except clmorph.InputError:
    ...     print("a client is needed")
    a client is needed
    """
    goal = one_regularization(blur, reach, epsilon, rho, tol, max_iter, precision)
    side = check_integer("block", block, 1, 1024)
    check_device(backend)
    own = _checked(as_many("measures", measures))
    check_client(client)
    solver = goal, backend
    values = np.zeros((len(own), len(own)))
    if not own:
        return values
    starts = range(0, len(own), side)
    groups = [own[start : start + side] for start in starts]
    selves, tasks, places, missed = [], [], [], 0
    futures: list[Any] = []
    with on_workers(client, futures, "with a smaller block if they lack memory"):
        sent = client.scatter(groups, broadcast=len(groups) > 1)
        selves += [
            client.submit(_solve_selves, group, start, solver, pure=False)
            for group, start in zip(sent, starts, strict=True)
        ]
        futures += selves
        for i, first in enumerate(starts):
            for j, second in enumerate(starts[i:], i):
                of_task = sent[i], sent[j], selves[i], selves[j], (first, second), solver
                tasks.append(client.submit(_solve_block, *of_task, pure=False))
                futures.append(tasks[-1])
                places.append((first, second))
        for (first, second), (part, unsolved) in zip(places, client.gather(tasks), strict=True):
            rows, columns = part.shape
            values[first : first + rows, second : second + columns] = part
            values[second : second + columns, first : first + rows] = part.T
            missed += unsolved
    if missed:
        warnings.warn(
            ConvergenceWarning(
                f"{missed} problems did not reach tol={goal.tol:g} in max_iter={goal.max_iter} "
                "iterations"
            ),
            stacklevel=2,
        )
    return values


def _checked(measures: list[Any]) -> list[AnyMeasure]:
    found: list[AnyMeasure] = []
    for number, measure in enumerate(measures):
        with errors_about(f"measure {number}"):
            # The first measure as the partner: all have one dimension.
            pair = as_pair(found[0] if found else measure, measure)
            check_symmetric(*pair)
        found.append(pair[1])
    return found


def _solve_selves(
    group: list[AnyMeasure], start: int, solver: tuple[Goal, str]
) -> tuple[list[Potentials], int]:
    """Return the potentials of each measure with itself, and how many missed the tolerance."""
    return _solve([(each, each) for each in group], lambda k: f"measure {start + k}", solver)


def _solve(
    pairs: list[Pair],
    name: Any,
    solver: tuple[Goal, str],
    selves: Sequence[tuple[Potentials, Potentials]] = (),
) -> tuple[list[Potentials], int]:
    goal, backend = solver
    if not pairs:
        return [], 0
    with TURN:
        operations = get_backend(backend)
        own = dict(enumerate(selves))
        solved = list(solve_divergences(pairs, own, goal, operations, lambda share: None, name))
    return solved, sum(not each.converged for each in solved)


def _solve_block(
    rows: list[AnyMeasure],
    columns: list[AnyMeasure],
    of_rows: tuple[list[Potentials], int],
    of_columns: tuple[list[Potentials], int],
    starts: tuple[int, int],
    solver: tuple[Goal, str],
) -> tuple[Array, int]:
    """Return the divergences of a block, and how many problems missed the tolerance."""
    on_diagonal = starts[0] == starts[1]
    places = [
        (i, j)
        for i in range(len(rows))
        for j in range(len(columns))
        if not (on_diagonal and j <= i) and not are_equal(rows[i], columns[j])
    ]

    def name(number: int) -> str:
        i, j = places[number]
        return f"measures {starts[0] + i} and {starts[1] + j}"

    selves = [(of_rows[0][i], of_columns[0][j]) for i, j in places]
    solved, missed = _solve([(rows[i], columns[j]) for i, j in places], name, solver, selves)
    values = np.zeros((len(rows), len(columns)))
    for (i, j), cross in zip(places, solved, strict=True):
        values[i, j] = combined(cross, of_rows[0][i], of_columns[0][j]).value
        if on_diagonal:
            values[j, i] = values[i, j]
    return values, missed + (of_rows[1] if on_diagonal else 0)
