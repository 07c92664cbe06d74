"""Numbers that no cost less price is below, by weak duality, with proven rounding."""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.measures.points import WeightedPoints
from clmorph.transport._solver.softmin import Softmin

#: Nats by which pairs left out may lower the logarithm of a sum; what they lower is subtracted.
TRUNCATION = 1e-2


def lower_transform(
    source: WeightedPoints,
    target: WeightedPoints,
    g: Array,
    epsilon: float,
    operations: Operations,
    guess: Array | None = None,
) -> Array:
    """Return f_i <= min_j (C_ij - g_j), which with any potentials g bounds all assignments.

    With masses b_j, the soft minimum T(g)_i = -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)
    exceeds that minimum by at most -epsilon log min b, so f = T(g) + epsilon log min b. Proven
    bounds of the rounding on the device and of the pairs left out are subtracted.

    Parameters
    ----------
    source, target : WeightedPoints
    g : (M,) array
        Potentials of the targets, in cost units.
    epsilon : float
        In cost units.
    operations : Operations
    guess : (N,) array, optional
        An estimate of T(g), which saves one sum over all pairs.

    Returns
    -------
    (N,) array

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> source, target = (
    ...     clmorph.WeightedPoints(np.array(points)[:, None], np.full(2, 0.5))
    ...     for points in ([0.0, 1.0], [0.5, 1.5])
    ... )
    >>> numpy = clmorph.get_backend("numpy")
    >>> lower_transform(source, target, np.zeros(2), 1e-6, numpy).round(4).tolist()
    [0.125, 0.125]
    """
    pair = source, target
    rows, columns = (operations.upload(each.points, each.weights, each.offsets) for each in pair)
    softmin = Softmin(operations, rows, columns, (source.weights, target.weights), TRUNCATION)
    softmin.guess = guess
    found = softmin(g, epsilon, bounded=True)
    largest = -np.log(target.weights[target.weights > 0].min())
    return found - epsilon * (largest + softmin.left_out + softmin.roundoff)
