"""Kinds of option values: numbers, whole numbers, choices, flags, texts.

A kind defines how a value is checked, how a text of the command line or a scalar of TOML or JSON is
converted to a value, and how JSON Schema describes the value.
"""

import math
import warnings
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
from clmorph.errors import InputError, OptionWarning


@dataclass(frozen=True)
class Kind:
    """The values that an option accepts.

    Attributes
    ----------
    check : callable
        It is called with a name and a value, and returns the converted value or raises InputError.
    expected : str
        The description of such values in error messages.
    metavar : str
        The placeholder of the value in the help.
    read : callable
        It converts a text of the command line to a value, or raises ValueError.
    schema : mapping
        The JSON Schema of such values.
    scalar : callable
        It returns whether a value of TOML or JSON is of this kind, before the value is converted.
    words : tuple of (text, value)
        Texts of the external form (see `_shared.options`) and the values for which they stand,
        beside the option's own word for None.
    pair : bool
        Whether the option accepts two values, one for the source and one for the target.
    several : bool
        Whether the value is a sequence, to which each use on the command line adds.
    """

    check: Callable[[str, Any], Any]
    expected: str
    metavar: str
    read: Callable[[str], Any]
    schema: Mapping[str, Any]
    scalar: Callable[[Any], bool]
    words: tuple[tuple[str, Any], ...] = ()
    pair: bool = False
    several: bool = False


def _is_number(value: Any) -> bool:
    number = as_float(value)
    return number is not None and math.isfinite(number)


def _is_whole(value: Any) -> bool:
    return _is_number(value) and float(as_float(value) or 0.0).is_integer()


def number(low: float, high: float, *, open_low: bool = False) -> Kind:
    """Return the kind of numbers in [low, high], or (low, high] if `open_low`."""

    def check(name: str, value: Any) -> float:
        return check_number(name, value, low, high, open_low=open_low)

    least = "exclusiveMinimum" if open_low else "minimum"
    schema = {"type": "number", least: low, "maximum": high}
    return Kind(check, "a finite number", "number", float, schema, _is_number)


def integer(low: int, high: int) -> Kind:
    """Return the kind of whole numbers in [low, high]."""

    def read(text: str) -> int:
        return int(text)

    schema = {"type": "integer", "minimum": low, "maximum": high}
    return Kind(
        lambda name, value: check_integer(name, value, low, high),
        "a whole number", "integer", read, schema, _is_whole,
    )  # fmt: skip


def choice(literal: Any, former: Mapping[str, str] | None = None) -> Kind:
    """Return the kind of the texts of a `Literal`.

    Parameters
    ----------
    literal : Literal
    former : mapping, optional
        Texts of earlier versions, with those that have taken their place. They give a warning.
    """
    choices, old = get_args(literal), former or {}

    def check(name: str, value: Any) -> str:
        if isinstance(value, str) and value in old:
            warnings.warn(
                OptionWarning(
                    f"{name}={value!r} means {name}={old[value]!r} now, and works until version "
                    f"1.0: write {old[value]!r}"
                ),
                stacklevel=2,
            )
            value = old[value]
        return str(check_choice(name, value, choices))

    return Kind(
        check,
        f"one of {', '.join(map(repr, choices))}", "|".join(choices), str,
        {"enum": list(choices)}, lambda value: isinstance(value, str),
    )  # fmt: skip


def flag() -> Kind:
    """Return the kind of truth values."""

    def read(text: str) -> bool:
        raise ValueError(text)  # a flag takes no text

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
    """Return a kind of numbers that accepts one word in addition; the word is its own value."""

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
