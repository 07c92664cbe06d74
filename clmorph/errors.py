"""Exceptions and warnings of clmorph.

Every message is one line that says what was wrong, what was expected, and what to do. File
names and values that it quotes may be foreign: whatever they hold, the message is printable and
of bounded length.
"""

from clmorph._shared.printable import MESSAGE, printable


class ClmorphError(Exception):
    """Base class of every error that clmorph raises on purpose."""

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message, MESSAGE))


class InputError(ClmorphError, ValueError):
    """A value given by the caller cannot be used: wrong shape, range, name or file."""


class FileError(InputError):
    """An image file cannot be read; the message begins with its name."""


class PlanSizeError(InputError):
    """A plan would keep more pairs than it may.

    Attributes
    ----------
    pairs : int
        How many it would keep.
    """

    def __init__(self, message: str, pairs: int) -> None:
        super().__init__(message)
        self.pairs = pairs

    def __reduce__(self) -> tuple[type["PlanSizeError"], tuple[str, int]]:
        """Return how it is made again, which pools of processes need to pass it on."""
        return type(self), (str(self), self.pairs)


class DeviceError(ClmorphError, RuntimeError):
    """No OpenCL device fits the request, or the device failed."""


class OutputError(ClmorphError, RuntimeError):
    """A result cannot be written where it was asked for."""


class ClmorphWarning(UserWarning):
    """Base class of every warning that clmorph gives."""

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message, MESSAGE))


class ConvergenceWarning(ClmorphWarning):
    """The transport solver stopped before it reached the tolerance."""


class MemoryWarning(ClmorphWarning):
    """Not all pairs of a plan fit into the memory allowed, so fewer particles are drawn."""


class PruningWarning(ClmorphWarning):
    """A threshold on log pi drops much of a plan's mass: it is too high for so many points."""


class ImageWarning(ClmorphWarning):
    """An image file was read, but not all of it was used: a color profile, bits, later pictures."""
