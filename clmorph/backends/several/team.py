"""The devices of a backend that work at the same time, each for its rows."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.records import NearPairs
from clmorph.backends.several.clouds import Cloud, Part
from clmorph.backends.several.threads import Workers

T = TypeVar("T")


class Team:
    """Devices, and a thread for each of them but one, whose work the caller's thread does."""

    def __init__(self, members: Sequence[Operations]) -> None:
        self.members = list(members)
        self._workers = Workers(len(self.members) - 1)

    def on_each(self, work: Callable[[Operations, int], T]) -> list[T]:
        """Run an operation on every device, given the device and its number."""
        return self._workers.run_at_once(
            [partial(work, member, number) for number, member in enumerate(self.members)]
        )

    def over_parts(
        self, rows: Cloud, work: Callable[[Operations, Part, int], T]
    ) -> list[tuple[Part, T]]:
        """Run an operation on the device of each part, given the part and its place."""
        tasks = [
            partial(work, self.members[part.member], part, place)
            for place, part in enumerate(rows.parts)
        ]
        return list(zip(rows.parts, self._workers.run_at_once(tasks), strict=True))


def own_pairs(near: NearPairs | None, place: int) -> NearPairs | None:
    """Return the near pairs of one part."""
    return None if near is None else near.pairs[place]


def in_order(rows: Cloud, found: Sequence[tuple[Part, NDArray[Any]]]) -> NDArray[Any]:
    """Return the values of all parts' rows in the caller's order."""
    first = found[0][1]
    result = np.empty((rows.size, *first.shape[1:]), first.dtype)
    for part, values in found:
        result[part.rows] = values
    return result
