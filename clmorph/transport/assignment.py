"""A permutation that transports one cloud of equal masses to another, and a bound on its cost.

The cost of a permutation s is the mean of |X_i - Y_s(i)|^2 / 2. It begins with a binary space
partition (Genest, Courty, Coeurjolly, "BSP-OT", 2025): both clouds are halved by the same random
directions until one point is left in each part. Then pairs whose displacements are near one another
are gathered in small blocks, and each block is assigned exactly.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from clmorph._shared.typing import Array

Indices = NDArray[np.intp]

#: Pairs of a block that is assigned exactly, and largest number of rounds.
BLOCK, ROUNDS = 200, 200
#: A round that lowers the cost by less than this share, several times in a row, ends the search.
SMALLEST_GAIN, PATIENCE = 1e-5, 4
#: Units in the last place by which rounding can raise a computed bound, for a coordinate.
ROUNDING = 16


class Assignment(NamedTuple):
    """A permutation and its cost."""

    permutation: Indices  #: (N,) index of the target of each source
    cost: float  #: mean of half squared distances


def assign(
    source: Array,
    target: Array,
    *,
    destinations: Array | None = None,
    seconds: float = np.inf,
    seed: int = 0,
) -> Assignment:
    """Assign points to points so that half the mean squared distance is small.

    Parameters
    ----------
    source, target : (N, D) arrays
    destinations : (N, D) array, optional
        Where each source goes about, such as the means of an entropic plan; the partition then
        begins from there instead of from the sources.
    seconds : float
        Time after which no further round begins.
    seed : int
        Seed of the random directions. Only with unlimited `seconds` does it fix the result.

    Returns
    -------
    Assignment
        Every target is used once. The permutation is not optimal in general.

    Examples
    --------
    >>> import numpy as np
    >>> found = assign(np.array([[0.0], [1.0]]), np.array([[1.5], [0.5]]))
    >>> found.permutation.tolist(), found.cost
    ([1, 0], 0.125)
    """
    rng = np.random.default_rng(seed)
    ends = time.perf_counter() + seconds
    permutation = _partitioned(source if destinations is None else destinations, target, rng)
    cost = permutation_cost(source, target, permutation)
    idle = 0
    for _ in range(ROUNDS):
        if idle >= PATIENCE or cost == 0 or time.perf_counter() > ends:
            break
        _exchange(source, target, permutation, rng)
        before, cost = cost, permutation_cost(source, target, permutation)
        idle = idle + 1 if before - cost < SMALLEST_GAIN * before else 0
    return Assignment(permutation, cost)


def permutation_cost(source: Array, target: Array, permutation: Indices) -> float:
    """Return the mean of |X_i - Y_s(i)|^2 / 2 in float64."""
    return float(np.square(source - target[permutation]).sum(axis=1).mean() / 2)


def lower_bound(source: Array, target: Array, g: Array) -> float:
    """Return a number that the cost of no permutation is below, from any potentials g.

    Weak duality: it is mean f + mean g with f_i = min_j (C_ij - g_j). The minimum is exact: with
    s_j^2 / 2 = max(g) - g_j as a further coordinate of Y_j it is a search for nearest neighbors.
    The bound is lowered by the rounding of float64.

    Parameters
    ----------
    source, target : (N, D) arrays
    g : (N,) array
        Potentials of the targets, in cost units.
    """
    top = g.max()
    extra = np.sqrt(2 * (top - g))
    tree = KDTree(np.column_stack([target, extra]))
    distances, _ = tree.query(np.column_stack([source, np.zeros(len(source))]), workers=-1)
    bound = np.square(distances).mean() / 2 - top + g.mean()
    # Each term is a sum of D + 1 squares of differences of numbers of at most this size.
    size = max(np.abs(source).max(), np.abs(target).max(), extra.max())
    scale = (source.shape[1] + 1) * 4 * size**2 + 2 * np.abs(g).max()
    return float(bound - ROUNDING * (source.shape[1] + 1) * np.finfo(float).eps * scale)


def _partitioned(source: Array, target: Array, rng: np.random.Generator) -> Indices:
    """Return the permutation of a binary space partition of both clouds."""
    n = len(source)
    rows, columns = np.arange(n), np.arange(n)
    for part in _halvings(n, 1):
        across = rng.standard_normal(source.shape[1])
        rows = rows[np.lexsort([source[rows] @ across, part])]
        columns = columns[np.lexsort([target[columns] @ across, part])]
    permutation = np.empty(n, np.intp)
    permutation[rows] = columns
    return permutation


def _exchange(source: Array, target: Array, permutation: Indices, rng: np.random.Generator) -> None:
    """Assign blocks of near pairs exactly, in place; the cost does not rise."""
    n = len(source)
    # Pairs are near if their sources or their targets are; a random share weighs the two.
    share = rng.uniform()
    where = share * source + (1 - share) * target[permutation]
    order = np.arange(n)
    for part in _halvings(n, BLOCK):
        order = order[np.lexsort([where[order] @ rng.standard_normal(source.shape[1]), part])]
    for rows in np.array_split(order, -(-n // BLOCK)):
        columns = permutation[rows]
        cost = cdist(source[rows], target[columns], "sqeuclidean")
        _, chosen = linear_sum_assignment(cost)
        permutation[rows] = columns[chosen]


def _halvings(n: int, smallest: int) -> Iterator[Indices]:
    """Yield the part of each rank, for 1, 2, 4, ... nested parts above a size."""
    n_parts = 1
    while n > n_parts * smallest:
        yield np.arange(n) * n_parts // n
        n_parts *= 2
