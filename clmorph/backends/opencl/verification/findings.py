"""What comparing a backend with NumPy finds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Unit roundoff of float32.
UNIT = 2.0**-24
#: The largest error bound of a soft minimum, in nats, that a comparison accepts.
LARGEST_BOUND = 1e-5
#: Errors to which wrong results can lead, because kernels return indices, counts and sizes, too.
SIGNS_OF_WRONG_RESULTS = ArithmeticError, AssertionError, IndexError, ValueError
#: The unit of errors that are divided by what is tolerated.
OF_TOLERANCE = "of the tolerance"


@dataclass(frozen=True)
class Finding:
    """The result of one comparison with NumPy."""

    #: The operation and its setting.
    name: str
    #: The largest error, and the largest that is accepted, in `unit`.
    error: float
    tolerance: float = 1.0
    #: Empty if the comparison ended in an error, which the name tells.
    unit: str = OF_TOLERANCE

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance."""
        return bool(self.error <= self.tolerance)

    @property
    def share(self) -> float:
        """The error as a share of the tolerance; infinite for an error where none is tolerated."""
        if self.tolerance > 0:
            return float(self.error) / float(self.tolerance)
        return 0.0 if self.error == 0 else float("inf")

    def __str__(self) -> str:
        if not self.unit:
            return self.name
        off = f"{self.error:.2g} {self.unit} (tolerance {self.tolerance:.2g})"
        return f"{self.name} is off by {off}"


def largest(differences: NDArray) -> float:
    """Return the largest size of differences; infinite if one is not a number."""
    return float(np.nan_to_num(np.abs(differences), nan=np.inf).max(initial=0.0))


def count_differences(got: NDArray, want: NDArray) -> float:
    """Return in how many entries two arrays differ; infinite if their shapes do."""
    return float(np.count_nonzero(got != want)) if got.shape == want.shape else float("inf")


def words_of(error: Exception) -> str:
    """Return the class and the message of an error, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
