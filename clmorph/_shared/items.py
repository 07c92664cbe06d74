"""Sequences whose items are made when they are read."""

import operator
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, overload

from clmorph._shared.validation import shown

Item = TypeVar("Item")


def place_of(index: Any, count: int) -> int:
    """Return the number from 0 that an index means, which may count from the end."""
    try:
        return range(count)[operator.index(index)]
    except IndexError:
        raise IndexError(f"index {index}: expected {-count} to {count - 1}") from None
    except TypeError:
        raise TypeError(f"index {shown(index)}: expected a whole number") from None


class Items(Sequence[Item]):
    """A sequence whose items are made when they are read; a slice is a list of them."""

    @abstractmethod
    def _item(self, index: int) -> Item:
        """Return an item, by its number from 0."""

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        """Return an item, or a list of items for a slice."""
        if isinstance(index, slice):
            return [self._item(number) for number in range(len(self))[index]]
        return self._item(place_of(index, len(self)))


class MadeItems(Items[Item]):
    """Items that a function of their numbers makes each time, and that are not kept."""

    def __init__(self, make: Callable[[int], Item], count: int) -> None:
        self._make, self._count = make, count

    def __len__(self) -> int:
        return self._count

    def _item(self, index: int) -> Item:
        return self._make(index)
