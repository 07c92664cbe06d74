"""The Sinkhorn divergences of many pairs of measures at once (paper, 2.2; math: S)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from clmorph._shared.typing import Progress
from clmorph._shared.validation import check_flag, check_progress, errors_about
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.measures.many import as_many
from clmorph.measures.points import AnyMeasure
from clmorph.transport._solver.checks import check_solver_options
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
from clmorph.transport.potentials_batch import PotentialsBatch
from clmorph.transport.regularization import Regularization
from clmorph.transport.sinkhorn_batch import (
    MeasuresLike,
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
    given = one_regularization(blur, reach, epsilon, rho)
    tol, max_iter, _ = check_solver_options(tol, max_iter, precision=precision)
    report = check_progress(progress)
    gradient = check_flag("gradient", gradient)
    pairs = checked_pairs(as_many("sources", sources), as_many("targets", targets))
    for number, pair in enumerate(pairs):
        with errors_about(problem_name(number)):
            check_symmetric(*pair)
    operations = get_backend(backend)

    problems: list[tuple[AnyMeasure, AnyMeasure]] = []
    names: list[str] = []
    known: dict[tuple[bytes, ...], int] = {}

    def place(pair: tuple[AnyMeasure, AnyMeasure], name: str) -> int:
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
        name = problem_name(number)
        own = (
            place((measure, measure), f"{name}, {which} with itself")
            for measure, which in zip(pair, ("source", "target"), strict=True)
        )
        places.append((place(pair, name), *own))
    share = SOLVING if gradient else 1.0
    options = given, tol, max_iter, operations, precision
    solved = solve_many(
        problems, *options, lambda done: report(share * done), names.__getitem__
    )  # fmt: skip
    selves = {cross: (solved[source], solved[target]) for cross, source, target in places}
    solve_further(solved, selves, problems, *options, names.__getitem__)
    found = []
    for number, (pair, numbers) in enumerate(zip(pairs, places, strict=True)):
        cross, own_source, own_target = (solved[each] for each in numbers)
        with errors_about(problem_name(number)):
            divergence = combined(cross, own_source, own_target, given)
        if gradient:
            derivatives = divergence_gradient(pair, cross, (own_source, own_target), operations)
            divergence = replace(divergence, gradient=derivatives)
            report(share + (1 - share) * (number + 1) / len(pairs))
        found.append(divergence)
    warn_of_missed(solved, names.__getitem__)
    return found


def solve_further(
    solved: PotentialsBatch,
    selves: Mapping[int, tuple[Potentials, Potentials]],
    pairs: Sequence[tuple[AnyMeasure, AnyMeasure]],
    given: Regularization,
    tol: float,
    max_iter: int,
    operations: Operations,
    precision: str,
    name: Callable[[int], str],
) -> None:
    """Solve problems with wide divergences further, and change `solved`; see `further_tol`."""
    wide: dict[int, float] = {}
    for number, own in selves.items():
        if not np.isfinite(solved[number].gap) or solved[number] in own:
            continue
        smaller = further_tol(combined(solved[number], *own, given), tol)
        if smaller is not None:
            wide[number] = smaller
    if not wide:
        return
    numbers, smallest = list(wide), min(wide.values())
    again = solve_many(
        [pairs[number] for number in numbers], given, smallest, max_iter, operations, precision,
        lambda share: None, lambda number: name(numbers[number]), exact=True,
    )  # fmt: skip
    for number, further in zip(numbers, again, strict=True):
        solved._put(number, better(solved[number], further, tol))
