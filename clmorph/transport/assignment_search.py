"""The cheapest assignment, with prices that prove how far any other one can be below it.

Prices begin at entropic potentials. Candidates are the pairs that are cheapest at them, for each
row and for each column. Bids and shortest paths make an assignment the cheapest one of candidates,
with prices that prove it. Then the cheapest of all pairs of each row is found at these prices:
pairs that undercut their row's candidates join these, until there are none. By weak duality the sum
of prices bounds the cost of all assignments from below. Where pairs are too many for the host,
candidates are drawn from plans of several temperatures, and one sum over all pairs bounds each
row's least cost less price.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clmorph._shared.progress import Report, Share
from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.transport._solver.iteration import share_done
from clmorph.transport._solver.problem import upload_both
from clmorph.transport._solver.softmin import MANY_PAIRS, Softmin, many_pairs
from clmorph.transport.auction import OPEN, ROUNDING, Auction, few
from clmorph.transport.pair_costs import Costs, Indices

#: With at most this many pairs, all of them are candidates.
FEW_PAIRS = 1 << 14
#: Candidates of each point at first, and those that join when a pair is found to be cheaper.
CANDIDATES, MORE = 16, 8
#: Increment of bids, in units of epsilon, and bids for each column after which they end.
INCREMENT, BIDS = 0.5, 30
#: Rows that are left without a column get pairs among themselves as long as these are more than
#: this, and at most this share of those before; the others get the cheapest of what is left.
LEFT, FEWER = 100, 0.9
#: Rows of candidates for each column after which the search for prices along paths stops, where
#: few candidates are new and otherwise.
FEW_LINES, LINES = 20, 1000
#: Share of the gap that prices may miss.
SLACK = 1 / 8
#: Rows that are searched after a check on the device.
MOST_SEARCHED = 1 << 13
#: Share of rows that find cheaper pairs beyond which all points get new candidates.
MANY = 0.05
#: Checks of all pairs after which the search ends.
CHECKS = 100
#: Draws of candidates of each point at each of some temperatures, in units of epsilon: hot ones
#: reach far, cold ones are the cheapest pairs.
DRAWS, TEMPERATURES = 16, (4.0, 1.0, 0.25)
#: Nats by which pairs left out may lower the logarithm of a sum.
TRUNCATION = 1e-2
#: Share of the accuracy that a bound may lose.
LOST = 1 / 8


class Solution(NamedTuple):
    """An assignment and its proof; costs and prices are sums over the rows."""

    columns: Indices  #: (N,) column of each row
    prices: tuple[Array, Array]  #: (N,) f and (M,) g, with f_i + g_j at most the cost of the pair
    cost: float
    bound: float  #: no assignment has a lower cost
    reached: bool  #: whether the gap is reached, or the assignment is the cheapest, to rounding

    @property
    def gap(self) -> float:
        """Share of the bound by which the cost is above it."""
        return self.cost / self.bound - 1 if self.bound > 0 else np.inf


class PlanSearch:
    """Candidates and bounds of too many pairs for the host, from entropic plans on the device."""

    def __init__(self, costs: Costs, epsilon: float, operations: Operations, seed: int) -> None:
        self._costs, self._epsilon, self._operations = costs, epsilon, operations
        self._rng = np.random.default_rng(seed)
        self._measures = costs.measures()
        self._clouds = upload_both(operations, *self._measures)
        few = len(costs.x) ** 2 < many_pairs(operations)  # for a fast device
        self._truncation = None if few else TRUNCATION

    def _softmin(self, side: int) -> Softmin:
        order = (side, 1 - side)
        clouds = [self._clouds[each] for each in order]
        masses = self._measures[side].weights, self._measures[1 - side].weights
        return Softmin(self._operations, clouds[0], clouds[1], masses, self._truncation)

    def _drawn(self, side: int, potential: Array, epsilon: float) -> tuple[Indices, Array]:
        """Return draws of each point, (N, DRAWS), and the soft minimum, (N,)."""
        softmin = self._softmin(side)
        reached = softmin(potential, epsilon)
        shape = len(potential), DRAWS
        thresholds = np.minimum((np.arange(DRAWS) + self._rng.random(shape)) / DRAWS, 1 - 2.0**-24)
        there = self._operations.sample_plan_rows(
            self._clouds[side], self._clouds[1 - side], potential, reached, epsilon, thresholds,
            False, softmin.near,
        )  # fmt: skip
        return there.astype(np.intp), reached

    def candidates(self, g: Array) -> tuple[Indices, Indices]:
        """Return rows and columns of pairs that are drawn at prices g, (N,)."""
        own = np.arange(len(g))
        each = np.repeat(own, DRAWS)
        rows, columns = [own], [own]  # each point has a candidate
        for temperature in TEMPERATURES:
            there, f = self._drawn(0, g, temperature * self._epsilon)
            back, _ = self._drawn(1, f, temperature * self._epsilon)
            rows += [each, back.ravel()]
            columns += [there.ravel(), each]
        return np.concatenate(rows), np.concatenate(columns)

    def below(self, g: Array, guess: Array, accuracy: float) -> tuple[Array, float]:
        """Return f_i at most min_j (C_ij - g_j), (N,), and by how much they may be lower.

        With masses b_j, the soft minimum T(g)_i = -epsilon log sum_j b_j exp((g_j - C_ij) /
        epsilon) exceeds that minimum by at most -epsilon log min b. Proven bounds of the rounding
        on the device and of the pairs left out are subtracted. guess: (N,), about T(g).
        """
        points = np.vstack([each.points for each in self._measures])
        spread = float(np.square(np.ptp(points, axis=0)).sum() / 2 + np.ptp(g))
        spread += sum(
            float(np.ptp(each.offsets)) for each in self._measures if each.offsets is not None
        )
        nats = float(np.log(len(g)))
        epsilon = max(LOST * accuracy / (2 * nats), 2 * spread / self._operations.max_spread)
        softmin = self._softmin(0)
        softmin.guess = guess
        found = softmin(g, epsilon, bounded=True)
        largest = -np.log(self._measures[1].weights.min())
        return found - epsilon * (largest + softmin.left_out + softmin.roundoff), 2 * epsilon * nats


def solved(
    costs: Costs,
    g: Array,
    epsilon: float,
    gap: float,
    seed: int = 0,
    report: Report = lambda share: None,
    start: Indices | None = None,
    constant: float = 0.0,
    operations: Operations | None = None,
    drawn: float | None = None,
) -> Solution:
    """Return an assignment whose cost is at most (1 + gap) times its bound, if that is reached.

    g: (M,) prices at which the search begins, such as entropic potentials; epsilon: theirs, in cost
    units; gap: 0 asks for the cheapest assignment, to rounding; seed: of draws; start: (N,)
    columns of an assignment at which it begins in place of bids, with N = M; constant: what each
    assignment costs besides, of which the gap is a share as well; operations:
    those of a device, which searches pairs that are too many for the host if its bounds can prove
    the gap; drawn: epsilon of the plans from which it draws, by default that of g.
    """
    plans = None
    many = gap > 0 and not costs.spare and len(costs.x) ** 2 >= MANY_PAIRS
    if operations is not None and start is None and many:
        plans = PlanSearch(costs, drawn or epsilon, operations, seed)
    state = _begun(costs, g, epsilon, start, plans)
    n, m = len(costs.x), len(costs.y)
    found, first = Solution(np.arange(n), (g[:n], g), np.inf, -np.inf, False), np.inf
    shortest = start is not None
    share = min(gap, 1.0)  # prices that may miss more would prove nothing
    for number in range(CHECKS):
        if state.taken.min() < 0:
            _fill(state, INCREMENT * epsilon)
        accuracy = share * (state.cost() + constant) / n
        least = SLACK * accuracy
        if not shortest or not state.settle(FEW_LINES * m, least):
            state.shorten(LINES * m, least)
            shortest = state.settle(LINES * m, least)
        if plans is None:
            f, undercut = _checked(state)
        else:
            rng = np.random.default_rng(seed + number)
            f, undercut, fine = _bounded(state, plans, accuracy, rng)
        bound = state.bound(f)
        if bound > found.bound:
            found = found._replace(prices=(f, state.g.copy()), bound=bound)
        cost = state.cost()
        if cost < found.cost:
            found = found._replace(columns=state.taken.copy(), cost=cost)
        bound = max(found.bound, -constant)  # no assignment costs less than nothing
        above = found.cost - bound
        first, enough = min(first, above), gap * (bound + constant)
        least_gap = max(enough, 1e-12 * first, np.finfo(float).tiny)
        report(Share(share_done(first, above, least_gap), f"gap {found.gap:.1e}"))
        # Nothing is left to be found, unless prices may have missed too much of a lower cost.
        proven = shortest and not undercut and least * n <= 2 * SLACK * share * (cost + constant)
        if above <= enough or (proven and plans is None):
            found = found._replace(reached=True)
            break
        if plans is not None and (proven or not fine):
            plans = None  # bounds on the device are lower than what is left of the gap
        shortest = shortest and undercut <= MANY * n
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


def _fill(state: Auction, increment: float) -> None:
    """Give each row a column: by bids, then with pairs among those left, in ever smaller parts."""
    costs, before = state.costs, len(state.taken) + 1
    while True:
        state.run(increment, BIDS * len(state.g))
        rows, columns = np.flatnonzero(state.taken < 0), np.flatnonzero(state.owner < 0)
        if len(rows) <= max(LEFT, OPEN * len(state.taken)) or len(rows) > FEWER * before:
            break
        before = len(rows)
        part = replace(
            costs, x=costs.x[rows], y=costs.y[columns],
            weights=None if costs.weights is None else costs.weights[rows],
        )  # fmt: skip
        own, others = _candidates(part, state.g[columns])
        state.add(rows[own], columns[others])
    state.complete()


def _checked(state: Auction) -> tuple[Array, int]:
    """Return f_i at most min_j (C_ij - g_j) over all pairs, and add candidates that undercut.

    The other result is the number of rows for which there were such.
    """
    costs, g = state.costs, state.g
    own = np.arange(len(costs.x))
    before = state.cheapest()
    nearest = costs.cheapest(0, g, 1, own)[:, 0]
    f = np.minimum(before, costs.of_pairs(own, nearest) - g[nearest])
    # What one form of a cost can be below another one by rounding.
    lost = ROUNDING * max(costs.scale, float(np.abs(g).max()))
    undercut = np.flatnonzero(f < before - lost)
    if len(undercut) > MANY * len(own):
        rows, columns = _candidates(costs, g)
        state.add(np.append(rows, undercut), np.append(columns, nearest[undercut]))
    elif len(undercut):
        _add_cheapest(state, undercut, nearest[undercut])
    return f, len(undercut)


def _bounded(
    state: Auction, plans: PlanSearch, accuracy: float, rng: np.random.Generator
) -> tuple[Array, int, bool]:
    """Return what `_checked` does from bounds on the device; at most some rows are searched.

    accuracy: by how much rows may be undercut, on average. The last result is whether bounds are
    as accurate.
    """
    before = state.cheapest()
    f, lost = plans.below(state.g, before, accuracy)
    undercut = np.flatnonzero(f < before - max(accuracy / 2, lost))
    if len(undercut):
        some = undercut
        if len(some) > MOST_SEARCHED:
            some = rng.choice(undercut, MOST_SEARCHED, replace=False)
        _add_cheapest(state, some, np.zeros(0, np.intp))
    return f, len(undercut), lost <= accuracy


def _add_cheapest(state: Auction, rows: Indices, nearest: Indices) -> None:
    """Add the cheapest pairs of some rows to the candidates, and the very cheapest, if known."""
    columns = state.costs.cheapest(0, state.g, MORE, rows)
    repeated = np.repeat(rows, columns.shape[1])
    state.add(np.append(repeated, rows[: len(nearest)]), np.append(columns.ravel(), nearest))
