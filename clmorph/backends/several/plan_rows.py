"""Rows of plans on several devices: counted, returned, or stored on the devices."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.interface import Operations
from clmorph.backends.records import Float64, NearPairs, PlanRows, StoredPairs
from clmorph.backends.several.clouds import Cloud, Part
from clmorph.backends.several.team import Team, in_order

#: The number of pairs that are moved at a time, so that their indices take little memory.
MOVED_PAIRS = 1 << 22


class _Stored(NamedTuple):
    """The pairs of a plan, each on the device of its row."""

    rows: Cloud
    pairs: list[StoredPairs]  #: of each part of the rows


class PlanRowsOfParts:
    """Finds the kept pairs of a plan, each device those of its rows."""

    def __init__(self, team: Team) -> None:
        self._team = team

    def count_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
    ) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps."""

        def of_part(member: Operations, part: Part, place: int) -> NDArray[np.int64]:
            return member.count_plan_rows(
                part.cloud, columns.whole[part.member], f[part.rows], g, epsilon,
                row_thresholds[part.rows], column_thresholds, precise,
            )  # fmt: skip

        return in_order(rows, self._team.over_parts(rows, of_part))

    def plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
        counts: NDArray[np.int64] | None = None,
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold, in the caller's order."""

        def of_part(member: Operations, part: Part, place: int) -> PlanRows:
            return member.plan_rows(
                part.cloud, columns.whole[part.member], f[part.rows], g, epsilon,
                row_thresholds[part.rows], column_thresholds, precise,
                None if counts is None else counts[part.rows],
            )  # fmt: skip

        found = self._team.over_parts(rows, of_part)
        if len(found) == 1:
            return found[0][1]
        return _joined_rows(rows.size, [(part.rows, own) for part, own in found])

    def store_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Store log pi_ij of the pairs above a threshold, each pair on the device of its row.

        `near` is ignored, and no pair above a threshold is left out: a device has the list of its
        rows, but not the columns' list for them.
        """
        counts = self.count_plan_rows(
            rows, columns, f, g, epsilon, row_thresholds, column_thresholds
        )
        if counts.sum() > max_pairs:
            return None

        def of_part(member: Operations, part: Part, place: int) -> StoredPairs | None:
            return member.store_pairs(
                part.cloud, columns.whole[part.member], f[part.rows], g, epsilon,
                row_thresholds[part.rows], column_thresholds, max_pairs,
            )  # fmt: skip

        found = [own for _, own in self._team.over_parts(rows, of_part)]
        stored = [own for own in found if own is not None]
        n_pairs = sum(own.n_pairs for own in stored)
        if len(stored) < len(found) or n_pairs > max_pairs:
            return None
        orders = np.arange(len(f)), np.arange(len(g))
        return StoredPairs(_Stored(rows, stored), n_pairs, orders)

    def sum_stored(
        self, stored: StoredPairs, changes: Float64, by_column: bool, ordered: bool = False
    ) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over the stored pairs of every row, or column."""
        rows, pairs = stored.pairs

        def of_part(member: Operations, part: Part, place: int) -> Float64:
            own = changes[part.rows] if by_column else changes
            return member.sum_stored(pairs[place], own, by_column)

        found = self._team.over_parts(rows, of_part)
        if by_column:
            return np.logaddexp.reduce([logarithms for _, logarithms in found], axis=0)
        return in_order(rows, found)


def _joined_rows(count: int, parts: Sequence[tuple[NDArray[np.intp], PlanRows]]) -> PlanRows:
    """Return plan rows in the caller's order; each of `count` rows is in one part."""
    lengths = np.zeros(count, np.int64)
    for rows, pairs in parts:
        lengths[rows] = np.diff(pairs.indptr)
    indptr = np.concatenate(([0], np.cumsum(lengths)))
    indices = np.empty(indptr[-1], np.int32)
    mass = np.empty(indptr[-1])
    for rows, pairs in parts:
        first = 0
        while first < len(rows):
            end = int(np.searchsorted(pairs.indptr, pairs.indptr[first] + MOVED_PAIRS, "right"))
            block = slice(first, min(len(rows), max(first + 1, end - 1)))
            own = slice(pairs.indptr[block.start], pairs.indptr[block.stop])
            moves = indptr[rows[block]] - pairs.indptr[block]
            places = np.repeat(moves, lengths[rows[block]]) + np.arange(own.start, own.stop)
            indices[places], mass[places] = pairs.indices[own], pairs.mass[own]
            first = block.stop
    return PlanRows(indptr, indices, mass)
