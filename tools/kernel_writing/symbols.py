"""Symbols that record what formulas do to numbers and vectors."""

from typing import Any, ClassVar

import numpy as np


class Symbol(np.lib.mixins.NDArrayOperatorsMixin):
    """A number or a vector of a kernel.

    Attributes
    ----------
    operation : str
        A function of NumPy, or one of the kinds of inputs and reductions below.
    parts : tuple
        Its operands: symbols and Python's numbers, or the name of an input.
    side : {"", "row", "column"}
        Whose entries a vector has; "" for a number.
    stage : int
        The number of loops that must end before it can be computed.
    """

    __array_priority__ = 100.0
    known: ClassVar[dict[Any, "Symbol"]] = {}

    def __new__(cls, operation: str, *parts: Any, side: str = "", stage: int = 0) -> "Symbol":
        """Return the symbol of this operation, the same one each time."""
        key = operation, tuple(id(x) if isinstance(x, Symbol) else x for x in parts), side
        if key not in cls.known:
            made = cls.known[key] = super().__new__(cls)
            made.operation, made.parts, made.side, made.stage = operation, parts, side, stage
            made.number = len(cls.known)
        return cls.known[key]

    def __bool__(self) -> bool:
        return True  # only rates that are not 0 are symbols

    __hash__ = object.__hash__

    def __array_ufunc__(self, function: Any, method: str, *operands: Any, **_: Any) -> Any:
        assert method == "__call__", (function, method)
        return applied(function.__name__, *operands)

    def __array_function__(self, function: Any, types: Any, operands: Any, _: Any) -> Any:
        assert function is np.where, function
        condition, one, other = operands
        return applied("where", condition, one, other)

    def __and__(self, other: Any) -> "Symbol":
        return applied("and", self, other)


def applied(name: str, *operands: Any) -> Any:
    """Return a function of symbols and numbers."""
    operands = tuple(x if isinstance(x, Symbol) else float(x) for x in operands)
    if not any(isinstance(x, Symbol) for x in operands):
        return float(getattr(np, name)(*operands))
    one, other = operands[0], operands[-1]
    if name == "equal":
        return False  # compared with 0, see `Symbol.__bool__`
    if name == "negative":
        return applied("multiply", -1.0, one)
    if name == "multiply" and 0.0 in (one, other):
        return 0.0
    if name in ("add", "subtract") and isinstance(other, float) and other == 0.0:
        return one
    if name == "add" and isinstance(one, float) and one == 0.0:
        return other
    if name == "multiply" and isinstance(one, float) and one == 1.0:
        return other
    if name == "multiply" and isinstance(other, float) and other == 1.0:
        return one
    symbols = [x for x in operands if isinstance(x, Symbol)]
    sides = {x.side for x in symbols} - {""}
    assert len(sides) <= 1, (name, sides)
    stage = max(x.stage for x in symbols)
    return Symbol(name, *operands, side=sides.pop() if sides else "", stage=stage)


class Traced:
    """The reductions of `clmorph.transport._solver.reductions` over symbols."""

    shape = (1,)  # so that numbers are compared by NumPy's functions

    def __init__(self, side: str) -> None:
        self.side = side

    def sum(self, x: Symbol) -> Symbol:
        """Return the sum of a vector."""
        return Symbol("sum", x, stage=x.stage + 1)

    def inner(self, x: Any, y: Any) -> Symbol:
        """Return the inner product of two vectors."""
        return self.sum(x * y)

    def largest(self, x: Symbol) -> Symbol:
        """Return the largest entry of a vector."""
        return Symbol("largest", x, stage=x.stage + 1)

    def spread(self, value: Any) -> Any:
        """Return the number for each entry."""
        return value

    def scaled(self, factor: Any, x: Any) -> Any:
        """Return the vector times a number."""
        return factor * x

    def inner_each(self, many: str, x: Symbol, stored: Symbol) -> Symbol:
        """Return inner products with many vectors, of which `stored` is the newest."""
        return Symbol("inner_each", many, x, stage=max(x.stage, stored.stage) + 1)

    def combined(self, factors: Symbol, many: str) -> Symbol:
        """Return the sum of many vectors, each multiplied by its factor."""
        return Symbol("combined", factors, many, side=self.side, stage=factors.stage)


def vector(side: str, slot: str) -> Symbol:
    """Return a vector that a buffer holds."""
    return Symbol("vector", slot, side=side)


def number(name: str) -> Symbol:
    """Return a number that the kernel gets."""
    return Symbol("number", name)
