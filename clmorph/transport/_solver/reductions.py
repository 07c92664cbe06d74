"""Sums and maxima over the points of one problem, or of each of many (`Segments`)."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array, BoolArray, IntArray

#: The numbers of the only problem, and of none.
ONLY, NONE = np.zeros(1, int), np.zeros(0, int)


class Reductions:
    """Reductions over the vectors of one problem."""

    #: Shape of the reductions' results.
    shape: tuple[int, ...] = ()

    def sum(self, x: Array) -> Any:
        """Return the sum of a vector."""
        return self._each_of(lambda part: part.sum(axis=-1), x)

    def inner(self, x: Array, y: Array) -> Any:
        """Return the inner product of two vectors, in this thread.

        A BLAS that uses several threads lets them spin for a while afterwards, on the cores that
        the next kernel of a CPU device needs; this made solves a quarter slower.
        """
        return self._each_of(functools.partial(np.einsum, "...n,...n->..."), x, y)

    def inner_each(self, many: Array, x: Array) -> Array:
        """Return the inner products of (k, n) vectors with one vector: (k,) array."""
        return np.asarray(self._each_of(functools.partial(np.einsum, "k...n,...n->...k"), many, x))

    def _each_of(self, reduce: Callable[..., Any], *vectors: Array) -> Any:
        """Return what a function of parts (..., n) gives for each problem."""
        return reduce(*vectors)

    def largest(self, x: Array) -> Any:
        """Return the largest entry of a vector."""
        return float(x.max())

    # What a loop does with the numbers of one problem takes a tenth of the time without NumPy: one
    # number for each problem, the larger and the smaller one of two, the largest of all problems,
    # a number for each point, and whether something is true of any problem.
    larger: Any = staticmethod(max)
    smaller: Any = staticmethod(min)
    any: Any = staticmethod(bool)

    def filled(self, value: Any) -> Any:
        """Return the only number of its kind."""
        return value

    largest_of: Any = filled
    spread: Any = filled

    def numbers(self, which: Any) -> Any:
        """Return the numbers of the problems of which this is true."""
        return ONLY if which else NONE

    def without(self, which: Any, others: Any) -> Any:
        """Return whether the first is true of a problem, and the second is not."""
        return bool(which and not others)

    def choose(self, which: Any, one: Any, other: Any) -> Any:
        """Return a number where this is true of a problem, and another one elsewhere."""
        return one if which else other

    def combined(self, factors: Array, many: Array) -> Array:
        """Return the sum of (k, n) vectors, each multiplied by one of the (k,) factors."""
        return np.asarray(np.einsum("k,kn->n", factors, many))

    def points_of(self, problems: IntArray) -> Any:
        """Return the indices of all points, or of none if no problem is given."""
        return slice(None if len(problems) else 0)

    def some(self, problems: IntArray) -> "Reductions":
        """Return the reductions of the problem."""
        return self

    def part(self, x: AnyArray, problem: int) -> AnyArray:
        """Return the entries of the problem."""
        return x


class Segments(Reductions):
    """Those over vectors of many problems, one after the other: (B,) and (B, k) arrays."""

    def __init__(self, counts: IntArray) -> None:
        self.counts = counts
        self.shape: tuple[int, ...] = (len(counts),)
        ends = np.cumsum(counts)
        self.starts = ends - counts
        #: The number of points of every problem, if it is the same for all and not 1; else 0.
        self._each = int(counts[0]) if len(counts) and np.all(counts == max(counts[0], 2)) else 0

    def filled(self, value: Any) -> AnyArray:
        return np.full(self.shape, value)

    def without(self, which: BoolArray, others: BoolArray) -> BoolArray:
        return which & ~others

    def choose(self, which: Any, one: Any, other: Any) -> AnyArray:
        return np.where(which, one, other)

    def numbers(self, which: Any) -> IntArray:
        return np.flatnonzero(which)

    any, largest_of = staticmethod(np.any), staticmethod(np.max)
    larger, smaller = staticmethod(np.maximum), staticmethod(np.minimum)

    def largest(self, x: Array) -> Array:
        return np.asarray(np.maximum.reduceat(x, self.starts))

    def spread(self, value: Any) -> Any:
        return value if np.ndim(value) == 0 else np.repeat(value, self.counts)

    def combined(self, factors: Array, many: Array) -> Array:
        if self._each:
            parts = many.reshape(len(many), -1, self._each)
            return np.einsum("bk,kbn->bn", factors, parts).ravel()
        both = zip(factors, self._parts(many), strict=True)
        return np.concatenate([np.einsum("k,kn->n", *parts) for parts in both])

    def points_of(self, problems: IntArray) -> IntArray:
        counts = self.counts[problems]
        ends = np.cumsum(counts)
        total = int(ends[-1]) if len(ends) else 0
        return np.arange(total) + np.repeat(self.starts[problems] - (ends - counts), counts)

    def some(self, problems: IntArray) -> "Segments":
        return Segments(self.counts[problems])

    def _each_of(self, reduce: Callable[..., Any], *vectors: Array) -> Array:
        if self._each:
            shaped = (x.reshape(*x.shape[:-1], -1, self._each) for x in vectors)
            return np.asarray(reduce(*shaped))
        return np.array([reduce(*parts) for parts in zip(*map(self._parts, vectors), strict=True)])

    def _parts(self, x: AnyArray) -> list[AnyArray]:
        """Return copies of the parts (..., n), whose sums then have the bits of one problem."""
        ends = np.cumsum(self.counts).tolist()
        return [x[..., a:b].copy() for a, b in zip([0, *ends], ends, strict=False)]

    def part(self, x: AnyArray, problem: int) -> AnyArray:
        start = self.starts[problem]
        return x[start : start + self.counts[problem]]


#: The reductions of one problem.
WHOLE = Reductions()


def log_sum_exp(of: Reductions, values: Array) -> Any:
    """Return the logarithm of the sum of exponentials over each problem."""
    largest = of.largest(values)
    return largest + np.log(of.sum(np.exp(values - of.spread(largest))))


def largest_size(of: Reductions, values: Array, counted: BoolArray) -> Any:
    """Return the largest absolute value over each problem, of the counted points alone."""
    return of.largest(np.where(counted, np.abs(values), 0.0))
