"""The cheapest assignment, with prices that prove how far any other one can be below it.

An auction (Bertsekas 1988) runs over candidates, the pairs that are cheap at the prices. Each row
without a column bids for its cheapest one, by as much as this is cheaper than the row's second one,
plus an increment. A column changes its owner and its price; at the end each row has a column that
is cheapest but for the increment. Prices begin at entropic potentials, so few bids are needed.
Where the increment is too much for the gap, shortest paths and negative circles (Klein 1967) make
the assignment the cheapest one of the candidates, with prices that prove it. All pairs are checked
against the prices: pairs that are cheaper than their row's candidates join these. By weak duality
the sum of prices bounds the cost of all assignments from below.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from clmorph._shared.progress import Report, Share
from clmorph._shared.typing import Array
from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import Operations
from clmorph.measures.points import WeightedPoints
from clmorph.transport._solver.softmin import MANY_PAIRS, Softmin
from clmorph.transport.assignment_bound import lower_transform

Indices = NDArray[np.intp]

#: With at most this many pairs, all of them are candidates.
FEW_PAIRS = 1 << 14
#: Draws of candidates of each point at each of some temperatures, in units of epsilon: hot ones
#: reach far, cold ones are the cheapest pairs.
DRAWS, TEMPERATURES = 16, (4.0, 1.0, 0.25)
#: The increment of bids, in units of epsilon.
INCREMENT = 0.125
#: Falls of a price that are rounding, relative to costs and prices: units in their last place.
ROUNDING = 4 * np.finfo(float).eps
#: Candidates that join a row when a pair is found to be cheaper, and rows that are searched in one
#: round.
MORE, MAX_SEARCHED = 8, 1 << 13
#: Bids for each row after which all pairs are checked, and checks after which the search ends.
BIDS, CHECKS = 30, 100
#: If rows are left without a column after so many rounds, they get one of those left, in parts of
#: so many rows: where groups of points are far apart, their prices would take too many bids.
ATTEMPTS, PART = 2, 1000
#: Steps along shortest paths after which all pairs are checked, and steps after each of which
#: circles are looked for.
STEPS, CIRCLES = 20_000, 16
#: Pairs whose costs are formed together.
CHUNK = 1 << 21
#: Nats by which pairs left out may lower a sum, for draws.
TRUNCATION = 1e-2


@dataclass(frozen=True)
class Costs:
    """The costs w_i |x_i - y_j|^2 / 2 of N rows and M >= N columns.

    M - N further rows cost nothing, so that all columns have a row.
    """

    x: Array  #: (N, D)
    y: Array  #: (M, D)
    weights: Array | None  #: (N,) w, or None where all are 1

    @property
    def spare(self) -> int:
        """Number of rows that cost nothing."""
        return len(self.y) - len(self.x)

    @property
    def scale(self) -> float:
        """The mean cost of all pairs."""
        rows = np.square(self.x - self.y.mean(axis=0)).sum(axis=1) + self.y.var(axis=0).sum()
        return float((rows if self.weights is None else rows * self.weights).mean() / 2)

    def of_pairs(self, rows: Indices, columns: Indices) -> Array:
        """Return the costs of pairs: (K,) array."""
        found = np.zeros(len(rows))
        own = rows < len(self.x)
        rows, columns = rows[own], columns[own]
        costs = np.square(self.x[rows] - self.y[columns]).sum(axis=1) / 2
        found[own] = costs if self.weights is None else costs * self.weights[rows]
        return found

    def of_rows(self, rows: Indices) -> Array:
        """Return the costs of some of the first N rows: (K, M) array."""
        costs = cdist(self.x[rows], self.y, "sqeuclidean")
        costs *= 0.5 if self.weights is None else self.weights[rows, None] / 2
        return costs

    def chunks(self, rows: Indices) -> Iterator[Indices]:
        """Yield rows in parts whose costs fit in the memory of a chunk."""
        size = max(1, CHUNK // len(self.y))
        for begin in range(0, len(rows), size):
            check_cancelled()
            yield rows[begin : begin + size]

    def measures(self) -> tuple[WeightedPoints, WeightedPoints]:
        """Return points of equal masses with these costs; rows that cost nothing are one point.

        w |x - y|^2 / 2 is w |x|^2 / 2 - X . Y with X = (w x, -w) and Y = (y, |y|^2 / 2), and X = 0
        costs nothing.
        """
        n, m = len(self.x), len(self.y)
        masses = np.full(m, 1.0 / m)
        if self.weights is None and not self.spare:
            return WeightedPoints(self.x, masses), WeightedPoints(self.y, masses)
        origin = self.y.mean(axis=0)
        x, y = self.x - origin, self.y - origin
        w = np.ones(n) if self.weights is None else self.weights
        half = np.square(y).sum(axis=1) / 2
        # All rows that have a cost share the mean of the heights, which the offsets take.
        unit = max(np.sqrt(half.mean()), np.finfo(float).tiny)
        rows = np.column_stack((w[:, None] * x, -w * unit))
        columns = np.column_stack((y, half / unit))
        r = w * np.square(x).sum(axis=1) / 2 - np.square(rows).sum(axis=1) / 2
        s = -np.square(columns).sum(axis=1) / 2
        if self.spare:
            rows, r = np.vstack((rows, np.zeros(rows.shape[1]))), np.append(r, 0.0)
        own = np.append(masses[:n], self.spare / m) if self.spare else masses
        return WeightedPoints(rows, own, r), WeightedPoints(columns, masses, s)


class Solution(NamedTuple):
    """An assignment and its proof; costs and prices are sums over the rows."""

    columns: Indices  #: (N,) column of each row
    prices: tuple[Array, Array]  #: (N,) f and (M,) g, with f_i + g_j at most the cost of the pair
    cost: float
    bound: float  #: no assignment has a lower cost
    reached: bool  #: whether the gap is reached, or the assignment is the cheapest, to rounding


class Auction:
    """The state of an auction: candidates, prices and owners.

    costs: Costs; g: (M,) prices at which it begins.
    """

    def __init__(self, costs: Costs, g: Array, rows: Indices, columns: Indices) -> None:
        self.costs, self.g = costs, g.copy()
        self.owner = np.full(len(g), -1)  #: (M,) row of each column
        self.taken = np.full(len(g), -1)  #: (M,) column of each row
        self._place = np.full(len(g), -1)  #: (M,) place of that column among the candidates
        self._set(rows, columns)

    def _set(self, rows: Indices, columns: Indices) -> None:
        """Keep candidates: a table with a line for each row, whose last places can be empty."""
        m = len(self.g)
        keys = np.unique(rows * m + columns)
        rows, columns = np.divmod(keys, m)
        first = np.searchsorted(rows, np.arange(m + 1))
        width = max(2, int(np.diff(first).max()))
        place = np.arange(len(rows)) - first[rows]
        self._cost = np.full((m, width), np.inf)
        self._column = np.zeros((m, width), np.intp)
        self._cost[rows, place] = self.costs.of_pairs(rows, columns)
        self._column[rows, place] = columns
        self._most = float(self._cost[np.isfinite(self._cost)].max()) + 1e-300
        owned = np.flatnonzero(self.taken >= 0)
        is_own = self._column[owned] == self.taken[owned, None]
        is_own &= np.isfinite(self._cost[owned])
        self._place[owned] = is_own.argmax(axis=1)

    def add(self, rows: Indices, columns: Indices) -> None:
        """Add candidates."""
        known = np.isfinite(self._cost)
        self._set(
            np.concatenate((np.nonzero(known)[0], rows)),
            np.concatenate((self._column[known], columns)),
        )

    def take(self, columns: Indices) -> None:
        """Begin with an assignment of candidates: (M,) column of each row."""
        self.taken[:] = columns
        self.owner[columns] = np.arange(len(columns))
        self._place[:] = (self._column == columns[:, None]).argmax(axis=1)

    def cheapest(self) -> Array:
        """Return each row's least cost less price among its candidates: (M,) array."""
        return (self._cost - self.g[self._column]).min(axis=1)

    def run(self, increment: float, bids: int) -> bool:
        """Let rows bid until all have a column, or bids are used up; return whether all have."""
        open_ = np.flatnonzero(self.taken < 0)
        while len(open_) and bids > 0:
            if len(open_) > 1:
                bids -= len(open_)
                open_ = self._round(open_, increment)
            else:
                last, bids = self._chain(int(open_[0]), increment, bids)
                open_ = open_[:0] if last < 0 else np.array([last])
        return not len(open_)

    def _round(self, rows: Indices, increment: float) -> Indices:
        """Let rows bid together; return those that then have no column."""
        columns = self._column[rows]
        value = self._cost[rows] - self.g[columns]
        line = np.arange(len(rows))
        place = value.argmin(axis=1)
        best = value[line, place]
        value[line, place] = np.inf
        # A row with one candidate bids as much as any row can.
        lead = np.minimum(value.min(axis=1) - best, self._most)
        wanted = columns[line, place]
        price = self.g[wanted] - lead - increment
        np.minimum.at(self.g, wanted, price)
        winners = np.flatnonzero(price == self.g[wanted])
        before = self.owner[wanted[winners]]
        self.owner[wanted[winners]] = rows[winners]  # the last of equal bids
        won = self.owner[wanted] == rows
        self.taken[rows[won]], self._place[rows[won]] = wanted[won], place[won]
        before = np.unique(before[before >= 0])
        self.taken[before] = -1
        return np.concatenate((rows[~won], before))

    def _chain(self, row: int, increment: float, bids: int) -> tuple[int, int]:
        """Let one row bid, then the one that has lost its column; return the last one, or -1."""
        g, owner, taken = self.g, self.owner, self.taken
        while bids > 0:
            bids -= 1
            columns = self._column[row]
            value = self._cost[row] - g[columns]
            place = int(value.argmin())
            best = value[place]
            value[place] = np.inf
            wanted = columns[place]
            g[wanted] -= min(value.min() - best, self._most) + increment
            before = int(owner[wanted])
            owner[wanted], taken[row], self._place[row] = row, wanted, place
            if before < 0:
                return -1, bids
            taken[before] = -1
            row = before
        return row, bids

    def settle(self, steps: int) -> bool:
        """Make the assignment the cheapest one of the candidates; return whether it is proven.

        Prices fall to g_j <= C_ij - C_is(i) + g_s(i) (Bellman, Ford), from where the last ones have
        fallen. Rows that undercut one another in a circle change their columns, which is cheaper.
        """
        m = len(self.g)
        row = np.arange(m)
        cause = np.full(m, -1)  # the column whose row has set a column's price last
        changed = row
        least = ROUNDING * max(self._most, float(np.abs(self.g).max()))
        for step in range(1, steps + 1):
            rows = self.owner[changed]
            level = self.g[changed] - self._cost[rows, self._place[rows]]
            price = self._cost[rows] + level[:, None]
            columns = self._column[rows]
            line, place = np.nonzero(price < self.g[columns] - least)
            if not len(line):
                return True
            price, columns = price[line, place], columns[line, place]
            np.minimum.at(self.g, columns, price)
            lowest = price == self.g[columns]
            changed = np.unique(columns)
            cause[columns[lowest]] = self.taken[rows[line[lowest]]]
            if step % CIRCLES == 0 and self._turn(cause):
                cause[:] = -1
                changed = row
        return False

    def _turn(self, cause: Indices) -> bool:
        """Let rows in circles of causes change their columns; return whether there were such."""
        m = len(cause)
        following = np.where(cause < 0, np.arange(m), cause)
        for _ in range(int(m).bit_length()):
            following = following[following]
        inside = np.unique(following)
        inside = inside[cause[inside] >= 0]
        if not len(inside):
            return False
        # All of a circle: what is reached from what is surely inside of one.
        members = np.zeros(m, bool)
        while len(inside):
            members[inside] = True
            inside = cause[inside]
            inside = inside[~members[inside]]
        columns = np.flatnonzero(members)
        rows = self.owner[cause[columns]]
        self.owner[columns], self.taken[rows] = rows, columns
        is_own = (self._column[rows] == columns[:, None]) & np.isfinite(self._cost[rows])
        self._place[rows] = is_own.argmax(axis=1)
        return True

    def complete(self) -> None:
        """Give the rows without a column the cheapest ones of what is left, as new candidates."""
        rows, columns = np.flatnonzero(self.taken < 0), np.flatnonzero(self.owner < 0)
        # In parts, which bounds the time.
        for begin in range(0, len(rows), PART):
            some, left = rows[begin : begin + PART], columns[begin : begin + PART]
            pairs = np.repeat(some, len(left)), np.tile(left, len(some))
            cost = self.costs.of_pairs(*pairs).reshape(len(some), -1)
            own = left[linear_sum_assignment(cost)[1]]
            self.taken[some], self.owner[own] = own, some
        self.add(rows, self.taken[rows])


def solved(
    costs: Costs,
    g: Array,
    epsilon: float,
    gap: float,
    operations: Operations,
    seed: int = 0,
    report: Report = lambda share: None,
    start: Indices | None = None,
) -> Solution:
    """Return an assignment whose cost is at most (1 + gap) times its bound, if that is reached.

    g: (M,) prices at which the search begins, such as entropic potentials; epsilon: theirs, in cost
    units; gap: 0 asks for the cheapest assignment, to rounding; start: (N,) columns of an
    assignment at which it begins in place of bids, with N = M.
    """
    n, m = len(costs.x), len(costs.y)
    increment = INCREMENT * epsilon
    if start is not None:
        rows, columns = np.arange(n), start
    elif m * m <= FEW_PAIRS:
        rows, columns = (each.ravel() for each in np.indices((m, m)))
    else:
        rows, columns = _candidates(costs, g, epsilon, operations, np.random.default_rng(seed))
    state = Auction(costs, g, rows, columns)
    found, first = Solution(np.arange(n), (g[:n], g), np.inf, 0.0, False), np.inf
    failed, best, settling = 0, -np.inf, start is not None
    if start is not None:
        state.take(start)
    for number in range(CHECKS):
        settled = settling and state.settle(STEPS)
        if not settling and not state.run(increment, BIDS * m):
            failed += 1
            if failed > ATTEMPTS:
                state.complete()
        f, searched = _checked(state, 0.0 if settled else increment, operations, seed + number)
        size = max(costs.scale, float(np.abs(state.g).max()))
        # NumPy adds pairwise, in blocks of 128 terms; rows have a sum of D squares.
        terms = 16 + np.log2(m) + costs.y.shape[1]
        bound = float(f.sum() + state.g.sum()) - terms * m * np.finfo(float).eps * size
        if bound > best:
            best = bound
            found = found._replace(prices=(f[:n], state.g.copy()), bound=max(bound, 0.0))
        if state.taken.min() < 0:
            continue
        cost = float(costs.of_pairs(np.arange(n), state.taken[:n]).sum())
        if cost < found.cost:
            found = found._replace(columns=state.taken[:n].copy(), cost=cost)
        above = found.cost - found.bound
        first = min(first, above)
        report(Share(_share(above, first, gap * found.bound), f"gap {_gap(found):.1e}"))
        if above <= gap * found.bound or (settled and not searched):
            # The check on the device is not exact, and proves no more than the gap.
            exact = n * m <= MANY_PAIRS
            found = found._replace(reached=exact or above <= gap * found.bound)
            break
        settling = True
    report(1.0)
    f, g = found.prices
    # Rows that cost nothing then have a price of 0, and the others prove the bound alone.
    shift = float(g.max()) if costs.spare else 0.0
    return found._replace(
        cost=float(found.cost), bound=float(min(found.bound, found.cost)),
        prices=(f + shift, g - shift),
    )  # fmt: skip


def _gap(found: Solution) -> float:
    return (found.cost / found.bound - 1) if found.bound > 0 else np.inf


def _share(above: float, first: float, enough: float) -> float:
    """Return the progress of a gap that falls about geometrically."""
    if above <= enough or first <= 0:
        return 1.0
    end = np.log(first / max(enough, 1e-12 * first))
    return float(np.clip(np.log(first / above) / end, 0.0, 1.0)) if end > 0 else 0.0


def _candidates(
    costs: Costs, g: Array, epsilon: float, operations: Operations, rng: np.random.Generator
) -> tuple[Indices, Indices]:
    """Draw pairs from entropic plans of some epsilons, from each row and from each column."""
    n, m = len(costs.x), len(costs.y)
    own, other = costs.measures()
    clouds = [operations.upload(each.points, each.weights, each.offsets) for each in (own, other)]
    weights = own.weights, other.weights
    truncation = TRUNCATION if n * m >= MANY_PAIRS else None
    found = []

    def drawn(side: int, potential: Array, epsilon: float) -> tuple[Indices, Array]:
        rows, columns = clouds[side], clouds[1 - side]
        softmin = Softmin(operations, rows, columns, (weights[side], weights[1 - side]), truncation)
        reached = softmin(potential, epsilon)
        points = len(weights[side])
        thresholds = (np.arange(DRAWS) + rng.random((points, DRAWS))) / DRAWS
        thresholds = np.minimum(thresholds, 1 - 2.0**-24)
        there = operations.sample_plan_rows(
            rows, columns, potential, reached, epsilon, thresholds, False, softmin.near
        )
        return there.astype(np.intp), reached

    for temperature in TEMPERATURES:
        hot = temperature * epsilon
        columns, f = drawn(0, g, hot)
        found.append((np.repeat(np.arange(n), DRAWS), columns[:n].ravel()))
        rows, _ = drawn(1, f, hot)
        rows = rows.ravel()
        # A row that costs nothing stands for all of them.
        rows = np.where(rows < n, rows, n + rng.integers(max(costs.spare, 1), size=len(rows)))
        found.append((rows, np.repeat(np.arange(m), DRAWS)))
        if costs.spare:
            share = np.exp((g - g.max()) / hot)
            own_draws = rng.choice(m, (costs.spare, DRAWS), p=share / share.sum())
            found.append((np.repeat(np.arange(n, m), DRAWS), own_draws.ravel()))
    # Each point has a candidate of its own.
    found.append((np.arange(m), np.arange(m)))
    return (
        np.concatenate([each[0] for each in found]), np.concatenate([each[1] for each in found]),
    )  # fmt: skip


def _checked(
    state: Auction, increment: float, operations: Operations, seed: int
) -> tuple[Array, int]:
    """Return f_i at most min_j (C_ij - g_j) over all pairs, and add candidates that undercut.

    The second result is the number of rows for which there were such.
    """
    costs, g = state.costs, state.g
    n, m = len(costs.x), len(costs.y)
    candidates = state.cheapest()
    f = candidates.copy()
    own = np.arange(n)
    # What one form of a cost can be below another one by rounding.
    lost = float(ROUNDING * max(costs.scale, np.abs(g).max()))
    dense = n * m <= MANY_PAIRS
    if dense:
        for rows in costs.chunks(own):
            f[rows] = (costs.of_rows(rows) - g).min(axis=1)
    else:
        f[:n], lost = _transform(costs, g, operations, candidates, increment)
    f[n:] = -g.max()
    undercut = np.flatnonzero(f < candidates - max(increment / 2, lost))
    if len(undercut) > MAX_SEARCHED:
        undercut = np.random.default_rng(seed).choice(undercut, MAX_SEARCHED, replace=False)
    more = min(MORE, m)
    joined: list[tuple[Indices, Indices]] = []
    for rows in costs.chunks(undercut[undercut < n]):
        value = costs.of_rows(rows) - g
        least = np.argpartition(value, more - 1, axis=1)[:, :more]
        joined.append((np.repeat(rows, more), least.ravel()))
        if not dense:
            f[rows] = value.min(axis=1)
    spare = undercut[undercut >= n]
    if len(spare):
        count = min(m, more * len(spare))
        least = np.argpartition(-g, count - 1)[:count]
        joined.append((np.repeat(spare, more), np.resize(least, more * len(spare))))
    if joined:
        state.add(*(np.concatenate([each[side] for each in joined]) for side in range(2)))
    return f, len(undercut)


def _transform(
    costs: Costs, g: Array, operations: Operations, guess: Array, increment: float
) -> tuple[Array, float]:
    """Return f_i at most min_j (C_ij - g_j), (N,), and what it may be below, from the device."""
    pair = costs.measures()
    sides = [np.ptp(np.vstack([each.points for each in pair]), axis=0), np.ptp(g)]
    largest = float(np.square(sides[0]).sum() / 2 + sides[1])
    largest += sum(float(np.ptp(each.offsets)) for each in pair if each.offsets is not None)
    # The bound loses epsilon log M.
    nats = np.log(len(g))
    epsilon = max(increment / (16 * nats), 2 * largest / operations.max_spread)
    estimate = np.append(guess[: len(costs.x)], [-g.max()] if costs.spare else [])
    f = lower_transform(*pair, g, epsilon, operations, estimate)[: len(costs.x)]
    return f, float(2 * epsilon * nats)
