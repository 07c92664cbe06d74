"""Progress reports of long computations."""

from collections.abc import Callable, Iterator, Sequence
from typing import Self, TypeVar


class Share(float):
    """The share of the work that is done, from 0 to 1: a float, with a note such as a residual."""

    note: str

    def __new__(cls, share: float, note: str = "") -> Self:
        """Create a share from a number and its note."""
        self = super().__new__(cls, share)
        self.note = note
        return self


#: A function that is called with the name of a stage and the share of it that is done.
StageProgress = Callable[[str, float], None]
#: A function that is called with the share of one computation that is done.
Report = Callable[[float], None]
Item = TypeVar("Item")


def tracked(items: Sequence[Item], report: Report) -> Iterator[Item]:
    """Yield the items one by one and report each before the next is requested."""
    for number, item in enumerate(items):
        yield item
        report(Share((number + 1) / len(items), f"{number + 1} of {len(items)}"))
