"""Compare the results of a backend with those of the NumPy twin, within proven tolerances."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph.backends.interface import KERNEL_ERROR, Operations
from clmorph.backends.records import Float64

#: Unit roundoff of float32.
UNIT = 2.0**-24
#: The largest error bound of `Operations.bounded_softmin`, in nats, that a comparison accepts.
LARGEST_BOUND = 1e-5
#: Errors to which wrong results can lead, because kernels return indices, counts and sizes, too.
SIGNS_OF_WRONG_RESULTS = ArithmeticError, AssertionError, IndexError, ValueError


def splat_tolerance(count: int, chunk: int = 1024) -> float:
    """Return the relative error that float32 sums of `count` splats may have.

    It is that of the additions of a chunk and of chunks, and of an exponent of up to 30.
    """
    return UNIT * (chunk + count / chunk + 4 * 30)


def splat_excess(
    sums: tuple[Float64, Float64],
    exact: Operations,
    splats: Any,
    shape: tuple[int, int],
    sigma: float,
    radius: float,
    relative: float,
) -> float:
    """Return the largest distance of a splat's sums from their range, in units of the tolerance.

    A kernel may be cut anywhere from `radius` to `radius` + `sigma`, which gives each sum a range.
    The tolerance around the range is `relative`, as of `splat_tolerance`, plus KERNEL_ERROR of
    every kernel. The splats are those of the exact operations, without colors below 0.
    """
    near, far = (exact.splat(splats, shape, sigma, cut) for cut in (radius, radius + sigma))
    tolerance = relative * far[1] + np.finfo(float).tiny
    if sigma > 0:
        _, kernels = exact.splat(splats, shape, 1e6 * (sigma + radius), radius + sigma)
        tolerance += KERNEL_ERROR * kernels
    excess = 0.0
    for got, low, high in zip(sums, near, far, strict=True):
        outside = np.maximum(low - got, got - high)
        scaled = outside / tolerance.reshape(shape + (1,) * (got.ndim - 2))
        # The comparison is written so that NaN is a failure.
        excess = max(excess, float(np.nan_to_num(scaled, nan=np.inf).max()))
    return excess


@dataclass(frozen=True)
class Finding:
    """The result of one comparison with the NumPy twin."""

    #: The operation and its setting.
    name: str
    #: The largest error, and the largest that is accepted, in `unit`.
    error: float
    tolerance: float
    #: Empty if the comparison ended in an error, which the name tells.
    unit: str

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


def words_of(error: Exception) -> str:
    """Return the class and the message of an error, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
