"""Kinds of option values: numbers, whole numbers, choices, flags, texts.

A kind knows how a value is checked, how a text of the command line or a scalar of TOML and JSON
becomes one, and how JSON Schema describes it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from clmorph._shared.validation import (
    as_float,
    check_choice,
    check_flag,
    check_integer,
    check_number,
)
from clmorph.errors import InputError


@dataclass(frozen=True)
class Kind:
    """Which values an option takes.

    Attributes
    ----------
    check : callable
        Called with a name and a value; returns the value as it is used, or raises InputError.
    expected : str
        What an error calls such values.
    metavar : str
        What the help shows.
    read : callable
        Turns a text of the command line into a value; raises ValueError.
    schema : mapping
        As JSON Schema describes such values.
    scalar : callable
        Whether a value of TOML or JSON is of this kind, before it is converted.
    words : tuple of (text, value)
        Texts outside that stand for values here, beside the option's own word for None.
    pair : bool
        Whether two values may be given, for source and target.
    """

    check: Callable[[str, Any], Any]
    expected: str
    metavar: str
    read: Callable[[str], Any]
    schema: Mapping[str, Any]
    scalar: Callable[[Any], bool]
    words: tuple[tuple[str, Any], ...] = ()
    pair: bool = False


def _is_number(value: Any) -> bool:
    number = as_float(value)
    return number is not None and math.isfinite(number)


def _is_whole(value: Any) -> bool:
    return _is_number(value) and float(as_float(value) or 0.0).is_integer()


def number(
    low: float, high: float, *, open_low: bool = False, check: Callable[[Any], Any] | None = None
) -> Kind:
    """Return the kind of numbers in [low, high], or (low, high].

    Parameters
    ----------
    low, high : float
    open_low : bool
        Whether `low` itself is left out.
    check : callable, optional
        In place of the check of that range, called with the value.
    """

    def checked(name: str, value: Any) -> Any:
        if check is not None:
            return check(value)
        return check_number(name, value, low, high, open_low=open_low)

    least = "exclusiveMinimum" if open_low else "minimum"
    schema = {"type": "number", least: low, "maximum": high}
    return Kind(checked, "a finite number", "number", float, schema, _is_number)


def integer(low: int, high: int) -> Kind:
    """Return the kind of whole numbers in [low, high]."""

    def read(text: str) -> int:
        return int(text)

    schema = {"type": "integer", "minimum": low, "maximum": high}
    return Kind(
        lambda name, value: check_integer(name, value, low, high),
        "a whole number", "integer", read, schema, _is_whole,
    )  # fmt: skip


def choice(literal: Any) -> Kind:
    """Return the kind of the texts of a `Literal`."""
    choices = get_args(literal)
    return Kind(
        lambda name, value: check_choice(name, value, choices),
        f"one of {', '.join(map(repr, choices))}", "|".join(choices), str,
        {"enum": list(choices)}, lambda value: isinstance(value, str),
    )  # fmt: skip


def flag() -> Kind:
    """Return the kind of truth values."""

    def read(text: str) -> bool:
        raise ValueError(text)  # flags stand alone

    return Kind(
        check_flag, "true or false", "", read, {"type": "boolean"},
        lambda value: isinstance(value, bool),
    )  # fmt: skip


def text(metavar: str, check: Callable[[Any], Any]) -> Kind:
    """Return the kind of texts that a function checks."""
    return Kind(
        lambda name, value: check(value), "a text", metavar, str, {"type": "string"},
        lambda value: isinstance(value, str),
    )  # fmt: skip


def number_or(word: str, kind: Kind) -> Kind:
    """Return the kind of numbers to which a word is added that stands for itself."""

    def check(name: str, value: Any) -> Any:
        if isinstance(value, str) and value == word:
            return value
        try:
            return kind.check(name, value)
        except InputError as error:
            raise InputError(f"{error}, or {word!r}") from None

    def read(text: str) -> Any:
        return text if text == word else kind.read(text)

    return Kind(
        check, f"a number or {word!r}", f"{kind.metavar}|{word}", read,
        {"anyOf": [dict(kind.schema), {"const": word}]},
        lambda value: value == word or kind.scalar(value),
    )  # fmt: skip
