"""The potentials of many problems, which `clmorph.sinkhorn_batch` returns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from clmorph._shared.items import Items
from clmorph._shared.typing import IntArray
from clmorph.transport._solver.iteration import Iteration
from clmorph.transport.potentials import Potentials
from clmorph.transport.regularization import Regularization
from clmorph.transport.sinkhorn import finish


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
        self._place: dict[int, tuple[Solved, int]] = {}
        self._made: dict[int, Potentials] = {}
        self.statuses = [""] * count
        self.residuals, self.n_iter = np.zeros(count), np.zeros(count, np.int64)
        for part in parts:
            if isinstance(part, tuple):
                self._put(*part)
                continue
            for place, number in enumerate(part.numbers):
                self._place[int(number)] = part, place
                self.statuses[number] = part.statuses[place]
            self.residuals[part.numbers], self.n_iter[part.numbers] = part.residuals, part.n_iter

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
            part, place = self._place[number]
            self._made[number] = part.make(place)
        return self._made[number]

    def _put(self, number: int, potentials: Potentials) -> None:
        """Let a problem have other potentials."""
        self._made[number], self.statuses[number] = potentials, potentials.status
        self.residuals[number], self.n_iter[number] = potentials.residual, potentials.n_iter


class Solved:
    """Problems that were solved together."""

    def __init__(self, numbers: IntArray, iteration: Iteration, given: Regularization) -> None:
        self.numbers, self._iteration, self._given = numbers, iteration, given
        self.statuses: list[str] = list(iteration.status)
        self.residuals, self.n_iter = iteration.residual, iteration.n_iter
        # Certificates, which may be asked for much later, need no clouds.
        for softmin in (iteration.problem.to_rows, iteration.problem.to_columns):
            softmin.rows = softmin.columns = None

    def make(self, place: int) -> Potentials:
        """Return the potentials of a problem, by its place among these."""
        return finish(self._iteration.outcome(place), self._given, None)


#: Problems that were solved together, or the number of one that was solved by itself, and its end.
Part = Solved | tuple[int, Potentials]


def batch_of(potentials: Sequence[Potentials]) -> PotentialsBatch:
    """Return potentials as a batch."""
    return PotentialsBatch(enumerate(potentials), len(potentials))
