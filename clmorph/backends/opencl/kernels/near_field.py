"""Find the pairs of tiles that contribute to sums, and bound the share of all others."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import LARGEST_SHARE, SENTINEL
from clmorph.backends.opencl.kernels.candidates import candidates, kept_shares
from clmorph.backends.opencl.kernels.clouds import Cloud, unsort
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, Exponents, RowLoop
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs
from clmorph.backends.records import Float64, NearPairs

#: Share of the budget that is available for the tiles that bounds alone exclude.
UNSEEN = 0.5
#: The search for tiles with small terms only ends if it leaves more than this share of the tiles.
WORTHWHILE = 0.5
#: Rounding errors of a measured share in float32: a factor, and an error in log2 for each unit of
#: the exponent's size.
MARGIN, EXPONENT_ERROR = 1.05, 2.0**-22


class _Clouds(NamedTuple):
    """Two clouds, the terms of their exponents, and an estimate of log2 of the rows' sums."""

    rows: Cloud
    columns: Cloud
    exponents: Exponents
    guess: Float64


class NearField:
    """Finds the pairs of tiles that contribute to the rows' sums.

    Parameters
    ----------
    loop : RowLoop
    """

    def __init__(self, loop: RowLoop) -> None:
        self._loop = loop

    def near_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that contribute to the rows' sums.

        Bounds over pairs of tiles exclude most pairs. The others are summed once, and a tile whose
        measured share is small in all rows is excluded too.
        """
        k, tile, n = LOG2_E / epsilon, self._loop.constants.tile, len(rows)
        values = (potential[columns.order] - columns.offsets) * k + columns.log2_weights
        guess = -k * (softmin[rows.order] - rows.offsets)
        values = np.maximum(values, SENTINEL)
        logits, tile_max = self._loop.column_logits(columns, potential, k)
        # The level of each row tile is set by the pairs that a launch visits.
        exponents = Exponents(logits, tile_max, np.zeros(len(rows.centers)), k)
        found, skipped = np.empty(rows.stride), np.empty(len(rows.centers))
        kept: list[TilePairs] = []
        clouds = _Clouds(rows, columns, exponents, guess)
        worthwhile = True
        for part, pairs, unseen in candidates(
            rows, columns, guess, values, k, 0.5 * UNSEEN * budget
        ):
            if worthwhile:
                before = len(pairs.tiles)
                pairs, more = self._without_small(clouds, pairs, part, 0.5 * UNSEEN * budget)
                unseen = unseen + more
                worthwhile = len(pairs.tiles) <= WORTHWHILE * before
            section = slice(part.start * tile, part.stop * tile)
            sums, shares = self._measured(clouds, pairs, part)
            found[section] = sums
            # The largest and smallest difference of guess and sum (log2) in each row tile.
            off = np.full((2, len(sums)), [[-np.inf], [np.inf]])
            off[:, : n - section.start] = guess[section] - sums[: n - section.start]
            above, below = off.reshape(2, len(part), tile)
            off_by = EXPONENT_ERROR * k * _largest_cost(rows, columns, pairs, part)
            factor = MARGIN * np.exp2(np.clip(above.max(axis=1) + off_by, -900.0, 600.0))
            starts = pairs.starts[part.start : part.stop + 1]
            shares *= np.repeat(factor, np.diff(starts))
            # If the guess is far below the sum of a row, shares were clipped, so all are kept.
            shares[np.repeat(below.min(axis=1) < -LARGEST_SHARE, np.diff(starts))] = 1.0
            keep, left = kept_shares(starts, shares, (1 - UNSEEN) * budget)
            left += factor * unseen
            with np.errstate(divide="ignore"):
                left = np.where(left < 1.0, left / np.maximum(1.0 - left, 0.0), np.inf)
            skipped[part.start : part.stop] = left
            lengths = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
            kept.append(TilePairs(lengths, pairs.tiles[keep], pairs.distances[keep]))
        lengths, tiles, distances = (np.concatenate(arrays) for arrays in zip(*kept, strict=True))
        starts = np.concatenate(([0], np.cumsum(lengths)))
        listed = TilePairs(starts, tiles, distances)
        return NearPairs(
            listed,
            unsort(rows, -found[:n] / k + rows.offsets),
            unsort(rows, np.repeat(skipped, tile)[:n]),
            len(tiles) * tile**2,
            int(lengths.max()) * tile,
            _largest_cost(rows, columns, listed, range(len(rows.centers))),
        )

    def _measured(self, clouds: _Clouds, pairs: TilePairs, part: range) -> tuple[Float64, Float64]:
        """Return log2 of the sums of a part's rows, and each pair's largest share by the guess."""
        sums, shares = np.empty(len(part) * self._loop.constants.tile), np.empty(len(pairs.tiles))
        for own, section, constants, out in self._looks("measure_tiles", 2, clouds, pairs, part):
            with np.errstate(divide="ignore"):
                sums[own] = out[0] + np.log2(out[1].astype(float)) + constants
            shares[section] = out[2]
        return sums, shares

    def _without_small(
        self, clouds: _Clouds, pairs: TilePairs, part: range, budget: float
    ) -> tuple[TilePairs, Float64]:
        """Exclude tiles with small terms only; return the other tiles and the excluded share."""
        largest = np.empty(len(pairs.tiles))
        for _, section, _, out in self._looks("largest_shares", 0, clouds, pairs, part):
            largest[section] = out[0]
        shares = MARGIN * self._loop.constants.tile * np.exp2(np.minimum(largest, LARGEST_SHARE))
        starts = pairs.starts[part.start : part.stop + 1]
        keep, left = kept_shares(starts, shares, budget)
        lengths = np.zeros(len(pairs.starts) - 1, np.int64)
        lengths[part.start : part.stop] = np.add.reduceat(keep, starts[:-1], dtype=np.int64)
        starts = np.concatenate(([0], np.cumsum(lengths)))
        return TilePairs(starts, pairs.tiles[keep], pairs.distances[keep]), left

    def _looks(
        self, name: str, of_rows: int, clouds: _Clouds, pairs: TilePairs, part: range
    ) -> Iterator[tuple[slice, slice, Float64, list[NDArray[np.float32]]]]:
        """Run a kernel over the pairs of a part's rows, in launches.

        For every launch, the method yields the indices of its rows in the part, the indices of its
        pairs, the offsets of its rows, and the kernel's results: `of_rows` numbers for each row,
        and one number for each pair.
        """
        (rows, columns, exponents, guess), loop, n = clouds, self._loop, len(clouds.rows)
        tile_max, row_level, k = exponents.tile_max, exponents.row_level, exponents.k
        kernel, tile = loop.kernel("near_field.cl", name, rows, listed=True), loop.constants.tile
        groups = tile // (loop.constants.group * loop.constants.width)
        for launch in loop.parts(kernel, rows, columns, pairs=pairs, within=part):
            starts, _, levels = pairs.levels(launch, tile_max, k)
            row_level[launch.start : launch.stop] = np.maximum.reduceat(levels, starts[:-1])
            section = slice(launch.start * tile, min(n, launch.stop * tile))
            constants = np.repeat(row_level[launch.start : launch.stop], tile)
            constants[: section.stop - section.start] -= k * (
                rows.own_costs[section] - rows.offsets[section]
            )
            offsets = np.full(len(constants), SENTINEL)
            offsets[: section.stop - section.start] = -guess[section]
            offset_buffer = loop.work.buffer(np.maximum(offsets + constants, SENTINEL))
            out = [np.empty(len(constants), np.float32) for _ in range(of_rows)]
            out.append(np.empty((groups, len(levels)), np.float32))
            buffers = [loop.work.empty(values.nbytes) for values in out]
            loop.launch(
                kernel, rows, columns, exponents, launch, offset_buffer, *buffers, pairs=pairs,
                results=tuple(zip(out, buffers, strict=True)),
            )  # fmt: skip
            out[-1] = out[-1].max(axis=0)
            own = (launch.start - part.start) * tile
            first = int(pairs.starts[launch.start])
            yield (
                slice(own, own + len(constants)), slice(first, first + len(levels)), constants, out
            )  # fmt: skip


def _largest_cost(rows: Cloud, columns: Cloud, pairs: TilePairs, part: range) -> float:
    """Return a bound of the cost of all pairs of points in the pairs of tiles of a part."""
    starts = pairs.starts[part.start : part.stop + 1]
    own = np.repeat(rows.radii[part.start : part.stop], np.diff(starts))
    farthest = np.sqrt(2 * pairs.distances) + own + columns.radii[pairs.tiles]
    return 0.5 * float(farthest.max(initial=0.0)) ** 2
