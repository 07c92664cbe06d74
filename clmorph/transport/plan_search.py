"""Candidates and bounds of an assignment of many points, from entropic plans on the device.

Where all pairs are too many for a search on the host, candidates are drawn from plans of several
temperatures, and one sum over all pairs bounds each row's least cost less price from below.
"""

from __future__ import annotations

import numpy as np

from clmorph._shared.typing import Array
from clmorph.backends.interface import Operations
from clmorph.transport._solver.problem import upload_both
from clmorph.transport._solver.softmin import MANY_PAIRS, Softmin, many_pairs
from clmorph.transport.pair_costs import Costs, Indices

#: Draws of candidates of each point at each of some temperatures, in units of epsilon: hot ones
#: reach far, cold ones are the cheapest pairs.
DRAWS, TEMPERATURES = 16, (4.0, 1.0, 0.25)
#: Nats by which pairs left out may lower the logarithm of a sum.
TRUNCATION = 1e-2
#: Share of the accuracy that a bound may lose.
LOST = 1 / 8


def plan_search(
    costs: Costs, epsilon: float, gap: float, operations: Operations, seed: int
) -> PlanSearch | None:
    """Return a search on the device if pairs are many and its bounds can prove the gap."""
    if gap <= 0 or costs.spare or len(costs.x) ** 2 < MANY_PAIRS:
        return None
    return PlanSearch(costs, epsilon, operations, seed)


class PlanSearch:
    """Searches the pairs of N rows and N columns of equal masses at a temperature epsilon."""

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
