"""Assignments of candidates by bids and by shortest paths, and prices that prove them.

Candidates are the pairs that are looked at. Bids (an auction, Bertsekas 1988) give most rows a
column: each row without one bids for its cheapest one, by as much as this is cheaper than the row's
second one, plus an increment. Shortest paths (Jonker, Volgenant 1987; SciPy's for sparse pairs)
make the assignment the cheapest one. Prices follow from it: each row's column is the cheapest one
at them. If there are more columns than rows, those that no row has have the largest price of all.
"""

import numpy as np

from clmorph._shared.typing import Array
from clmorph.transport.pair_costs import Costs, Indices

#: Falls of a price that are rounding, relative to costs and prices: units in their last place.
ROUNDING = 4 * np.finfo(float).eps
#: Share of rows without a column at which bids end.
OPEN = 0.01
#: Unit of costs along shortest paths, relative to the largest one.
STEPS = 2.0**-24
#: Units that are fine enough, relative to a quantile of what pairs cost above their row's cheapest
#: one, and units up to which a pair can cost more than that in the next, finer ones.
FINE, LOW, RANGE = 1e-6, 0.1, 2.0**10
#: Largest number of units, each finer than the last one.
STAGES = 6
#: Rows left without a column get one of those left in parts of so many rows, which bounds the time.
PART = 1000
#: Steps along shortest paths after each of which cycles are looked for.
CIRCLES = 16
#: Largest number of candidates that a point has because other points have chosen it.
MOST = 64


class Auction:
    """An auction: `costs`, prices g, (M,), candidates (rows and columns, (K,)), and owners."""

    def __init__(self, costs: Costs, g: Array, rows: Indices, columns: Indices) -> None:
        self.costs, self.g = costs, g.copy()
        n, m = len(costs.x), len(costs.y)
        self.owner = np.full(m, -1)  #: (M,) row of each column; -1 and from N on are no rows
        self.taken = np.full(n, -1)  #: (N,) column of each row
        self._place = np.full(n, -1)  #: (N,) place of that column among the candidates
        self._pairs, self._cost = np.zeros(0, np.intp), np.zeros(0)
        self.add(rows, columns)

    def add(self, rows: Indices, columns: Indices) -> None:
        """Add candidates."""
        n, m = len(self.taken), len(self.g)
        self._pairs = np.union1d(self._pairs, rows * m + columns)
        rows, columns = np.divmod(self._pairs, m)
        self._cost = cost = self.costs.of_pairs(rows, columns)
        # A line for each row, whose last places can be empty, with costs of inf.
        first = np.searchsorted(rows, np.arange(n + 1))
        shape, place = (n, max(2, int(np.diff(first).max()))), np.arange(len(rows)) - first[rows]
        self._costs, self._columns = np.full(shape, np.inf), np.zeros(shape, np.intp)
        self._costs[rows, place], self._columns[rows, place] = cost, columns
        self._most = float(cost.max()) + 1e-300
        self._find_places(np.flatnonzero(self.taken >= 0))

    def _find_places(self, rows: Indices) -> None:
        is_own = self._columns[rows] == self.taken[rows, None]
        is_own &= np.isfinite(self._costs[rows])
        self._place[rows] = is_own.argmax(axis=1)

    def take(self, columns: Indices) -> None:
        """Take an assignment of candidates: (N,) column of each row."""
        self.taken[:], self.owner[:] = columns, -1
        self.owner[columns] = np.arange(len(columns))
        self._find_places(np.arange(len(columns)))

    @property
    def size(self) -> float:
        """Size of costs and prices, which rounding is relative to."""
        return max(self._most, float(np.abs(self.g).max()))

    def cheapest(self) -> Array:
        """Return each row's least cost less price among its candidates: (N,) array."""
        return (self._costs - self.g[self._columns]).min(axis=1)

    def cost(self) -> float:
        """Return the cost of the assignment."""
        return float(self.costs.of_pairs(np.arange(len(self.taken)), self.taken).sum())

    def bound(self, f: Array) -> float:
        """Return what no assignment is cheaper than, with f_i + g_j at most each pair's cost."""
        # NumPy adds pairwise, in blocks of 128 terms; rows have a sum of D squares.
        m, dimension = self.costs.y.shape
        rounding = (16 + np.log2(m) + dimension) * m * np.finfo(float).eps
        size = max(self.costs.scale, float(np.abs(self.g).max()))
        shift = self.g.max() if self.costs.spare else 0.0
        return float((f + shift).sum() + (self.g - shift).sum()) - rounding * size

    def run(self, increment: float, bids: int) -> None:
        """Let rows bid until few have no column, or bids are used up."""
        open_ = np.flatnonzero(self.taken < 0)
        while len(open_) > OPEN * len(self.taken) and bids > 0:
            bids -= len(open_)
            open_ = self._round(open_, increment)

    def _round(self, rows: Indices, increment: float) -> Indices:
        """Let rows bid together; return those that then have no column."""
        value, line = self._costs[rows] - self.g[self._columns[rows]], np.arange(len(rows))
        place = value.argmin(axis=1)
        best = value[line, place]
        value[line, place] = np.inf
        with np.errstate(invalid="ignore"):  # a row without any candidate does not bid
            # One with a single candidate bids as much as any can.
            lead = np.minimum(value.min(axis=1) - best, self._most)
        wanted = self._columns[rows, place]
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

    def shorten(self, work: int, least: float = 0.0) -> None:
        """Make the assignment the cheapest one of the candidates, nearly, by shortest paths.

        Costs are integers for it, whose sums are exact. Where these are too coarse, prices follow,
        and pairs that are then far from cheapest are left out, so that integers can be finer.
        """
        most = np.inf
        for _ in range(STAGES):
            unit, typical = self._shorten(most)
            fine = max(FINE * typical, ROUNDING * self.size, least / 2)
            if self.costs.spare or unit <= fine:
                return
            # Rounded costs have no negative cycles, so that others have none beyond two units.
            if not self.settle(work, 2 * unit):
                return
            most = RANGE * unit

    def _shorten(self, most: float) -> tuple[float, float]:
        """Use pairs that cost up to `most` above their row's; return their unit and a low cost.

        SciPy first looks for any assignment, which takes long unless it finds this one at once:
        columns are numbered by their rows.
        """
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import min_weight_full_bipartite_matching

        n, m = len(self.taken), len(self.g)
        rows, columns = np.divmod(self._pairs, m)
        cost = self._cost if self.costs.spare else self._cost - self.g[columns]
        cost = cost - np.minimum.reduceat(cost, np.searchsorted(rows, np.arange(n)))[rows]
        if most < np.inf:
            kept = np.flatnonzero((cost <= most) | (columns == self.taken[rows]))
            rows, columns, cost = rows[kept], columns[kept], cost[kept]
        unit = STEPS * float(cost.max())
        order = np.concatenate((self.taken, np.setdiff1d(np.arange(m), self.taken)))
        number = np.empty(m, np.intp)
        number[order] = np.arange(m)
        there = number[columns]
        by_row = np.argsort(rows * m + there)
        first = np.searchsorted(rows, np.arange(n + 1))
        # A stored zero would count as a missing pair.
        steps = np.rint(cost / (unit or 1.0)) + 1
        pairs = csr_array((steps[by_row], there[by_row], first), shape=(n, m))
        self.take(order[min_weight_full_bipartite_matching(pairs)[1]])
        return unit, float(np.quantile(cost, LOW))

    def settle(self, work: int, least: float = 0.0) -> bool:
        """Make the assignment the cheapest one of the candidates; return whether it is proven.

        Prices fall to g_j <= C_ij - C_is(i) + g_s(i) (Bellman, Ford), from where the last ones have
        fallen by more than `least`, over at most `work` lines. Rows that undercut one another in a
        cycle change their columns, which is cheaper (Klein 1967). Columns that no row has belong to
        rows from N on, which cost nothing.
        """
        n, m = len(self.taken), len(self.g)
        free = np.flatnonzero((self.owner < 0) | (self.owner >= n))
        self.owner[free] = np.arange(n, m)
        cause = np.full(m, -1)  # the column whose row has set a column's price last
        changed = np.arange(m)
        least = max(least, ROUNDING * self.size)
        step = 0
        while work > 0:
            step, work = step + 1, work - len(changed)
            rows = self.owner[changed]
            own = rows < n
            last, level = changed[~own], np.inf
            if len(last):
                lowest = last[self.g[last].argmin()]
                level = self.g[lowest]
            changed, rows = changed[own], rows[own]
            base = self.g[changed] - self._costs[rows, self._place[rows]]
            price = self._costs[rows] + base[:, None]
            columns = self._columns[rows]
            line, place = np.nonzero(price < self.g[columns] - least)
            price, columns, causes = price[line, place], columns[line, place], changed[line]
            if np.isfinite(level):
                over = np.flatnonzero(self.g > level + least)
                price = np.append(price, np.full(len(over), level))
                columns = np.append(columns, over)
                causes = np.append(causes, np.full(len(over), lowest))
            if not len(columns):
                return True
            np.minimum.at(self.g, columns, price)
            is_lowest = price == self.g[columns]
            changed = np.unique(columns)
            cause[columns[is_lowest]] = causes[is_lowest]
            if step % CIRCLES == 0 and self._turn(cause):
                cause[:] = -1
                changed = np.arange(m)
        return False

    def _turn(self, cause: Indices) -> bool:
        """Let rows in cycles of causes change their columns; return whether there were such."""
        n, m = len(self.taken), len(cause)
        following = np.where(cause < 0, np.arange(m), cause)
        for _ in range(int(m).bit_length()):
            following = following[following]
        inside = np.unique(following)
        inside = inside[cause[inside] >= 0]
        if not len(inside):
            return False
        # All of a cycle: what is reached from what is surely inside of one.
        members = np.zeros(m, bool)
        while len(inside):
            members[inside] = True
            inside = cause[inside]
            inside = inside[~members[inside]]
        columns = np.flatnonzero(members)
        rows = self.owner[cause[columns]]
        self.owner[columns] = rows
        own = rows < n
        self.taken[rows[own]] = columns[own]
        self._find_places(rows[own])
        return True

    def complete(self) -> None:
        """Give the rows without a column the cheapest ones of what is left, as new candidates."""
        from scipy.optimize import linear_sum_assignment  # takes long to import

        rows, columns = np.flatnonzero(self.taken < 0), np.flatnonzero(self.owner < 0)
        for begin in range(0, len(rows), PART):
            some = rows[begin : begin + PART]
            left = columns[self.owner[columns] < 0]
            # With many more columns than rows, some of them will do.
            left = left[:: max(1, len(left) // (4 * PART))]
            pairs = np.repeat(some, len(left)), np.tile(left, len(some))
            cost = self.costs.of_pairs(*pairs).reshape(len(some), -1)
            own = left[linear_sum_assignment(cost)[1]]
            self.taken[some], self.owner[own] = own, some
        self.add(rows, self.taken[rows])


def few(lines: Indices, value: Array, count: int = MOST) -> Indices:
    """Return which pairs are among the `count` of the least value of their lines."""
    order = np.lexsort((value, lines))
    there = lines[order]
    first = np.searchsorted(there, there)
    return order[np.arange(len(order)) - first < count]
