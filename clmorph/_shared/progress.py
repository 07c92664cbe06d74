"""How long work reports what it has done."""

from collections.abc import Callable, Iterator, Sequence
from typing import Self, TypeVar


class Share(float):
    """A share of the work done, 0 to 1, with what there is to say about it.

    A plain number to who only wants that.

    Attributes
    ----------
    note : str
        Such as the residual that a solver has reached.
    """

    note: str

    def __new__(cls, share: float, note: str = "") -> Self:
        """Join a number and its note."""
        self = super().__new__(cls, share)
        self.note = note
        return self


#: Called with the name of a stage and the share of it that is done.
StageProgress = Callable[[str, float], None]
#: Called with the share of one piece of work that is done.
Report = Callable[[float], None]
Item = TypeVar("Item")


def tracked(items: Sequence[Item], report: Report) -> Iterator[Item]:
    """Return the items one by one and report each before the next is asked for."""
    for number, item in enumerate(items):
        yield item
        report(Share((number + 1) / len(items), f"{number + 1} of {len(items)}"))
