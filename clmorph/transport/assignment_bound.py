"""A number that the cost of no permutation is below, by weak duality."""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.transport._solver.softmin import Softmin

#: Nats by which pairs left out may lower the logarithm of a sum; what they lower is subtracted.
TRUNCATION = 1e-2
#: Units in the last place by which the host's sums of N terms can be too large, for each term.
ROUNDING = 4


def lower_bound(
    source: Array,
    target: Array,
    g: Array,
    epsilon: float,
    operations: Operations,
    guess: Array | None = None,
) -> float:
    """Return a lower bound of the cost of all permutations, from any potentials g.

    By weak duality it is mean f + mean g for any f_i <= min_j (C_ij - g_j). With masses 1/N the
    soft minimum T(g)_i = -epsilon log sum_j exp((g_j - C_ij) / epsilon) / N exceeds that minimum by
    at most epsilon log N, so f = T(g) - epsilon log N. Proven bounds of the rounding on the device
    and of the pairs left out are subtracted, and the rounding of the means here.

    Parameters
    ----------
    source, target : (N, D) arrays
    g : (N,) array
        Potentials of the targets, in cost units.
    epsilon : float
        In cost units; the bound loses at most epsilon log N against the exact minimum.
    operations : Operations
    guess : (N,) array, optional
        An estimate of T(g), which saves one sum over all pairs.

    Returns
    -------
    float
        At least 0, which no cost is below either.

    Examples
    --------
    >>> import numpy as np
    >>> from clmorph import get_backend
    >>> source, target = np.array([[0.0], [1.0]]), np.array([[0.5], [1.5]])
    >>> round(lower_bound(source, target, np.zeros(2), 1e-6, get_backend("numpy")), 4)
    0.125
    """
    n = len(source)
    masses = np.full(n, 1.0 / n)
    rows, columns = (operations.upload(points, masses) for points in (source, target))
    softmin = Softmin(operations, rows, columns, (masses, masses), TRUNCATION)
    softmin.guess = guess
    found = softmin(g, epsilon, bounded=True)
    lost = epsilon * (np.log(n) + softmin.left_out + softmin.roundoff)
    size = float(np.abs(found).max() + np.abs(g).max() + lost)
    # NumPy adds pairwise, in blocks of 128 terms.
    terms = 128 + np.log2(n)
    bound = found.mean() + g.mean() - lost - ROUNDING * terms * np.finfo(float).eps * size
    return float(max(bound, 0.0)) if np.isfinite(bound) else 0.0
