"""The steps of an iteration: softmins with the arithmetic between them, on host or device.

`HostSteps` and `DeviceSteps` have the same methods, and the same formulas, those of
`_solver.half_steps`. The device computes an iteration ahead of the host's decisions, so that both
meet once: where the host then takes back an extrapolation, one softmin was in vain.
"""

from typing import NamedTuple

from clmorph._shared.typing import Array
from clmorph.backends.interface import MEMORY, ResidentIteration
from clmorph.transport._solver.anderson import GROWTH, SHRINKAGE, TRUST_RADIUS, Anderson
from clmorph.transport._solver.half_steps import (
    ColumnStep,
    RowStep,
    column_step,
    row_step,
    without_drift,
)
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.softmin import overflow
from clmorph.transport._solver.state import dual_rounding


class Reached(NamedTuple):
    """Potentials after the last half-step of a level; their residual is not measured yet."""

    f: Array
    g: Array
    t_columns: Array
    residual: float  # before that half-step
    precise: bool


class HostSteps:
    """Steps whose arithmetic NumPy does.

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._memory = problem, Anderson()

    def begin(self, g: Array, epsilon: float, precise: bool) -> None:
        """Set the potential g, (M,), at which the next iteration begins."""
        self._g, self._epsilon, self._precise = g, epsilon, precise
        self._fallback = g
        self._enough = dual_rounding(self._problem, epsilon, precise)

    def update_rows(self) -> None:
        """Update f and the shift of g."""
        problem = self._problem
        softmin = problem.softmin_rows(self._g, self._epsilon, self._precise)
        self._rows: RowStep = row_step(problem, self._g, softmin, self._epsilon, self._enough)

    @property
    def row_dual(self) -> tuple[float, float]:
        """The mass of the plan, and the dual, after `update_rows`."""
        return self._rows.mass, self._rows.dual

    def take_back(self) -> None:
        """Drop the extrapolation, and begin the next iteration at the image before."""
        self._g = self._fallback
        self._memory.rejected()

    def accept(self) -> None:
        """Keep the extrapolation, whose dual is good."""
        self._memory.accepted()

    def update_columns(self) -> float:
        """Update g and the shift of f, and return the residual before."""
        problem = self._problem
        softmin = problem.softmin_columns(self._rows.f, self._epsilon, self._precise)
        self._columns: ColumnStep = column_step(
            problem, self._rows, softmin, self._epsilon, self._enough
        )
        return float(self._columns.residual)

    def outside_trust_region(self) -> bool:
        """Return whether f is outside the region where the problem is valid."""
        return self._problem.outside_trust_region(self._columns.f, self._epsilon)

    @property
    def column_dual(self) -> float:
        """The dual after `update_columns`."""
        return float(self._columns.dual)

    def go_on(self, extrapolate: bool) -> bool:
        """Choose the next potential, and return whether it is an extrapolation."""
        image, extrapolated = self._columns.image, False
        following = image
        if extrapolate:
            mass = self._columns.mass
            following, extrapolated = self._memory.extrapolate(self._g, image, mass)
            if extrapolated:
                following = without_drift(self._problem, following, image, mass)
        self._g, self._fallback = following, image
        return bool(extrapolated)

    def reached(self, residual: float) -> Reached:
        """Return the potentials after `update_columns`."""
        columns = self._columns
        return Reached(columns.f, columns.image, columns.t_columns, residual, self._precise)


class DeviceSteps:
    """Steps whose arithmetic the device does; the host reads a few numbers.

    Parameters
    ----------
    problem : Problem
    iteration : ResidentIteration
    """

    def __init__(self, problem: Problem, iteration: ResidentIteration) -> None:
        self._problem, self._iteration = problem, iteration
        # The state of `Anderson`, whose vectors are on the device.
        self._radius, self._was_cut = TRUST_RADIUS, False
        self._begun, self._next = False, 0

    def begin(self, g: Array, epsilon: float, precise: bool) -> None:
        """Set the potential g, (M,), at which the next iteration begins."""
        self._epsilon, self._precise, self._guessed = epsilon, precise, False
        self._iteration.set_potential(g, epsilon, precise)

    def update_rows(self) -> None:
        """Run an iteration, as if its potential were good."""
        radius = self._radius
        if self._guessed and self._was_cut:
            radius *= GROWTH
        count = min(self._next + 1, MEMORY) if self._begun else 0
        place = self._next % MEMORY if self._begun else 0
        self._numbers = self._iteration.iterate(self._begun, place, count, radius)
        if not self._numbers.finite:
            raise overflow("points")
        self._problem.n_softmin += 1

    @property
    def row_dual(self) -> tuple[float, float]:
        """The mass of the plan, and the dual, after `update_rows`."""
        return self._numbers.mass, self._numbers.row_dual

    def take_back(self) -> None:
        """Drop the extrapolation, and begin the next iteration at the image before."""
        self._iteration.go_back()
        self._problem.n_softmin += 1
        self._radius = max(1.0, SHRINKAGE * self._radius)
        self._begun, self._next, self._guessed, self._was_cut = False, 0, False, False

    def accept(self) -> None:
        """Keep the extrapolation, whose dual is good."""
        if self._was_cut:
            self._radius *= GROWTH

    def update_columns(self) -> float:
        """Return the residual before g was updated."""
        self._problem.n_softmin += 1
        return self._numbers.residual

    def outside_trust_region(self) -> bool:
        """Return whether f is outside the region where the problem is valid."""
        return self._numbers.moved > self._problem.trust_radius * self._epsilon

    @property
    def column_dual(self) -> float:
        """The dual after g was updated."""
        return self._numbers.column_dual

    def go_on(self, extrapolate: bool) -> bool:
        """Choose the next potential, and return whether it is an extrapolation."""
        self._guessed = extrapolate and self._numbers.extrapolated
        self._iteration.go_on(self._guessed)
        if extrapolate:
            self._next += self._begun
            self._begun = True
            self._was_cut = self._numbers.cut
        return self._guessed

    def reached(self, residual: float) -> Reached:
        """Return the potentials after the last iteration."""
        return Reached(*self._iteration.potentials(), residual, self._precise)


Steps = HostSteps | DeviceSteps


def new_steps(problem: Problem) -> Steps:
    """Return steps with an empty memory, on the device where it has them for this problem."""
    iteration = problem.start_iteration()
    return HostSteps(problem) if iteration is None else DeviceSteps(problem, iteration)
