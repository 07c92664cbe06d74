"""Many problems of unbalanced entropic optimal transport at once (paper, 2.1 and 3.1)."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from clmorph._shared.items import Items
from clmorph._shared.typing import ArrayLike, IntArray, Progress
from clmorph._shared.validation import check_progress, errors_about
from clmorph.backends.interface import MAX_BATCH, Operations
from clmorph.backends.multi_device import members_of, turns
from clmorph.backends.select import Backend, get_backend
from clmorph.backends.threads import results_in_order
from clmorph.errors import InputError
from clmorph.measures.points import Checked, MeasureLike, Pair, as_many, as_pair
from clmorph.transport._solver.batch import NotFiniteError, problem_of_many
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport._solver.problem import check_problem, is_large
from clmorph.transport._solver.softmin import overflow
from clmorph.transport._solver.symmetric import is_symmetric, solve_symmetric
from clmorph.transport.options import AlgorithmOptions, Precision, Reach, SolverOptions
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Goal, regularization
from clmorph.transport.sinkhorn import finish, solve, warn_unless_converged

#: The numbers of problems that were solved together, and their solve, or the number of one that was
#: solved by itself, and its end.
Part = tuple[IntArray, Iteration] | tuple[int, Potentials]


class PotentialsBatch(Items[Potentials]):
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

    def __init__(self, parts: Iterable[Part], count: int) -> None:
        self._place: dict[int, tuple[Iteration, int]] = {}
        self._made: dict[int, Potentials] = {}
        self.statuses = [""] * count
        self.residuals, self.n_iter = np.zeros(count), np.zeros(count, np.int64)
        for part in parts:
            if isinstance(part[1], Potentials):
                self._put(*part)
                continue
            numbers, ended = part
            for place, number in enumerate(numbers):
                self._place[int(number)] = ended, place
                self.statuses[number] = ended.status[place]
            self.residuals[numbers], self.n_iter[numbers] = ended.residual, ended.n_iter

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what is pickled: all potentials, which need no device."""
        return batch_of, (list(self),)

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

    def _item(self, number: int) -> Potentials:
        """Return the potentials of a problem."""
        if number not in self._made:
            ended, place = self._place[number]
            self._made[number] = finish(ended.outcome(place), None)
        return self._made[number]

    def _put(self, number: int, potentials: Potentials) -> None:
        """Let a problem have other potentials."""
        self._made[number], self.statuses[number] = potentials, potentials.status
        self.residuals[number], self.n_iter[number] = potentials.residual, potentials.n_iter


def batch_of(potentials: Sequence[Potentials]) -> PotentialsBatch:
    """Return potentials as a batch."""
    return PotentialsBatch(enumerate(potentials), len(potentials))


#: Argument of the functions for many measures.
MeasuresLike = tuple[ArrayLike, ArrayLike] | Iterable[MeasureLike]


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
        See `clmorph.get_backend`. Several devices share the problems.
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
    goal = regularization(blur, reach, epsilon, rho, tol, max_iter, precision)
    report = check_progress(progress)
    pairs = checked_pairs(as_many("sources", sources), as_many("targets", targets))
    found = solve_many(pairs, goal, get_backend(backend), report)
    warn_of_missed(found, problem_name)
    return found


def problem_name(number: int) -> str:
    """Return the name of a problem in messages."""
    return f"problem {number}"


def warn_of_missed(found: PotentialsBatch, name: Callable[[int], str]) -> None:
    """Warn the caller of a public function, which calls this itself, of solves that missed."""
    missed = [number for number, each in enumerate(found.statuses) if each != "converged"]
    if missed:
        how = f"{name(missed[0])}: {found[missed[0]].message}"
        message = f"{len(missed)} of {len(found)} solves did not converge; {how}"
        warn_unless_converged("missed", message, 4)


def checked_pairs(sources: list[Any], targets: list[Any]) -> list[Pair]:
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
        with errors_about(problem_name(number)):
            pairs.append(as_pair(*pair))
    return pairs


def solve_many(
    pairs: Sequence[Pair],
    goal: Goal,
    operations: Operations,
    report: Progress,
    name: Callable[[int], str] = problem_name,
    exact: bool = False,
) -> PotentialsBatch:
    """Solve the problems of checked pairs of measures, without a warning."""
    for number, pair in enumerate(pairs):
        with errors_about(name(number)):
            check_problem(pair, goal, operations)
    lists = together(pairs, goal.rho, len(members_of(operations)))
    done, lock = [0.0] * len(lists), threading.Lock()

    def part(member: int, place: int) -> Part:
        """Solve the problems of a list on a device."""
        numbers, device = lists[place], members_of(operations)[member]
        own = [pairs[number] for number in numbers]

        def share(value: float) -> None:
            with lock:
                done[place] = value * len(own)
                report(sum(done) / len(pairs))

        try:
            if _is_single(own[0]):
                return numbers[0], solve(device, own[0], goal, share, exact=exact)
            problem = problem_of_many(device, own, goal.rho)
            if is_symmetric(own[0], goal.rho):
                ended = solve_symmetric(problem, goal, share)
            else:
                ended = Iteration(problem, goal, share, exact=exact).run()
            # Certificates, which may be asked for much later, need no clouds.
            for softmin in ended.problem.softmins:
                softmin.rows = softmin.columns = softmin.guess = None
            return np.array(numbers), ended
        except NotFiniteError as error:
            raise overflow(f"{name(numbers[error.problem])}: points") from None
        except InputError as error:
            raise InputError(f"{name(numbers[0])}: {error}") from None
        finally:
            done[place] = float(len(own))

    order = turns(operations, len(lists))
    if len(set(order)) < 2:
        parts = [part(order[place], place) for place in range(len(lists))]
    else:
        parts = list(results_in_order(order, part))
    return PotentialsBatch(parts, len(pairs))


def _is_single(pair: Pair) -> bool:
    """Return whether a problem is solved by itself."""
    return is_large(pair) or max(len(measure) for measure in pair) > MAX_BATCH


def together(pairs: Sequence[Pair], rho: tuple[float, float], devices: int = 1) -> list[list[int]]:
    """Return the problems solved together, of one dimension and kind, in lists for devices."""
    lists: list[list[int]] = []
    #: The list of each kind that is not full, and its numbers of points.
    open_lists: dict[tuple[int, bool], tuple[list[int], list[int]]] = {}
    for number, pair in enumerate(pairs):
        sizes = [len(measure) for measure in pair]
        if _is_single(pair):
            lists.append([number])
            continue
        kind = pair[0].points.shape[1], is_symmetric(pair, rho)
        own, total = open_lists.get(kind, ([], [0, 0]))
        total = [sum(both) for both in zip(total, sizes, strict=True)]
        if not own or max(total) > MAX_BATCH:
            own, total = [], sizes
            lists.append(own)
        own.append(number)
        open_lists[kind] = own, total
    if devices == 1:
        return lists
    # Each device has a part of every list.
    pieces = (np.array_split(own, min(devices, len(own))) for own in lists)
    return [piece.tolist() for of_list in pieces for piece in of_list]
