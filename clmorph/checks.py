"""Validation of options, with messages a user can act on."""

import math
import operator
from collections.abc import Sequence
from typing import Any

from clmorph.errors import InputError

#: The most characters of a value that a message repeats.
MOST_SHOWN = 100


def shown(value: Any) -> str:
    """Return a value as a message shows it: in one line, long ones shortened.

    Parameters
    ----------
    value : object
        Of any kind; Python itself refuses to print whole numbers of thousands of digits.
    """
    try:
        text = " ".join(repr(value).split())
    except ValueError:
        return f"a whole number of {value.bit_length()} bits"
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN // 2]}…"


def _is_number(value: Any) -> bool:
    """Whether a value may be meant as a number: truth values and texts are not."""
    return not isinstance(value, bool | str | bytes) and str(getattr(value, "dtype", "")) != "bool"


def check_number(
    name: str,
    value: Any,
    low: float,
    high: float,
    *,
    open_low: bool = False,
) -> float:
    """Return `value` as a float within [low, high], or (low, high] if `open_low`.

    Raises
    ------
    InputError
        If it is not a finite number in that range.
    """
    bracket = "(" if open_low else "["
    expected = f"expected a number in {bracket}{low:g}, {high:g}]"
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}={shown(value)}: {expected}") from None
    if not _is_number(value) or not math.isfinite(number):
        raise InputError(f"{name}={shown(value)}: {expected}")
    if number > high or number < low or (open_low and number == low):
        raise InputError(f"{name}={shown(value)}: {expected}")
    return number


def check_integer(name: str, value: Any, low: int, high: int) -> int:
    """Return `value` as an int within [low, high].

    Raises
    ------
    InputError
        If it is not a whole number in that range.
    """
    refused = InputError(f"{name}={shown(value)}: expected a whole number in [{low}, {high}]")
    if not _is_number(value):
        raise refused
    try:
        whole = operator.index(value)  # exact, however many digits it has
    except TypeError:
        try:
            number = float(value)
            whole = int(number)
        except (TypeError, ValueError, OverflowError):
            raise refused from None
        if number != whole:
            raise refused from None
    if not low <= whole <= high:
        raise refused
    return whole


def check_choice(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return `value` if it is one of `choices`.

    Raises
    ------
    InputError
        Otherwise.
    """
    if isinstance(value, str) and value in choices:
        return value
    raise InputError(f"{name}={shown(value)}: expected one of {', '.join(map(repr, choices))}")


def check_max_pixels(value: Any) -> int:
    """Return the most pixels that a file may have."""
    return check_integer("max_pixels", value, 1, 1 << 40)


def check_blur(value: Any) -> float:
    """Return a blur: positive, in the unit of the points (for images: the longer side)."""
    return check_number("blur", value, 1e-6, 1e6)


def check_reach(value: Any) -> float | None:
    """Return a reach: positive, same unit; None or infinity is balanced transport."""
    if value is None or (isinstance(value, float) and value == math.inf):
        return None
    try:
        return check_number("reach", value, 1e-6, 1e6)
    except InputError as error:
        raise InputError(f"{error}, or None for balanced transport") from None


def check_color_weight(value: Any) -> float:
    """Return a color weight: at least 0."""
    return check_number("color_weight", value, 0.0, 1e3)


def check_sigma(name: str, value: Any) -> float:
    """Return a kernel width in pixels: from a thousandth on."""
    return check_number(name, value, 1e-3, 1e4)
