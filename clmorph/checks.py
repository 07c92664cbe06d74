"""Validation of options, with messages a user can act on."""

import math
from collections.abc import Sequence
from typing import Any

from clmorph.errors import InputError


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
    except (TypeError, ValueError):
        raise InputError(f"{name}={value!r}: {expected}") from None
    if isinstance(value, bool | str | bytes) or not math.isfinite(number):
        raise InputError(f"{name}={value!r}: {expected}")
    if number > high or number < low or (open_low and number == low):
        raise InputError(f"{name}={value!r}: {expected}")
    return number


def check_integer(name: str, value: Any, low: int, high: int) -> int:
    """Return `value` as an int within [low, high].

    Raises
    ------
    InputError
        If it is not a whole number in that range.
    """
    number = check_number(name, value, low, high)
    if number != int(number):
        raise InputError(f"{name}={value!r}: expected a whole number in [{low}, {high}]")
    return int(number)


def check_choice(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return `value` if it is one of `choices`.

    Raises
    ------
    InputError
        Otherwise.
    """
    if isinstance(value, str) and value in choices:
        return value
    raise InputError(f"{name}={value!r}: expected one of {', '.join(map(repr, choices))}")


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
