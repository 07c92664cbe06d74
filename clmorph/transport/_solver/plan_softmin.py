"""The softmin T(g) of a plan's rows, from which its rows are computed without storing the plan."""

import functools
from typing import Any, NamedTuple

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import MAX_EXPONENT, Operations
from clmorph.backends.records import LastPasses, NearPairs
from clmorph.errors import InputError
from clmorph.measures.grid import are_grids
from clmorph.measures.points import Pair, are_equal, corners_of
from clmorph.transport._solver.grid_softmin import GridSoftmin
from clmorph.transport._solver.problem import largest_cost, upload_both
from clmorph.transport._solver.softmin import Softmin, check_finite
from clmorph.transport.potentials import Potentials, check_potentials

#: Near pairs are chosen before a single pass if the solver visited at most this share of all pairs:
#: to choose them costs a pass over them.
FEW_NEAR = 0.3
#: Share by which the marginal of a plan may differ from the marginal in its potentials, beside
#: rounding and truncation. It is far more than these cause, and far less than the difference that
#: other measures cause.
FOREIGN = 0.01


class Sent(NamedTuple):
    """Where the mass of the rows goes, after one more half-step."""

    potential: Array  #: (N,) f = Delta T(g), cost units
    ratio: Array  #: (N,) mass that leaves each row, relative to its own: exp(-f / rho)
    mean: Array  #: (N, D) mean destinations


class RowsOfPlan:
    """The rows of the plan of potentials, with the truncation that the solver used.

    The clouds are None for `projection` between grids, which needs none.
    """

    def __init__(
        self, operations: Operations, pair: Pair, potentials: Potentials,
        clouds: tuple[Any, Any] | None = None,
    ) -> None:  # fmt: skip
        check_potentials("potentials", potentials, (len(pair[0]), len(pair[1])))
        self.operations, self.pair, self.potentials = operations, pair, potentials
        passes, epsilon = _passes(operations, pair, potentials), potentials.epsilon
        self.clouds = clouds or (passes.clouds if passes else upload_both(operations, *pair))
        of_grids, weights = self.clouds[0] is None, (pair[0].weights, pair[1].weights)
        self.to_rows: Any = (
            GridSoftmin(operations, *pair)  # type: ignore[arg-type]
            if of_grids
            else Softmin(operations, *self.clouds, weights, potentials.truncation)
        )
        if passes is not None and potentials.truncation is not None:
            self.softmin = passes.softmins[0]
            self.to_rows.take_over(passes.near[0], potentials.g, self.softmin, epsilon)
        else:
            self.to_rows.guess = potentials.f * (1.0 + epsilon * inverse_rho(potentials))

    @functools.cached_property
    def softmin(self) -> Array:
        """T(g), (N,), from the solver's last pass or from a new one."""
        return self.to_rows(self.potentials.g, self.potentials.epsilon, self.potentials.precise)

    @property
    def near(self) -> NearPairs | None:
        """The pairs that the softmin has summed; None for all."""
        return self.to_rows.near if self.softmin is not None else None

    @property
    def mass(self) -> Array:
        """The marginal (pi 1)_i = a_i exp((f_i - T(g)_i) / epsilon) (math: plan, Eq. 2)."""
        with np.errstate(divide="ignore", over="ignore"):
            logarithms = np.log(self.pair[0].weights)
            scaled = (self.potentials.f - self.softmin) / self.potentials.epsilon
            return np.exp(scaled + logarithms)

    @property
    def rounding(self) -> float:
        """The largest effect of rounding on the softmin, in nats."""
        largest = largest_cost(corners_of(self.pair[0]), corners_of(self.pair[1]))
        kind = self.potentials.epsilon, self.potentials.precise
        return float(self.to_rows.rounding(largest, *kind))

    def checked(self) -> "RowsOfPlan":
        """Raise an `InputError` if potentials are those of other measures."""
        own = self.potentials
        nats = 4.0 * self.rounding + 2.0 * own.truncation_error + (own.truncation or 0.0)
        check_marginal("potentials", own.row_mass, self.mass, nats)
        return self

    def swapped(self) -> "RowsOfPlan":
        """Return the columns of the plan as rows."""
        swapped = self.potentials.swapped()
        return RowsOfPlan(self.operations, self.pair[::-1], swapped, self.clouds[::-1])

    def projection(self) -> tuple[Array, Array]:
        """Return T(g), (N,), and mean destinations, (N, D), over near pairs if they are few."""
        own, few = self.potentials, self.potentials.visited <= FEW_NEAR
        if self.clouds[0] is None:
            self.softmin, mean = self.to_rows.means(own.g, own.epsilon)
        else:
            near = self.near if own.truncation is not None and few else self.to_rows.near
            softmin, mean = self.operations.barycentric_projection(
                *self.clouds, own.g, own.epsilon, own.precise, near
            )
            self.softmin = check_finite(softmin)
        self.checked()
        return self.softmin, mean

    def sent(self) -> Sent:
        """Return where the mass goes, from the potentials of the columns alone."""
        softmin, mean = self.projection()
        inverse = inverse_rho(self.potentials)
        potential = softmin / (1.0 + self.potentials.epsilon * inverse)
        # r = a exp((f - T(g)) / epsilon) = a exp(-f / rho).
        return Sent(potential, np.exp(np.minimum(-potential * inverse, MAX_EXPONENT)), mean)


def check_marginal(name: str, told: Array, mass: Array, nats: float) -> None:
    """Raise an `InputError` if a plan's marginal (N,) is not that which potentials tell."""
    most = FOREIGN + np.expm1(min(nats, 100.0))
    if not float(np.abs(mass - told).sum()) <= most * max(float(told.sum()), float(mass.sum())):
        raise InputError(
            f"{name} are of other measures: the plan of these has other marginals than they "
            "tell; expected the measures that they were computed for, in the same order"
        )


def _passes(operations: Operations, pair: Pair, potentials: Potentials) -> LastPasses | None:
    """Return what the solve of these measures has left on this backend, if anything."""
    passes, own = potentials.passes, potentials.measures
    if passes is None or own is None or passes.operations is not operations:
        return None
    if passes.potentials[0] is not potentials.f or passes.potentials[1] is not potentials.g:
        return None
    return passes if all(map(are_equal, pair, own)) else None


def uploaded_pair(operations: Operations, pair: Pair) -> tuple[Any, Any]:
    """Return both measures as clouds, for `RowsOfPlan.projection`, which needs none of grids."""
    if are_grids(*pair):
        return None, None
    return upload_both(operations, *pair)


def inverse_rho(potentials: Potentials) -> float:
    """Return 1 / rho of the source; 0 if it is balanced."""
    rho = potentials.rho
    return 1.0 / (rho[0] if isinstance(rho, tuple) else rho)
