"""Exceptions and warnings of clmorph.

Every message is one line that says what was wrong, what was expected, and what to do.
"""


class ClmorphError(Exception):
    """Base class of every error that clmorph raises on purpose."""


class InputError(ClmorphError, ValueError):
    """A value given by the caller cannot be used: wrong shape, range, name or file."""


class FileError(InputError):
    """An image file cannot be used; the message begins with its name."""


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


class ConvergenceWarning(UserWarning):
    """The transport solver stopped before it reached the tolerance."""


class MemoryWarning(UserWarning):
    """Not all pairs of a plan fit into the memory allowed, so fewer particles are drawn."""


class ImageWarning(UserWarning):
    """A file was read, but not all that it says about its colors was used."""
