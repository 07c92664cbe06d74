"""The steps of an iteration: softmins with the arithmetic between them, on host or device.

The device computes an iteration ahead of the host's decisions, so that both meet once: where the
host then takes back an extrapolation, one softmin was in vain.
"""

from typing import Any, Protocol

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.backends.interface import MEMORY
from clmorph.backends.records import (
    IMAGE,
    PARITY,
    START,
    ResidentIteration,
    control_of,
    next_source,
)
from clmorph.transport._solver.anderson import GROWTH, Anderson, Ring
from clmorph.transport._solver.batch import NotFiniteError, some
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.softmin import overflow


class Steps(Protocol):
    """The steps of one problem, or of many, whose numbers then are arrays of shape (k,).

    ahead: softmins of an iteration that are in vain if its extrapolation is taken back.
    """

    ahead: int

    def begin(self, g: Array, epsilon: float, precise: bool) -> None:
        """Set the potential g, (M,), at which the next iteration begins."""

    def update_rows(self) -> tuple[Any, Any]:
        """Update f and the shift of g, and return the mass of the plan and the dual."""

    def take_back(self, which: Any = True) -> None:
        """Drop the extrapolations of some problems, which go on at the images before."""

    def accept(self, which: Any = True) -> None:
        """Keep the extrapolations of some problems, whose duals are good."""

    def update_columns(self) -> tuple[Any, Any, Any]:
        """Update g and the shift of f, and return the residual before, the dual, and f's move.

        That is how far f is from the center of the trust region.
        """

    def go_on(self, extrapolate: Any) -> Any:
        """Choose the next potentials, and return for which problems they are extrapolations."""

    def potentials(self) -> tuple[Array, Array, Array]:
        """Return f, the image of g, and T(f) after `update_columns`."""

    def keep(self, problems: IntArray) -> Problem:
        """Go on with some of many problems, and return them."""


class HostSteps:
    """Steps whose arithmetic NumPy does, as ``half_steps.cl`` and ``sparse_half_steps.cl`` do."""

    ahead = 0

    def __init__(self, problem: Problem) -> None:
        self._problem, self._memory = problem, Anderson(problem.of_columns)
        self.accept = self._memory.ring.accepted

    def begin(self, g: Array, epsilon: float, precise: bool) -> None:
        self._g, self._epsilon, self._precise = g, epsilon, precise
        self._fallback = g
        self._enough = self._problem.dual_rounding(epsilon, precise)

    def update_rows(self) -> tuple[Any, Any]:
        problem, epsilon, self._back = self._problem, self._epsilon, np.False_
        softmin = problem.softmin(0, self._g, epsilon, self._precise)
        own = self._rows = problem.half_step(0, self._g, softmin, epsilon)
        return own.mass, problem.dual(own.new, own.old, own.mass, epsilon, self._enough)

    def take_back(self, which: Any = np.True_) -> None:
        self._g, self._back = self._chosen(which, self._fallback, self._g), which
        self._memory.rejected(which)

    def update_columns(self) -> tuple[Any, Any, Any]:
        problem, rows, epsilon = self._problem, self._rows, self._epsilon
        softmin = problem.softmin(1, rows.new, epsilon, self._precise)
        own = self._columns = problem.half_step(1, rows.new, softmin, epsilon, rows.log_mass)
        residual = problem.residual(rows.new, rows.old, rows.softmin, softmin, epsilon)
        dual = problem.dual(own.old, own.new, own.mass, epsilon, self._enough)
        return residual, dual, problem.farthest(own.old)

    def go_on(self, extrapolate: Any) -> Any:
        problem, own = self._problem, self._columns
        image, extrapolated = own.new, np.logical_and(extrapolate, False)
        following = image
        if np.any(extrapolate):
            mass = problem.marginal(1, image, own.softmin, self._epsilon)
            following, extrapolated = self._memory.extrapolate(self._g, image, mass, extrapolate)
            if extrapolated.any():
                following = without_drift(problem, following, image, mass)
        self._g, self._fallback = self._chosen(self._back, self._g, following), image
        return extrapolated if problem.of_rows.shape else bool(extrapolated)

    def potentials(self) -> tuple[Array, Array, Array]:
        return self._columns.old, self._columns.new, self._columns.softmin

    def keep(self, problems: IntArray) -> Problem:
        of, self._problem = self._problem.of_columns, some(self._problem, problems)
        points = of.points_of(problems)
        self._memory.take(problems, points, self._problem.of_columns)
        self._g, self._fallback = self._g[points], self._fallback[points]
        self._enough = self._enough[problems]
        return self._problem

    def _chosen(self, which: Any, one: Array, other: Array) -> Array:
        """Return potentials g of one kind for some problems, and of the other for the others."""
        return (
            np.where(self._problem.of_columns.spread(which), one, other) if np.any(which) else other
        )


def without_drift(problem: Problem, guess: Any, image: Any, column_mass: Any) -> Any:
    """Return extrapolated potentials, (M,), without the constant that they have added to the image.

    Nothing bounds an extrapolation along a constant, of which balanced potentials are free, and
    at a large one float64 loses the other digits.
    """
    if any(problem.inverse_rho):
        return guess
    of = problem.of_columns
    return guess - of.spread(of.inner(column_mass, guess - image) / of.sum(column_mass))


class DeviceSteps:
    """Steps whose arithmetic the device does; the host has the state of `Anderson`, see `Steps`."""

    ahead = 1

    def __init__(self, problem: Problem, iteration: ResidentIteration) -> None:
        self._problem, self._iteration, self._whole = problem, iteration, problem.reductions
        of: Any = problem.of_rows
        self._ring, self._back = Ring(of), of.filled(False)
        self.accept = self._ring.accepted
        self._here = of.numbers(of.filled(True))

    def begin(self, g: Array, epsilon: float, precise: bool) -> None:
        of: Any = self._problem.of_rows
        self._source, self._guessed = of.filled(START), of.filled(False)
        self._iteration.set_potential(g, epsilon, precise)

    def update_rows(self) -> tuple[Any, Any]:
        """Run an iteration, as if its potential were good."""
        of: Any = self._problem.of_rows
        ring, begun = self._ring, self._ring.begun
        self._back = of.filled(False)
        radius = of.choose(self._guessed & ring.was_cut, GROWTH * ring.radius, ring.radius)
        place = of.choose(begun, ring.stored % MEMORY, 0)
        count = of.choose(begun, of.smaller(ring.stored + 1, MEMORY), 0)
        control = control_of(self._source, begun, place, count)
        self._numbers = self._iteration.iterate(control, radius)
        if of.any(of.without(of.filled(True), self._numbers.finite)):
            if not of.shape:
                raise overflow("points")
            numbers = self._problem.to_rows.numbers
            raise NotFiniteError(int(numbers[np.argmin(self._numbers.finite)]))
        return self._numbers.mass, self._numbers.row_dual

    def take_back(self, which: Any = np.True_) -> None:
        of: Any = self._problem.of_rows
        self._back = which
        self._source = of.choose(which, IMAGE | self._source & PARITY, self._source)
        self._ring.rejected(which)
        self._guessed = of.without(self._guessed, which)

    def update_columns(self) -> tuple[Any, Any, Any]:
        """Return what `update_rows` has computed already."""
        return self._numbers.residual, self._numbers.column_dual, self._numbers.moved

    def go_on(self, extrapolate: Any) -> Any:
        of: Any = self._problem.of_rows
        numbers = self._numbers
        extrapolate = of.without(extrapolate, self._back)
        self._guessed = extrapolate & numbers.extrapolated
        following = next_source(self._source, self._guessed)
        self._source = of.choose(self._back, self._source, following)
        self._ring.add(extrapolate)
        self._ring.was_cut = of.choose(extrapolate, numbers.cut, self._ring.was_cut)
        return self._guessed

    def potentials(self) -> tuple[Array, Array, Array]:
        f, images, t_columns = self._iteration.potentials()
        rows, columns = (of.points_of(self._here) for of in self._whole)
        second: Any = self._problem.of_columns.spread(self._source & PARITY) > 0
        image = np.where(second, images[1, columns], images[0, columns])
        return f[rows], image, t_columns[columns]

    def keep(self, problems: IntArray) -> Problem:
        self._problem = some(self._problem, problems, uploaded=False)
        self._ring.take(problems, self._problem.of_rows)
        self._here, self._guessed, self._back, self._source = (
            values[problems] for values in (self._here, self._guessed, self._back, self._source)
        )
        self._iteration.keep(self._here)
        return self._problem


def new_steps(problem: Problem) -> Steps:
    """Return steps with an empty memory, on the device where it has them for this problem."""
    iteration = problem.start_iteration()
    return HostSteps(problem) if iteration is None else DeviceSteps(problem, iteration)
