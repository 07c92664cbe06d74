"""Kinds of option values (numbers, choices, flags, texts): checks, conversions, JSON Schema."""

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
    """The values that an option accepts."""

    #: Returns the converted value, given a name and a value, or raises InputError.
    check: Callable[[str, Any], Any]
    #: The description of such values in error messages.
    expected: str
    #: The placeholder of the value in the help.
    metavar: str
    #: Converts a text of the command line to a value, or raises ValueError.
    read: Callable[[str], Any]
    #: The JSON Schema of such values.
    schema: Mapping[str, Any]
    #: Whether a value of TOML or JSON is of this kind, before the value is converted.
    scalar: Callable[[Any], bool]
    #: Texts of the external form (see `_shared.options`) and the values for which they stand,
    #: beside the option's own word for None.
    words: tuple[tuple[str, Any], ...] = ()
    #: Whether the option accepts two values, one for the source and one for the target.
    pair: bool = False
    #: Whether the value is a sequence, to which each use on the command line adds.
    several: bool = False
    #: The description of values of TOML and JSON, if it is not `expected`.
    in_files: str = ""


def _is_number(value: Any) -> bool:
    number = as_float(value)
    return number is not None and math.isfinite(number)


def number(low: float, high: float, *, open_low: bool = False) -> Kind:
    """Return the kind of numbers in [low, high], or (low, high] if `open_low`."""

    def check(name: str, value: Any) -> float:
        return check_number(name, value, low, high, open_low=open_low)

    least = "exclusiveMinimum" if open_low else "minimum"
    schema = {"type": "number", least: low, "maximum": high}
    return Kind(check, "a finite number", "number", float, schema, _is_number)


def integer(low: int, high: int) -> Kind:
    """Return the kind of whole numbers in [low, high]."""
    schema = {"type": "integer", "minimum": low, "maximum": high}
    return Kind(
        lambda name, value: check_integer(name, value, low, high),
        "a whole number", "integer", int, schema,
        lambda value: _is_number(value) and float(as_float(value) or 0.0).is_integer(),
    )  # fmt: skip


def choice(literal: Any, former: Mapping[str, str] | None = None) -> Kind:
    """Return the kind of the texts of a `Literal`; `former` texts give a warning and still work."""
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
