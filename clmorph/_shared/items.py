"""Sequences whose items are made when they are read."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import TypeVar, overload

Item = TypeVar("Item")


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
        numbers = range(len(self))
        if isinstance(index, slice):
            return [self._item(number) for number in numbers[index]]
        try:
            number = numbers[index]
        except IndexError:
            last = len(numbers) - 1
            raise IndexError(f"index {index}: expected {-len(numbers)} to {last}") from None
        return self._item(number)


class MadeItems(Items[Item]):
    """Items that a function of their numbers makes each time, and that are not kept."""

    def __init__(self, make: Callable[[int], Item], count: int) -> None:
        self._make, self._count = make, count

    def __len__(self) -> int:
        return self._count

    def _item(self, index: int) -> Item:
        return self._make(index)
