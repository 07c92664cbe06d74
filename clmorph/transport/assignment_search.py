"""The cheapest assignment, with prices that prove how far any other one can be below it.

Prices begin at entropic potentials. Candidates are the pairs that are cheapest at them, for each
row and for each column. Auctions with ever smaller increments end near the cheapest assignment of
candidates; where that is too much for the gap, shortest paths and negative circles make it the
cheapest one, with prices that prove it. Then the cheapest of all pairs of each row is found at
these prices: pairs that undercut their row's candidates join these, until there are none. By weak
duality the sum of prices bounds the cost of all assignments from below.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clmorph._shared.progress import Report, Share
from clmorph._shared.typing import Array
from clmorph.transport.auction import ROUNDING, Auction, few
from clmorph.transport.pair_costs import Costs, Indices
from clmorph.transport.plan_search import PlanSearch

#: With at most this many pairs, all of them are candidates.
FEW_PAIRS = 1 << 14
#: Candidates of each point at first, and those that join when a pair is found to be cheaper.
CANDIDATES, MORE = 16, 8
#: The first increment of bids, in units of epsilon, and by how much the next one is smaller.
INCREMENT, FACTOR = 0.5, 8.0
#: The increment, in units of epsilon, after which shortest paths are tried, and the lines of
#: candidates for each row after which these are given up.
SMALL, LINES = 2.0**-6, 20
#: Groups into which points are parted, again and again, for pairs that are far apart, and how many
#: of these each row gets at a time.
PARTS, FAR = 16, 4
#: Rows that are searched after a check on the device.
MOST_SEARCHED = 1 << 13
#: By how much increments become larger after too many bids.
LARGER = 4.0
#: Share of rows that find cheaper pairs beyond which all points get new candidates.
MANY = 0.05
#: Bids for each row after which all pairs are checked, at first and after many such times, and
#: checks after which the search ends.
BIDS, MOST_BIDS, CHECKS = 30, 480, 100
#: If rows are left without a column after so many attempts, they get one of those left: where
#: groups of points are far apart, their prices would take too many bids.
ATTEMPTS = 5


class Solution(NamedTuple):
    """An assignment and its proof; costs and prices are sums over the rows."""

    columns: Indices  #: (N,) column of each row
    prices: tuple[Array, Array]  #: (N,) f and (M,) g, with f_i + g_j at most the cost of the pair
    cost: float
    bound: float  #: no assignment has a lower cost
    reached: bool  #: whether the gap is reached, or the assignment is the cheapest, to rounding


def solved(
    costs: Costs,
    g: Array,
    epsilon: float,
    gap: float,
    seed: int = 0,
    report: Report = lambda share: None,
    start: Indices | None = None,
    constant: float = 0.0,
    plans: PlanSearch | None = None,
) -> Solution:
    """Return an assignment whose cost is at most (1 + gap) times its bound, if that is reached.

    g: (M,) prices at which the search begins, such as entropic potentials; epsilon: theirs, in cost
    units; gap: 0 asks for the cheapest assignment, to rounding; seed: of far pairs; start: (N,)
    columns of an assignment at which it begins in place of bids, with N = M; constant: what each
    assignment costs besides, of which the gap is a share as well; plans: search
    of pairs that are too many for the host, whose bounds prove gaps above 0.
    """
    state = _begun(costs, g, epsilon, start, plans)
    n, m = len(costs.x), len(costs.y)
    found, first = Solution(np.arange(n), (g[:n], g), np.inf, -np.inf, False), np.inf
    failed, increment, settled = 0, INCREMENT * epsilon, start is not None
    for number in range(CHECKS):
        bids = m * min(BIDS << failed, MOST_BIDS)
        proven = settled = settled and state.settle(LINES * m)
        if not proven:
            proven, increment, settled = _bid(state, increment, epsilon, gap, constant, bids)
        if not proven:
            failed += 1
            increment = min(LARGER * increment, costs.scale)
            if failed > ATTEMPTS and state.taken.min() < 0:
                state.complete()
                settled = True
        if plans is None:
            f, undercut, by = _checked(state)
        else:
            f, undercut, by = _bounded(
                state, plans, increment, np.random.default_rng(seed + number)
            )
        if plans is None and (not proven or undercut > MANY * n):
            state.add(*_far(costs, state.g, np.random.default_rng(seed + number)))
        bound = state.bound(f)
        if bound > found.bound:
            found = found._replace(prices=(f, state.g.copy()), bound=bound)
        if state.taken.min() < 0:
            continue
        cost = state.cost()
        if cost < found.cost:
            found = found._replace(columns=state.taken.copy(), cost=cost)
        bound = max(found.bound, -constant)  # no assignment costs less than nothing
        above = found.cost - bound
        first, enough = min(first, above), gap * (bound + constant)
        report(Share(_share(above, first, enough), f"gap {_gap(found):.1e}"))
        if above <= enough or (proven and settled and not undercut and plans is None):
            found = found._replace(reached=True)
            break
        if proven and settled and not undercut:
            plans = None  # bounds on the device are lower than what is left of the gap
        # If shortest paths are too long from here, bids rise from what prices are off by.
        increment = max(increment, min(by / 4, INCREMENT * epsilon))
        settled = undercut <= MANY * n and (settled or (proven and not undercut))
    if found.cost == np.inf:
        state.complete()
        found = found._replace(columns=state.taken.copy(), cost=state.cost())
    report(1.0)
    f, g = found.prices
    # Columns that no row has then have a price of 0, and the others prove the bound alone.
    shift = float(g.max()) if costs.spare else 0.0
    return found._replace(
        cost=float(found.cost), bound=float(min(max(found.bound, -constant), found.cost)),
        prices=(f + shift, g - shift),
    )  # fmt: skip


def _begun(
    costs: Costs, g: Array, epsilon: float, start: Indices | None, plans: PlanSearch | None
) -> Auction:
    """Return an auction with its first candidates."""
    n, m = len(costs.x), len(costs.y)
    own = np.arange(n)
    if start is not None:
        state = Auction(costs, g, own, start)
        state.take(start)
        return state
    if costs.spare and epsilon > 0:
        # The price at which the columns left over would be taken, if one point took them all.
        top = g.max()
        level = top + epsilon * np.log(np.exp((g - top) / epsilon).sum() / costs.spare)
        g = np.minimum(g, level)
    if n * m <= FEW_PAIRS:
        return Auction(costs, g, *(each.ravel() for each in np.indices((n, m))))
    if plans is not None:
        return Auction(costs, g, *plans.candidates(g))
    return Auction(costs, g, *_candidates(costs, g))


def _candidates(costs: Costs, g: Array) -> tuple[Indices, Indices]:
    """Return the cheapest pairs of each row and of each column at some prices."""
    n, m = len(costs.x), len(costs.y)
    columns = costs.cheapest(0, g, CANDIDATES, np.arange(n)).ravel()
    rows = np.repeat(np.arange(n), len(columns) // n)
    f = (costs.of_pairs(rows, columns) - g[columns]).reshape(n, -1).min(axis=1)
    others = costs.cheapest(1, f, CANDIDATES, np.arange(m)).ravel()
    chosen = np.repeat(np.arange(m), len(others) // m)
    kept = few(others, costs.of_pairs(others, chosen) - g[chosen])
    return np.concatenate((rows, others[kept])), np.concatenate((columns, chosen[kept]))


def _far(costs: Costs, g: Array, rng: np.random.Generator) -> tuple[Indices, Indices]:
    """Return pairs that are cheap among ever fewer ones, as rows may have to go to far columns.

    Rows and columns are parted at random in as many groups, of which each row searches one.
    """
    n, m = len(costs.x), len(costs.y)
    rows, columns = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
    groups = PARTS
    while n >= groups * 2:
        orders = [np.array_split(rng.permutation(count), groups) for count in (n, m)]
        for some, others in zip(*orders, strict=True):
            part = replace(
                costs, x=costs.x[some], y=costs.y[others],
                weights=None if costs.weights is None else costs.weights[some],
            )  # fmt: skip
            found = part.cheapest(0, g[others], FAR, np.arange(len(some)))
            rows.append(np.repeat(some, found.shape[1]))
            columns.append(others[found.ravel()])
        groups *= PARTS
    return np.concatenate(rows), np.concatenate(columns)


def _bid(
    state: Auction, increment: float, epsilon: float, gap: float, constant: float, bids: int
) -> tuple[bool, float, bool]:
    """Bring the assignment near the cheapest one of the candidates by bids.

    Return whether it is proven to be near enough for the gap, the last increment, and whether
    shortest paths have proven it.
    """
    smallest = 8 * ROUNDING * state.size
    while True:
        if state.taken.min() >= 0:
            state.release()
        if not state.run(increment, bids):
            return False, increment, False
        bound = float(state.cheapest().sum() + state.g.sum())
        if state.costs.spare:
            bound -= state.level * state.costs.spare
        if state.cost() - bound <= gap / 2 * (bound + constant):
            return True, increment, False
        if increment <= SMALL * epsilon and state.settle(LINES * len(state.g)):
            return True, increment, True
        if increment <= smallest:
            return False, increment, False
        increment = max(increment / FACTOR, smallest)


def _checked(state: Auction) -> tuple[Array, int, float]:
    """Return f_i at most min_j (C_ij - g_j) over all pairs, and add candidates that undercut.

    The other results are the number of rows for which there were such, and by how much on average.
    """
    costs, g = state.costs, state.g
    own = np.arange(len(costs.x))
    before = state.cheapest()
    nearest = costs.cheapest(0, g, 1, own)[:, 0]
    f = np.minimum(before, costs.of_pairs(own, nearest) - g[nearest])
    # What one form of a cost can be below another one by rounding.
    lost = ROUNDING * max(costs.scale, float(np.abs(g).max()))
    undercut = np.flatnonzero(f < before - lost)
    if not len(undercut):
        return f, 0, 0.0
    if len(undercut) > MANY * len(own):
        rows, columns = _candidates(costs, g)
    else:
        columns = costs.cheapest(0, g, MORE, undercut)
        rows, columns = np.repeat(undercut, columns.shape[1]), columns.ravel()
    state.add(np.append(rows, undercut), np.append(columns, nearest[undercut]))
    return f, len(undercut), float((before - f)[undercut].mean())


def _bounded(
    state: Auction, plans: PlanSearch, increment: float, rng: np.random.Generator
) -> tuple[Array, int, float]:
    """Return what `_checked` does from bounds on the device; at most some rows are searched."""
    before = state.cheapest()
    f, lost = plans.below(state.g, before, increment)
    undercut = np.flatnonzero(f < before - max(increment / 2, lost))
    if not len(undercut):
        return f, 0, 0.0
    by = float((before - f)[undercut].mean())
    some = undercut
    if len(some) > MOST_SEARCHED:
        some = rng.choice(undercut, MOST_SEARCHED, replace=False)
    columns = state.costs.cheapest(0, state.g, MORE, some)
    state.add(np.repeat(some, columns.shape[1]), columns.ravel())
    return f, len(undercut), by


def _gap(found: Solution) -> float:
    return (found.cost / found.bound - 1) if found.bound > 0 else np.inf


def _share(above: float, first: float, enough: float) -> float:
    """Return the progress of a gap that falls about geometrically."""
    if above <= enough or first <= 0:
        return 1.0
    end = np.log(first / max(enough, 1e-12 * first, np.finfo(float).tiny))
    return float(np.clip(np.log(first / above) / end, 0.0, 1.0)) if end > 0 else 0.0
