"""Entropic regularization and marginal penalty, each given as a length or in cost units."""

import math
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from clmorph._shared.validation import as_float, shown
from clmorph.errors import InputError
from clmorph.transport.options import LENGTH, AlgorithmOptions, Reach, SolverOptions

#: What is said of arguments in the order of other libraries.
OTHER_ORDER = (
    "blur and reach are lengths, not arrays: weights and points of a measure are one argument, "
    "as in clmorph.sinkhorn((a, x), (b, y), blur=0.05)"
)
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def refuses_other_order(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Refuse arguments (a, x, b, y) with the right call, also where blur is given by name."""

    @wraps(function)
    def call(*given: _Given.args, **named: _Given.kwargs) -> _Result:
        if len(given) > 2 and _has_axes(given[2]):
            raise InputError(OTHER_ORDER)
        return function(*given, **named)

    return call


class Goal(NamedTuple):
    """Checked entropic regularization and marginal penalty, and when a solve ends."""

    blur: float
    reach: Reach  #: a pair only if its halves differ
    rho: tuple[float, float]  #: infinite where balanced
    tol: float
    max_iter: int
    precision: str

    @property
    def epsilon(self) -> float:
        """The square of blur, in cost units."""
        return self.blur**2


def regularization(
    blur: Any = None, reach: Any = None, epsilon: Any = None, rho: Any = None,
    tol: Any = SolverOptions.tol, max_iter: Any = SolverOptions.max_iter, precision: Any = "auto",
) -> Goal:  # fmt: skip
    """Check blur or epsilon = blur^2, and reach or rho = reach^2; None is usual, or balanced."""
    # As other libraries are called; a pair of reaches is no array of measures.
    if _has_axes(blur) or len(getattr(reach, "shape", ())) > 1:
        raise InputError(OTHER_ORDER)
    if epsilon is not None:
        _check_alone("blur", blur, "epsilon", epsilon)
        blur = _root("epsilon", epsilon, _check_blur)
    if rho is not None:
        _check_alone("reach", reach, "rho", rho)
        reach = _each("rho", rho, lambda value: _root("rho", value, _check_reach))
    blur = _check_blur(SolverOptions.blur if blur is None else blur)
    lengths = _each("reach", reach, _check_reach)
    rhos = tuple(np.inf if length is None else length**2 for length in lengths)
    AlgorithmOptions.checked("precision", precision)
    return Goal(
        blur, lengths[0] if lengths[0] == lengths[1] else lengths, (rhos[0], rhos[1]),
        SolverOptions.checked("tol", tol), SolverOptions.checked("max_iter", max_iter), precision,
    )  # fmt: skip


def _check_alone(length: str, value: Any, square: str, given: Any) -> None:
    """Refuse a length beside its square."""
    if value is not None:
        raise InputError(
            f"{length}={shown(value)} and {square}={shown(given)} are two names of one strength "
            f"({square} = {length}^2): give one of them"
        )


def _has_axes(value: Any) -> bool:
    """Return whether a value is an array with axes, or a list of numbers."""
    return bool(getattr(value, "shape", ())) or (isinstance(value, (list, tuple)) and bool(value))


def _check_blur(value: Any) -> float:
    return float(LENGTH.check("blur", value))


def _check_reach(value: Any) -> float | None:
    """Return a checked reach; None or infinity is balanced transport."""
    if value is None or as_float(value) == math.inf:
        return None
    try:
        return float(LENGTH.check("reach", value))
    except InputError as error:
        raise InputError(f"{error}, or None for balanced transport") from None


def _each(name: str, value: Any, function: Any) -> tuple[float | None, float | None]:
    """Apply a function to both halves of a pair, or twice to one value."""
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim):
        pair: Sequence[Any] = list(value)
        if len(pair) != 2:
            raise InputError(
                f"{name}={shown(value)}: expected one number, or a pair for source and target"
            )
        return function(pair[0]), function(pair[1])
    once = function(value)
    return once, once


def _root(name: str, value: Any, check: Any) -> Any:
    """Return the square root of epsilon or rho; errors name the argument of the caller."""
    number = as_float(value)
    if number is None:
        raise InputError(f"{name}={shown(value)}: expected a positive number")
    try:
        return check(number**0.5 if number >= 0 else number)
    except InputError as error:
        expected = "its square root is a length: " + str(error).partition(": ")[2]
        raise InputError(f"{name}={shown(value)}: {expected}") from None
