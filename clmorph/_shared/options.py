"""Options: each is defined once, and all its uses are derived from the definition.

"Outside" means an option on the command line, in TOML and in recipes: there it can have another
name (``frames`` for ``n_frames``), another unit (gigabytes for bytes), and a word for None.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, ClassVar, Self
from warnings import warn

from clmorph._shared.option_kinds import Kind
from clmorph._shared.validation import as_float, shown
from clmorph.errors import InputError

#: The name of None in error messages of Python; outside, the option's word takes its place.
WITHOUT = "None"
#: Largest number of names that an error lists; more would fill the screen.
FEW = 16


@dataclass(frozen=True)
class Option:
    """The definition of an option, apart from its name, type and default."""

    kind: Kind
    #: The help, one line.
    help: str
    #: The heading under which the help shows the option.
    panel: str
    #: The unit of the value outside.
    unit: str = ""
    #: The option's name outside; empty if it is the same as in Python.
    outside: str = ""
    #: The text that stands for None outside.
    word: str = "none"
    #: The unit outside, in units of the value in Python.
    scale: float = 1.0
    #: Values that turn the option off, so that they do not remove its alternative.
    off: tuple[Any, ...] = (None, False)


def option(default: Any, kind: Kind, help: str, panel: str, **more: Any) -> Any:
    """Return a field of a class of options; see `Option`."""
    return field(default=default, metadata={"option": Option(kind, help, panel, **more)})


def with_default(options: type["Options"], name: str, value: Any) -> Any:
    """Return a copy of another class's field with a different default."""
    return field(default=value, metadata={"option": specifications(options)[name]})


@dataclass(frozen=True, init=False)
class Options:
    """Base of the classes of options, which are frozen, keyword-only and checked on creation."""

    #: Pairs of options that exclude each other, and why.
    alternatives: ClassVar[Mapping[tuple[str, str], str]] = {}
    #: Those of the pairs whose first option has a default, which the second one replaces.
    replacing: ClassVar[Sequence[tuple[str, str]]] = ()

    def __init__(self, **given: Any) -> None:
        known = specifications(type(self))
        for name in given:
            if name not in known:
                raise InputError(unknown_option(name, known))
        self._check_alternatives(given)
        values = {name: getattr(type(self), name) for name in known} | given
        for name, other in self.replacing:
            if given.get(other) is not None and name not in given:
                values[name] = None
        checked = {name: self.checked(name, value) for name, value in values.items()}
        for name, value in self.settle(checked).items():
            object.__setattr__(self, name, value)

    @classmethod
    def layered(cls, layers: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
        """Merge layers; later ones win, and options remove their alternatives from earlier ones."""
        settings: dict[str, Any] = {}
        for layer in layers:
            chosen = cls._check_alternatives(layer)
            for pair in cls.alternatives:
                for name, other in (pair, pair[::-1]):
                    if name in chosen:
                        settings.pop(other, None)
            settings |= layer
        return settings

    @classmethod
    def _check_alternatives(cls, layer: Mapping[str, Any]) -> set[str]:
        """Return the names of options that are on; InputError if two exclude each other."""
        known = specifications(cls)
        chosen = {
            name for name, value in layer.items()
            if name in known and not is_off(value, known[name].off)
        }  # fmt: skip
        for pair, reason in cls.alternatives.items():
            if chosen.issuperset(pair):
                first, second = (f"{name}={text_of(layer[name])}" for name in pair)
                raise InputError(f"{first} and {second} contradict ({reason}): give one of them")
        return chosen

    @classmethod
    def checked(cls, name: str, value: Any) -> Any:
        """Return the checked value of an option; None is valid if the option has a word for it."""
        known = specifications(cls)[name]
        if value is None and known.word:
            return None
        try:
            return known.kind.check(name, value)
        except InputError as error:
            more = f", or {WITHOUT}" if known.word and WITHOUT not in str(error) else ""
            raise InputError(f"{error}{more}") from None

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON Schema of the options in the form of files, by their names outside."""
        properties = {
            outside: _described(known, getattr(cls, name))
            for outside, (name, known) in by_outside_name(cls).items()
        }
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": cls.__name__,
            "type": "object",
            "properties": properties,
            "additionalProperties": False,
        }

    def settle(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return checked values, with those that others imply; InputError if they contradict."""
        return values

    def as_dict(self) -> dict[str, Any]:
        """Return the effective options by their names, without replaced alternatives."""
        settings = {each.name: getattr(self, each.name) for each in fields(self)}
        for name, other in self.replacing:
            del settings[name if settings[other] is not None else other]
        return settings

    def of(self, stage: type["Options"]) -> dict[str, Any]:
        """Return those of the options of another class that this one has, too, by their names."""
        known = specifications(type(self))
        return {name: getattr(self, name) for name in specifications(stage) if name in known}

    def replace(self, **given: Any) -> Self:
        """Return a copy of these options with some replaced."""
        return type(self)(**self.layered((self.as_dict(), given)))

    def chosen(self, names: Iterable[str], given: Mapping[str, Any]) -> Self:
        """Replace options that are among the names. Deprecated: `replace` takes its place."""
        warn(
            "chosen() will be removed in clmorph 1.0: use replace()",
            DeprecationWarning,
            stacklevel=2,
        )
        return self.replace(**among(given, names))

    def check_together(self) -> None:
        """Do nothing. Deprecated: options are checked when they are made."""
        warn("clmorph 1.0 will remove check_together(): options are checked when they are made",
             DeprecationWarning, stacklevel=2)  # fmt: skip

    @classmethod
    def of_call(cls, options: Any, given: Mapping[str, Any], example: str) -> Self:
        """Return a call's options, an object's replaced by name; `example` is one for messages."""
        if options is None:
            return cls(**given)
        if not isinstance(options, cls):
            raise InputError(
                f"options={shown(options)}: expected {cls.__name__}; give single options by name, "
                f"such as {example}"
            )
        return options.replace(**given)

    def outside(self) -> dict[str, Any]:
        """Return the options in the form of files: sorted, by their names outside."""
        known = specifications(type(self))
        found = {
            outside_name(name, known[name]): to_outside(known[name], value)
            for name, value in self.as_dict().items()
        }
        return dict(sorted(found.items()))


def is_off(value: Any, off: tuple[Any, ...]) -> bool:
    """Return whether a value is one of those that turn its option off."""
    return any(type(value) is type(each) and value == each for each in off)


def text_of(value: Any) -> str:
    """Return the text of an unchecked value for error messages."""
    return f"{value:g}" if isinstance(value, float) else shown(value)


def specifications(options: type[Options]) -> dict[str, Option]:
    """Return the definition of each option of a class, by its name."""
    return {each.name: each.metadata["option"] for each in fields(options)}


def outside_name(name: str, known: Option) -> str:
    """Return the name of an option outside."""
    return known.outside or name


def by_outside_name(options: type[Options]) -> dict[str, tuple[str, Option]]:
    """Return the name in Python and the definition of each option, by its name outside."""
    return {
        outside_name(name, known): (name, known) for name, known in specifications(options).items()
    }


def unknown_option(name: str, known: Mapping[str, Any]) -> str:
    """Return the error message for a name that belongs to no option."""
    if name in ("backend", "device"):
        return (
            f"unknown option {name!r}; the device is not a morph option; use --device or "
            "--backend of the command line, or the argument backend of clmorph.morph"
        )
    near = get_close_matches(name[:99], list(known), 1)
    few = len(known) <= FEW
    expected = f"expected one of {', '.join(known)}" if few else "clmorph morph --help lists them"
    hint = f"did you mean {near[0]!r}?" if near else expected
    return f"unknown option {shown(name)}; {hint}"


def among(given: Mapping[str, Any], names: Iterable[str]) -> Mapping[str, Any]:
    """Return the given options, after a check that all are among the names."""
    allowed = dict.fromkeys(names)
    for name in given:
        if name not in allowed:
            raise InputError(unknown_option(name, allowed))
    return given


def to_outside(known: Option, value: Any) -> Any:
    """Convert a value to the form of files: a number, a text, a truth value, or a list of them."""
    if isinstance(value, tuple | list):
        return [to_outside(known, part) for part in value]
    if value is None:
        return known.word
    for word, meaning in known.kind.words:
        if value == meaning:
            return word
    scaled = known.scale != 1.0 and as_float(value) is not None
    return float(f"{value / known.scale:.6g}") if scaled else value


def from_outside(known: Option, name: str, value: Any) -> Any:
    """Convert a value of TOML or JSON to the option's value in Python, or raise InputError."""
    if isinstance(value, str) and value == known.word:
        return None
    if isinstance(value, str) and value in dict(known.kind.words):
        return dict(known.kind.words)[value]
    if known.kind.pair and isinstance(value, list) and value:
        return tuple(from_outside(known, name, part) for part in value)
    if not known.kind.scalar(value):
        expected = known.kind.in_files or _expected(known)
        raise InputError(f"{name} = {shown(value)}: expected {expected}")
    return value * known.scale if known.scale != 1.0 else value


def from_line(known: Option, value: str) -> Any:
    """Convert a text of the command line to the option's value, or raise InputError."""
    if known.kind.pair and "," in value:
        return tuple(from_line(known, part) for part in value.split(","))
    if known.word and value == known.word:
        return None
    if value in dict(known.kind.words):
        return dict(known.kind.words)[value]
    try:
        read = known.kind.read(value)
    except InputError:  # it says more, such as which line of a file is wrong
        raise
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{shown(value)}: expected {_expected(known)}") from None
    if isinstance(read, float) and not math.isfinite(read):
        raise InputError(f"{shown(value)}: expected {known.kind.expected}")
    return read * known.scale if known.scale != 1.0 else read


def _expected(known: Option) -> str:
    """Return the description of an option's valid values for error messages."""
    words = [known.word, *dict(known.kind.words)]
    several = ["a list of two of these"] if known.kind.pair else []
    return " or ".join([known.kind.expected, *map(repr, filter(None, words)), *several])


def _described(known: Option, usual: Any) -> dict[str, Any]:
    """Return the JSON Schema of one option, in its unit outside."""
    one = {
        key: value / known.scale if isinstance(value, int | float) else value
        for key, value in known.kind.schema.items()
    }
    words = [{"const": word} for word in (known.word, *dict(known.kind.words)) if word]
    if words:
        one = {"anyOf": [one, *words]}
    if known.kind.pair:
        pair = {"type": "array", "items": one, "minItems": 2, "maxItems": 2}
        one = {"anyOf": [one, pair]}
    one["description"] = known.help + (f" Unit: {known.unit}." if known.unit else "")
    one["default"] = to_outside(known, usual)
    return one
