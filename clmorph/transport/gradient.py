"""Gradients of transport values and divergences in closed form, without storing a plan.

At the optimum of the dual (math: dual), the derivative of the value is the partial derivative of
the dual with fixed potentials (the envelope theorem). With C_ij = |x_i - y_j|^2 / 2,

    d OT / d x_i = sum_j pi_ij (x_i - y_j) = r_i (x_i - T(x_i)),
    d OT / d a_i = rho + epsilon m_b - (rho + epsilon) exp(-f_i / rho),

where r = pi 1, T(x_i) is the mean destination of x_i, and m_b is the mass of b. For a balanced
side the second line is f_i - epsilon + epsilon m_b. The formulas of the target are the same with
source and target exchanged. The gradient of the divergence is that of the value minus that of the
self-transport, which depends on its measure twice; what does not depend on i cancels:

    d S / d a_i = (rho + epsilon) (exp(-f^aa_i / rho) - exp(-f_i / rho)).

Source: Séjourné, Feydy, Vialard, Trouvé, Peyré, "Sinkhorn divergences for unbalanced optimal
transport" (2019), section 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import MAX_EXPONENT, Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.errors import InputError
from clmorph.measures.measure import Measure
from clmorph.measures.points import MeasureLike, Pair, as_pair
from clmorph.transport._solver.plan_softmin import RowsOfPlan, Sent, inverse_rho, uploaded_pair
from clmorph.transport.potentials import Potentials


@dataclass(frozen=True, repr=False, eq=False)
class Gradient:
    """Derivatives of a transport value or of a divergence.

    Attributes
    ----------
    source_points, target_points : (N, D) and (M, D) arrays
        Derivatives by the points; cost units times mass over the points' unit. For a lifted image
        they are those by its lifted points, `Measure.points`.
    source_weights, target_weights : (N,) and (M,) arrays
        Derivatives by the weights, in cost units. They are defined for points without mass too. If
        both sides are balanced, masses must stay equal, which leaves a constant undetermined on
        each side: the arrays then have the mean 0, so that a step along them keeps the mass.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source, target = (np.ones(1), np.zeros((1, 1))), (np.ones(1), np.ones((1, 1)))
    >>> potentials = clmorph.sinkhorn(source, target, blur=0.1, backend="numpy")
    >>> clmorph.gradient(source, target, potentials, backend="numpy")
    <Gradient by 1 and 1 points in 1D, largest component 1>
    """

    source_points: Array
    source_weights: Array
    target_points: Array
    target_weights: Array

    def __repr__(self) -> str:
        sizes = f"{len(self.source_weights)} and {len(self.target_weights)}"
        largest = max(np.abs(self.source_points).max(), np.abs(self.target_points).max())
        dimension = self.source_points.shape[1]
        return f"<Gradient by {sizes} points in {dimension}D, largest component {largest:.3g}>"


def gradient(
    source: MeasureLike, target: MeasureLike, potentials: Potentials, *, backend: Backend = "auto"
) -> Gradient:
    """Return the derivatives of the optimal transport value by points and weights of both sides.

    They follow from the potentials in closed form. For each side one pass over all pairs gives one
    more half-step of its potential and the mean destinations; no plan is stored. The error
    of the derivatives is of the size of the residual of the potentials, with the rounding of the
    backend beside it: a derivative by a point is r_i (x_i - T(x_i)), and T(x_i) is rounded in
    float32 relative to the spread of the destinations around x_i. Where a gradient is much smaller
    than row mass times this spread times 1e-6, little of it is left.

    Parameters
    ----------
    source, target : Measure, WeightedPoints, or (weights (N,), points (N, D))
        The measures of the potentials.
    potentials : Potentials
        Potentials of `clmorph.sinkhorn`, best with a `tol` of 1e-6. Two different reaches are
        allowed.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.

    Returns
    -------
    Gradient

    Raises
    ------
    InputError
        If an argument cannot be used, or the cost has a metric for each source pixel.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source = np.full(3, 1 / 3), np.array([0.0, 0.5, 1.0])
    >>> target = np.full(2, 1 / 2), np.array([0.25, 0.75])
    >>> solved = clmorph.sinkhorn(source, target, 0.1, 0.3, tol=1e-6, backend="numpy")
    >>> found = clmorph.gradient(source, target, solved, backend="numpy")
    >>> (found.source_points.round(4) + 0.0).tolist()  # a descent moves the outer points inwards
    [[-0.0674], [0.0], [0.0674]]
    >>> found.target_weights.round(4).tolist()
    [0.0172, 0.0172]
    """
    pair = as_pair(source, target)
    if isinstance(source, Measure) and source.has_metric_map:
        raise InputError(
            "the cost has a metric for each source pixel, so it has no gradient by lifted points: "
            "use one metric for all pixels"
        )
    operations = get_backend(backend)
    rows = RowsOfPlan(operations, pair, potentials, uploaded_pair(operations, pair))
    sides = []
    for own, other in ((rows, pair[1]), (rows.swapped(), pair[0])):
        going, constant = own.sent(), potentials.epsilon * (float(other.weights.sum()) - 1.0)
        sides.append((_by_points(own, going), _by_weights(own, going.potential) + constant))
    return joined_sides(sides, potentials)


def divergence_gradient(
    pair: Pair, cross: Potentials, selves: tuple[Potentials, Potentials], operations: Operations
) -> Gradient:
    """Return the derivatives of the divergence of two measures, given its three solves."""
    sides = []
    both = RowsOfPlan(operations, pair, cross, uploaded_pair(operations, pair))
    # Swapped too, so that equal measures have derivatives that cancel to the bit.
    for rows, own in ((both, selves[0]), (both.swapped(), selves[1].swapped())):
        twice = RowsOfPlan(operations, (rows.pair[0],) * 2, own, (rows.clouds[0],) * 2)
        between, within = rows.sent(), twice.sent()
        points = _by_points(rows, between) - _by_points(twice, within)
        sides.append((points, _by_weights(rows, between.potential, within.potential)))
    return joined_sides(sides, cross)


def _by_points(rows: RowsOfPlan, going: Sent) -> Array:
    """Return the derivatives by the source's points, (N, D)."""
    mass = rows.pair[0].weights * going.ratio
    return np.asarray(mass[:, None] * (rows.pair[0].points - going.mean))


def _by_weights(rows: RowsOfPlan, potential: Array, less: Any = 0.0) -> Array:
    """Return (rho + epsilon) (1 - exp(-f / rho)), f if balanced, less that of a potential.

    The difference has no cancellation at large rho.
    """
    change, inverse = potential - less, inverse_rho(rows.potentials)
    if not inverse:
        return change
    scaled = np.minimum(-less * inverse, MAX_EXPONENT)
    fall = np.expm1(np.minimum(-change * inverse, MAX_EXPONENT))
    # d OT / d a without the constant epsilon (m_b - 1)
    return np.asarray(-(1.0 / inverse + rows.potentials.epsilon) * np.exp(scaled) * fall)


def joined_sides(sides: Sequence[tuple[Array, Array]], potentials: Potentials) -> Gradient:
    """Return a gradient; if both sides are balanced, its derivatives by weights have the mean 0."""
    if np.all(np.isinf(potentials.rho)):
        sides = [(points, weights - weights.mean()) for points, weights in sides]
    return Gradient(*sides[0], *sides[1])
