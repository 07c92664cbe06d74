"""Numbers of the judge: long double, intervals, and one function without cancellation."""

from dataclasses import dataclass
from typing import Any

import numpy as np

#: 64 bits of mantissa on x86; on Windows and on most ARM systems it is float64 under another name.
NUMBER = np.longdouble
#: Whether long double is more than float64.
EXTENDED = bool(np.finfo(NUMBER).eps < np.finfo(np.float64).eps)
#: (k - 1) / k! for k from 7 down to 2: the series of x e^x - e^x + 1, divided by x^2.
SERIES = [NUMBER(1) / n for n in (840, 144, 30, 8, 3, 2)]

Vector = np.ndarray[Any, Any]


def unit_of(number: Any) -> Any:
    """Return the unit roundoff of a type, in long double."""
    return NUMBER(np.finfo(number).eps) / 2


@dataclass(frozen=True)
class Interval:
    """A number and a bound of its error."""

    value: Any
    error: Any

    low = property(lambda self: self.value - self.error)
    high = property(lambda self: self.value + self.error)


def kl_terms(excess: Vector) -> Vector:
    """Return x e^x - e^x + 1, which is at least 0."""
    small = np.abs(excess) < 1e-3
    with np.errstate(over="ignore", invalid="ignore"):
        large = np.where(small, 0, excess)
        direct = large * np.exp(large) - np.expm1(large)
    series = np.zeros_like(excess)
    for coefficient in SERIES:
        series = series * excess + coefficient
    return np.where(small, excess**2 * series, direct)
