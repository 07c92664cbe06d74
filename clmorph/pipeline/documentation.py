"""The documentation and the signature of functions that take options by name.

Both follow from the option classes, so that no option is described twice.
"""

import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

from clmorph._shared.options import Option, Options

Function = TypeVar("Function", bound=Callable[..., Any])
#: Placeholder in a docstring that the list of options replaces.
MARK = "    {options}\n"
WIDTH = 96


def documented(
    options: type[Options], only: tuple[str, ...] | None = None, usual: Options | None = None
) -> Callable[[Function], Function]:
    """Return a decorator that adds options (`only` these) to a docstring and a signature."""

    def default_of(each: Any) -> Any:
        return each.default if usual is None else getattr(usual, each.name)

    def decorate(function: Function) -> Function:
        chosen = [
            each for each in fields(options)
            if "option" in each.metadata and (only is None or each.name in only)
        ]  # fmt: skip
        if function.__doc__ and MARK in function.__doc__:
            described = "".join(_described(each, default_of(each)) for each in chosen)
            function.__doc__ = function.__doc__.replace(MARK, described)
        signature = inspect.signature(function)
        known = [
            each for each in signature.parameters.values() if each.kind is not each.VAR_KEYWORD
        ]
        by_name = inspect.Parameter.KEYWORD_ONLY
        known += [
            inspect.Parameter(
                each.name, by_name, default=default_of(each), annotation=annotation(each.type)
            )
            for each in chosen
        ]
        function.__signature__ = signature.replace(parameters=known)  # type: ignore[attr-defined]
        return function

    return decorate


def annotation(kind: Any) -> str:
    """Return the text of a type for the help."""
    text = kind.__name__ if isinstance(kind, type) else str(kind)
    return text.replace("typing.", "").replace("NoneType", "None")


def _described(each: Any, default: Any) -> str:
    """Return an option's entry of a numpydoc list of parameters."""
    known: Option = each.metadata["option"]
    unit = f" Unit: {known.unit if known.scale == 1.0 else 'bytes'}." if known.unit else ""
    first = f"    {each.name} : {annotation(each.type)}, default {default!r}\n"
    words = re.sub(rf"\b{known.word}:", "None:", known.help) if known.word else known.help
    words += unit
    return first + textwrap.indent("\n".join(textwrap.wrap(words, WIDTH - 8)), " " * 8) + "\n"
