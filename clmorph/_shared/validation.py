"""Validation of options, with messages that name a remedy.

The following count as numbers: Python's and NumPy's integers and floats, `Decimal`, `Fraction`, and
arrays without dimensions that hold one of these. Truth values, texts, complex numbers, durations,
masked elements and arrays with dimensions are not numbers, even where `float` would convert them.
"""

import math
import operator
import os
import reprlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from clmorph._shared.printable import printable
from clmorph.errors import InputError

#: Largest number of characters of a value that a message repeats.
SHOWN_LENGTH = 60


def check_number(
    name: str, value: Any, low: float, high: float, *, open_low: bool = False
) -> float:
    """Return `value` as a float in [low, high] or, if `open_low`, in (low, high]."""
    bracket = "(" if open_low else "["
    expected = f"expected a number in {bracket}{low:g}, {high:g}]"
    number = as_float(value)
    if number is None or not math.isfinite(number):
        raise InputError(f"{name}={shown(value)}: {expected}")
    if number > high or number < low or (open_low and number == low):
        raise InputError(f"{name}={shown(value)}: {expected}")
    return number


def check_integer(name: str, value: Any, low: int, high: int) -> int:
    """Return `value` as an int in [low, high]."""
    refused = InputError(f"{name}={shown(value)}: expected a whole number in [{low}, {high}]")
    number = as_float(value)
    if number is None:
        raise refused
    try:
        # Conversion to float would change an integer of more than 53 bits, such as a seed.
        whole = operator.index(value)
    except TypeError:
        if not number.is_integer():
            raise refused from None
        whole = int(number)
    if not low <= whole <= high:
        raise refused
    return whole


def check_choice(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return `value` if it is one of `choices`."""
    if isinstance(value, str) and value in choices:
        return value
    raise InputError(f"{name}={shown(value)}: expected one of {', '.join(map(repr, choices))}")


def check_max_pixels(value: Any) -> int:
    """Return the checked largest number of pixels of a file."""
    return check_integer("max_pixels", value, 1, 1 << 40)


def check_flag(name: str, value: Any) -> bool:
    """Return a truth value of Python or NumPy as bool; other true or false values are refused."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise InputError(f"{name}={shown(value)}: expected True or False")


@contextmanager
def errors_about(name: str, kind: type[InputError] = InputError) -> Iterator[None]:
    """Raise an InputError of the block as one of a kind that begins with a name."""
    try:
        yield
    except InputError as error:
        raise kind(f"{name}: {error}") from None


def check_progress(progress: Callable[..., None] | None) -> Callable[..., None]:
    """Return the progress function, or a function without effect for None."""
    if progress is not None and not callable(progress):
        raise InputError(f"progress={shown(progress)}: expected a function to call, or None")
    return progress or (lambda *told: None)


def as_float(value: Any) -> float | None:
    """Return a number as a float, NaN and infinity too; None if it is none, or beyond float64."""
    if np.ma.is_masked(value) or isinstance(value, bool | str | bytes | bytearray | complex):
        return None
    if isinstance(value, np.ndarray | np.generic):
        if value.ndim > 0 or value.dtype.kind not in "iufO":
            return None
        if value.dtype.kind == "O":
            return None if isinstance(value.item(), np.ndarray) else as_float(value.item())
    elif not any(hasattr(type(value), name) for name in ("__float__", "__index__")):
        return None
    try:
        if len(getattr(value, "shape", ())):
            return None  # a tensor with dimensions, for example
        with np.errstate(over="ignore"):
            return float(value)
    except Exception:
        # An exception of a foreign type means that the value is no number.
        return None


def is_path(value: Any) -> bool:
    """Return whether a value is a nonempty path: a text or a path object."""
    if not isinstance(value, str | os.PathLike):
        return False
    try:
        path = os.fspath(value)
    except Exception:
        # An exception of a foreign type means that the value is no path.
        return False
    return isinstance(path, str) and path != ""


def shown(value: Any) -> str:
    """Return a value in the form of messages: one short line of printable characters."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of shape {value.shape}"
    try:
        # Containers from files can be large and deeply nested, so their repr must be limited.
        text = (reprlib.repr if isinstance(value, list | tuple | dict | set) else repr)(value)
    except Exception:
        # The integer has more digits than Python writes, or a foreign type's repr has failed.
        text = f"<{type(value).__name__}>"
    return printable(text, SHOWN_LENGTH)
