"""The softmin T(g) of a plan's rows, from which its rows are computed without storing the plan."""

from typing import Any, NamedTuple, cast

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import MAX_EXPONENT, Operations
from clmorph.backends.records import LastPasses
from clmorph.backends.select import Backend, get_backend
from clmorph.measures.grid import Grid, are_grids
from clmorph.measures.points import AnyMeasure, corners_of
from clmorph.transport._solver.grid_softmin import GridSoftmin
from clmorph.transport._solver.problem import largest_cost, upload_both
from clmorph.transport._solver.softmin import Softmin, check_finite
from clmorph.transport.potentials import Potentials, check_origin, check_potentials

#: Near pairs are chosen before a single pass if the solver visited at most this share of all pairs:
#: to choose them costs a pass over them.
FEW_NEAR = 0.3


class OfRows(NamedTuple):
    """The operator of a plan's rows, and the softmin T(g) of the potentials, if it is known."""

    operator: Softmin
    known: Array | None

    def softmin(self, potentials: Potentials) -> Array:
        """Return T(g), (N,), from the solver's last pass or from a new one."""
        if self.known is not None:
            return self.known
        return self.operator(potentials.g, potentials.epsilon, potentials.precise)


def plan_softmin(
    operations: Operations,
    clouds: tuple[Any, Any],
    pair: tuple[AnyMeasure, AnyMeasure],
    potentials: Potentials,
) -> OfRows:
    """Return the softmin T(g) of a plan's rows, with the truncation that the solver used."""
    weights = pair[0].weights, pair[1].weights
    result = Softmin(operations, *clouds, weights, potentials.truncation)
    passes = _passes(operations, pair, potentials)
    if passes is not None and potentials.truncation is not None:
        known = passes.softmins[0]
        result.take_over(passes.near[0], potentials.g, known, potentials.epsilon)
        return OfRows(result, known)
    result.guess = potentials.f * (1.0 + potentials.epsilon * inverse_rho(potentials))
    return OfRows(result, None)


def _passes(
    operations: Operations, pair: tuple[AnyMeasure, AnyMeasure], potentials: Potentials
) -> LastPasses | None:
    """Return what the solve of these measures has left on this backend, if anything."""
    passes, own = potentials.passes, potentials.measures
    if passes is None or own is None or passes.operations is not operations:
        return None
    if passes.potentials[0] is not potentials.f or passes.potentials[1] is not potentials.g:
        return None
    names = "weights", "points", "offsets"
    same = all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for one, other in zip(pair, own, strict=True)
        for name in names
    )
    return passes if same else None


def clouds_of(
    operations: Operations, pair: tuple[AnyMeasure, AnyMeasure], potentials: Potentials
) -> tuple[Any, Any]:
    """Return both measures in the backend's memory, where a large solve may have left them."""
    passes = _passes(operations, pair, potentials)
    if passes is not None:
        return passes.clouds
    return upload_both(operations, *pair)


def row_softmin(
    source: AnyMeasure, target: AnyMeasure, potentials: Potentials, backend: Backend
) -> tuple[Operations, tuple[Any, Any], Softmin, Array]:
    """Return a backend, both clouds, T of a plan's rows, and T(g), (N,), of checked potentials."""
    check_potentials("potentials", potentials, (len(source), len(target)))
    operations = get_backend(backend)
    clouds = clouds_of(operations, (source, target), potentials)
    of_rows = plan_softmin(operations, clouds, (source, target), potentials)
    to_rows, softmin = of_rows.operator, of_rows.softmin(potentials)
    _check_rows(source, target, potentials, to_rows, softmin)
    return operations, clouds, to_rows, softmin


def uploaded_pair(operations: Operations, pair: tuple[AnyMeasure, AnyMeasure]) -> tuple[Any, Any]:
    """Return both measures as clouds, for `row_projection`, which needs none of grids."""
    if are_grids(*pair):
        return None, None
    return upload_both(operations, *pair)


class Sent(NamedTuple):
    """Where the mass of the rows goes, after one more half-step."""

    potential: Array  #: (N,) f = Delta T(g), cost units
    ratio: Array  #: (N,) mass that leaves each row, relative to its own: exp(-f / rho)
    mean: Array  #: (N, D) mean destinations


def sent(
    operations: Operations,
    clouds: tuple[Any, Any],
    pair: tuple[AnyMeasure, AnyMeasure],
    potentials: Potentials,
) -> Sent:
    """Return where the mass of a plan's rows goes, from the potentials of the columns alone."""
    softmin, mean = row_projection(operations, clouds, pair, potentials)
    inverse = inverse_rho(potentials)
    potential = softmin / (1.0 + potentials.epsilon * inverse)
    # r = a exp((f - T(g)) / epsilon) = a exp(-f / rho).
    return Sent(potential, np.exp(np.minimum(-potential * inverse, MAX_EXPONENT)), mean)


def inverse_rho(potentials: Potentials) -> float:
    """Return 1 / rho of the source; 0 if it is balanced."""
    rho = potentials.rho
    return 1.0 / (rho[0] if isinstance(rho, tuple) else rho)


def row_projection(
    operations: Operations,
    clouds: tuple[Any, Any],
    pair: tuple[AnyMeasure, AnyMeasure],
    potentials: Potentials,
) -> tuple[Array, Array]:
    """Return T(g), (N,), and mean destinations, (N, D), over near pairs if they are few."""
    check_potentials("potentials", potentials, (len(pair[0]), len(pair[1])))
    if are_grids(*pair):
        of_grids: Any = GridSoftmin(operations, cast(Grid, pair[0]), cast(Grid, pair[1]))
        softmin, mean = of_grids.means(potentials.g, potentials.epsilon)
        _check_rows(*pair, potentials, of_grids, softmin)
        return softmin, mean
    to_rows, known = plan_softmin(operations, clouds, pair, potentials)
    g, epsilon, precise = potentials.g, potentials.epsilon, potentials.precise
    few = potentials.truncation is not None and potentials.visited <= FEW_NEAR
    if few and known is None:
        to_rows(g, epsilon, precise)
    rows, columns = clouds
    softmin, mean = operations.barycentric_projection(
        rows, columns, g, epsilon, precise, to_rows.near
    )
    check_finite(softmin)
    _check_rows(*pair, potentials, to_rows, softmin)
    return softmin, mean


def _check_rows(
    source: AnyMeasure, target: AnyMeasure, potentials: Potentials, to_rows: Softmin, softmin: Array
) -> None:
    """Raise an `InputError` if potentials are those of other measures."""
    rounding = rounding_of(to_rows, source, target, potentials)
    check_origin(potentials, row_mass(source.weights, potentials, softmin), rounding)


def rounding_of(
    to_rows: Softmin, source: AnyMeasure, target: AnyMeasure, potentials: Potentials
) -> float:
    """Return the largest effect of rounding on the softmin of a plan's rows, in nats."""
    largest = largest_cost(corners_of(source), corners_of(target))
    return float(to_rows.rounding(largest, potentials.epsilon, potentials.precise))


def row_mass(weights: Array, potentials: Potentials, softmin: Array) -> Array:
    """Return the marginal (pi 1)_i = a_i exp((f_i - T(g)_i) / epsilon) (math: plan, Eq. 2)."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.exp((potentials.f - softmin) / potentials.epsilon + np.log(weights))
