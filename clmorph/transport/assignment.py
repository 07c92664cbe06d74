"""A permutation that transports one cloud of equal masses to another one at a low cost, quickly.

`clmorph.transport.auction` finds the cheapest one, with a proof; this is for pictures of blocks.

The cost of a permutation s is the mean of |X_i - Y_s(i)|^2 / 2. The search begins with a binary
space partition (Genest, Courty, Coeurjolly, "BSP-OT", 2025): both clouds are halved by the same
random directions until one point is left in each part. Then pairs that lie near one another are
gathered in small blocks, and each block is assigned exactly, in rounds with new blocks.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from clmorph._shared.typing import Array
from clmorph.transport.pair_costs import Indices

#: Pairs of a block that is assigned exactly, in the first rounds and in all later ones. Far from
#: the optimum small blocks gain as much, in less time.
FIRST_BLOCKS, BLOCK = (32, 32, 64, 64), 128
#: Largest number of rounds.
ROUNDS = 200
#: A round that lowers the cost by less than a share of it (this is the default) is idle; several in
#: a row end the search.
SMALLEST_GAIN, PATIENCE = 1e-5, 3
#: Parts into which a level of the search for near pairs cuts each part.
WAYS = 4
#: Largest number of threads; SciPy's solver of a block releases the interpreter's lock.
MAX_THREADS = 8


def assign(
    source: Array,
    target: Array,
    *,
    destinations: Array | None = None,
    least_gain: float = SMALLEST_GAIN,
    seed: int = 0,
) -> Indices:
    """Return the target of each source, (N,), so that half the mean squared distance is small.

    The partition begins from `destinations`, such as the means of an entropic plan, in place of the
    sources. The search ends when rounds lower the cost by a smaller share than `least_gain`; the
    permutation is not optimal in general.
    """
    from scipy.optimize import linear_sum_assignment  # takes long to import

    n = len(source)
    rng = np.random.default_rng(seed)
    permutation = partitioned(source if destinations is None else destinations, target, rng)
    # Points that are already in place keep it, as in images that are nearly the same.
    permutation = merged(permutation, np.arange(n), source, target)
    cost = permutation_cost(source, target, permutation)
    # |X - Y|^2 / 2 is a term of the row, which changes no assignment, plus height_j - X . Y.
    height = np.square(target).sum(axis=1) / 2

    def exchanged(rows: Indices) -> tuple[Indices, Indices]:
        """Assign the sources of a block to the targets that they have now."""
        columns = permutation[rows]
        cost = height[columns] - source[rows] @ target[columns].T
        return rows, columns[linear_sum_assignment(cost)[1]]

    idle = 0
    with ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1)) as pool:
        for number in range(ROUNDS):
            if idle >= PATIENCE:
                break
            size = FIRST_BLOCKS[number] if number < len(FIRST_BLOCKS) else BLOCK
            blocks = _near_pairs(source, target, permutation, size, rng)
            for rows, columns in pool.map(exchanged, blocks):
                permutation[rows] = columns
            before, cost = cost, permutation_cost(source, target, permutation)
            idle = idle + 1 if before - cost < least_gain * before else 0
    return permutation


def permutation_cost(source: Array, target: Array, permutation: Indices) -> float:
    """Return the mean of |X_i - Y_s(i)|^2 / 2 in float64."""
    return float(_costs(source, target, permutation).mean())


def merged(first: Indices, second: Indices, source: Array, target: Array) -> Indices:
    """Return a permutation that is at least as cheap as two others, (N,).

    A set of sources that both send to the same targets can follow either of them (BSP-OT,
    "merging"), so each smallest such set follows the cheaper one.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(first)
    owner = np.empty(n, np.intp)
    owner[first] = np.arange(n)
    links = coo_array((np.ones(n, np.int8), (np.arange(n), owner[second])), shape=(n, n))
    _, cycle = connected_components(links, directed=False)
    gains = _costs(source, target, first) - _costs(source, target, second)
    return np.where(np.bincount(cycle, gains)[cycle] > 0, second, first)


def partitioned(source: Array, target: Array, rng: np.random.Generator) -> Indices:
    """Return the permutation of a binary space partition of source and target, (N, D) each."""
    n = len(source)
    rows, columns = np.arange(n), np.arange(n)
    for part in _parts(n, 1, 2):
        across = rng.standard_normal(source.shape[1:])
        rows, columns = _sorted(rows, source, across, part), _sorted(columns, target, across, part)
    permutation = np.empty(n, np.intp)
    permutation[rows] = columns
    return permutation


def _near_pairs(
    source: Array, target: Array, permutation: Indices, size: int, rng: np.random.Generator
) -> list[Indices]:
    """Return the sources in blocks of near pairs, at most `size` in each."""
    n = len(source)
    # Pairs are near if their sources or their targets are; a random share weighs the two.
    share = rng.uniform()
    where = share * source + (1 - share) * target[permutation]
    order = np.arange(n)
    for part in _parts(n, size, WAYS):
        order = _sorted(order, where, rng.standard_normal(where.shape[1:]), part)
    return np.array_split(order, -(-n // size))


def _costs(source: Array, target: Array, permutation: Indices) -> Array:
    return np.square(source - target[permutation]).sum(axis=1) / 2


def _parts(n: int, smallest: int, ways: int) -> Iterator[Indices]:
    """Yield the part of each rank for ever more nested parts, until they have a size."""
    n_parts = 1
    while n > n_parts * smallest:
        yield np.arange(n) * n_parts // n
        n_parts *= ways


def _sorted(order: Indices, points: Array, across: Array, part: Indices) -> Indices:
    """Return points sorted by their parts and, inside each part, along a direction."""
    along = (points @ across)[order]
    low, high = along.min(), along.max()
    # One key for both, which NumPy sorts several times as fast as two.
    return order[np.argsort(part + (along - low) * (0.999 / (high - low) if high > low else 0.0))]
