"""The host side of ``cl_kernels/row_loop.cl``, which every reduction over rows uses."""

import weakref
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM, BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels import loop_limits
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Results, Workspace
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs, center_costs
from clmorph.backends.records import Float64

#: The factor that converts natural logarithms to base 2.
LOG2_E = float(np.log2(np.e))
#: The largest number of kept pairs that one launch writes (12 bytes each on the device): the first
#: access to memory takes longer than writing the pairs.
FILL_PAIRS = 1 << 22
#: The largest number of levels between tiles that are kept from their maxima to the launch, in
#: place of being formed again.
KEPT_LEVELS = 1 << 18
#: From this number of levels on, the device forms them, if it has float64.
DEVICE_LEVELS = 1 << 13


class Exponents(NamedTuple):
    """The terms of the exponents e_ij of two clouds, see ``cl_kernels/row_loop.cl``."""

    rows: Cloud
    columns: Cloud
    precise: bool  #: whether numbers on the device have their rounding errors beside them
    pairs: TilePairs | None  #: the pairs of tiles that are summed; None for all
    column_logits: cl.Buffer  #: (2, stride) float32: k g + log2 b, less its tile's largest
    tile_max: Float64  #: (column tiles,) the largest k g + log2 b of each tile
    row_level: Float64  #: (row tiles,) the level that the rows' exponents are measured from
    k: float  #: log2(e) / epsilon
    #: (row tiles, column tiles), where few enough to be kept; on the device those of listed pairs
    levels: Float64 | cl.MemoryObject | None = None
    tile_max_buffer: cl.Buffer | None = None  #: where the device forms levels: `tile_max`


class RowLoop:
    """Runs kernels that loop over the columns of every row, in launches of a bounded duration."""

    def __init__(self, work: Workspace, constants: BuildConstants, programs: Programs) -> None:
        self.work, self.constants, self.programs = work, constants, programs
        self._budgets: dict[int, LaunchBudget] = {}
        self._kernels: dict[Variant, dict[str, cl.Kernel]] = {}
        self._shapes: dict[int, tuple[int, tuple[int, int]]] = {}  # rows of an item, local size
        self._lists: weakref.WeakKeyDictionary[TilePairs, tuple[cl.Buffer, cl.Buffer]]
        self._lists = weakref.WeakKeyDictionary()
        self.device_levels = DEVICE_LEVELS

    def kernel(
        self,
        file: str,
        name: str,
        rows: Cloud,
        precise: bool = False,
        listed: bool = False,
        bounded: int = 0,
        masked: bool = False,
    ) -> cl.Kernel:
        """Return a kernel for the dimension of some rows; its file is built at the first call."""
        dimension = min(rows.centers.shape[1], SLICED_FROM)
        variant = Variant(file, dimension, precise, listed, bounded, masked)
        if variant not in self._kernels:
            self._kernels[variant] = self.programs.kernels(variant)
            blocks = self.constants.blocks if variant.in_blocks else 1
            stacks = variant.stacks(self.constants)
            shape = self.constants.group // stacks, stacks
            for built in self._kernels[variant].values():
                self._shapes[built.int_ptr] = self.constants.width * stacks * blocks, shape
        return self._kernels[variant][name]

    def exponents(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool,
        pairs: TilePairs | None = None,
        within: range | None = None,
    ) -> Exponents:
        """Return the terms of exponents of the row tiles `within`, over all or listed pairs."""
        found = self.unleveled_exponents(rows, columns, potential, epsilon, precise)
        row_level = found.row_level
        within = within or range(len(row_level))
        if pairs is not None:
            return self.with_levels(found, pairs, within)
        step = max(1, (1 << 22) // max(1, len(found.tile_max)))
        for first in range(within.start, within.stop, step):
            section = slice(first, min(first + step, within.stop))
            levels = _levels(found, section)
            row_level[section] = levels.max(axis=1)
            if levels.size <= KEPT_LEVELS and len(levels) == len(row_level):
                found = found._replace(levels=levels)
        return found

    def unleveled_exponents(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float, precise: bool
    ) -> Exponents:
        """Return the terms of the rows' exponents without levels, for `with_levels`."""
        k = LOG2_E / epsilon
        values = (potential[columns.order] - columns.offsets) * k + columns.log2_weights
        values = pad(values, columns.stride, SENTINEL).reshape(-1, self.constants.tile)
        values[values < 0.5 * SENTINEL] = SENTINEL
        tile_max = values.max(axis=1)
        logits = np.where(values == SENTINEL, SENTINEL, values - tile_max[:, None])
        on_device = self.work.buffer(split(logits) if precise else logits)
        row_level = np.zeros(len(rows.centers))
        return Exponents(rows, columns, precise, None, on_device, tile_max, row_level, k)

    def dense_exponents(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float, precise: bool
    ) -> Exponents:
        """Return the terms for a dense sum, whose levels `launch` may have the device form."""
        many = len(rows.centers) * len(columns.centers) >= self.device_levels
        if not many or not self._forms_levels():
            return self.exponents(rows, columns, potential, epsilon, precise)
        found = self.unleveled_exponents(rows, columns, potential, epsilon, precise)
        return found._replace(tile_max_buffer=self.work.buffer(found.tile_max, np.float64))

    def _forms_levels(self) -> bool:
        """Return whether the device has the kernel that forms levels; build it if not yet."""
        instead = "levels between tiles are formed on the host, which is slower"
        return self.programs.has(Variant("tile_levels.cl"), instead)

    def _levels_on_device(self, exponents: Exponents, part: range) -> cl.MemoryObject:
        """Form the levels of some row tiles on the device, and read the row levels."""
        rows, columns, precise, pairs, *_ = exponents
        n, n_columns, planes = len(part), len(columns.centers), 2 if precise else 1
        n_listed, lists = 0, (columns.centers_buffer, columns.centers_buffer)
        if pairs is not None:
            n_listed, lists = len(pairs.tiles), self._lists_on_device(pairs)
        levels = self.work.empty(4 * planes * (n_listed or n * n_columns))
        row_level = self.work.empty(8 * n)
        numbers = part.start, n_columns, n_listed, rows.centers.shape[1], planes
        self.work.launch(
            self.programs.kernel("tile_levels.cl", "tile_levels"),
            (n * self.constants.group,), (self.constants.group,), *map(np.uint32, numbers),
            np.float64(exponents.k), rows.centers_buffer, columns.centers_buffer,
            exponents.tile_max_buffer, *lists, row_level, levels,
            results=((exponents.row_level[part.start : part.stop], row_level),),
        )  # fmt: skip
        return levels

    def _lists_on_device(self, pairs: TilePairs) -> tuple[cl.Buffer, cl.Buffer]:
        """Return where lists begin, and the listed tiles, which are uploaded once."""
        if pairs not in self._lists:
            self._lists[pairs] = (
                self.work.buffer(pairs.starts, np.uint32), self.work.buffer(pairs.tiles, np.uint32)
            )  # fmt: skip
        return self._lists[pairs]

    def with_levels(self, exponents: Exponents, pairs: TilePairs, part: range) -> Exponents:
        """Form the levels of a part's listed pairs; that of a row tile is its pairs' largest."""
        exponents = exponents._replace(pairs=pairs)
        if len(pairs.tiles) >= self.device_levels and self._forms_levels():
            tile_max = self.work.buffer(exponents.tile_max, np.float64)
            terms = exponents._replace(tile_max_buffer=tile_max)
            return exponents._replace(levels=self._levels_on_device(terms, part))
        starts, section = pairs.starts[part.start : part.stop + 1], pairs.section(part)
        levels = np.zeros(len(pairs.tiles))
        own = exponents.tile_max[pairs.tiles[section]] - exponents.k * pairs.distances[section]
        largest = np.maximum.reduceat(own, starts[:-1] - starts[0])
        exponents.row_level[part.start : part.stop] = largest
        levels[section] = np.maximum(own - np.repeat(largest, np.diff(starts)), SENTINEL)
        planes = split(levels) if exponents.precise else levels
        return exponents._replace(levels=self.work.buffer(planes))

    def row_offsets(self, exponents: Exponents) -> Float64:
        """Return the term missing in e_ij, the level of the row's tile less its own cost: (N,)."""
        rows = exponents.rows
        levels = np.repeat(exponents.row_level, self.constants.tile)[: len(rows)]
        return levels - exponents.k * rows.own_costs

    def column_shares(
        self, rows: Cloud, columns: Cloud, pairs: TilePairs | None = None, stacks: int = 1
    ) -> int:
        """Return the number of work-groups along the columns, more than 1 if rows are few."""
        least = self._windows(columns, pairs)
        if self.constants.width > 1:
            return least
        groups = max(1, rows.stride // self.constants.group)
        wanted = -(-8 * self.work.device.max_compute_units // groups)
        return max(least, min(wanted, -(-len(columns.centers) // stacks), 64))

    def _windows(self, columns: Cloud, pairs: TilePairs | None) -> int:
        """Return in how many launches the columns of a row are taken: 1 if loops may be long."""
        most = len(columns.centers) if pairs is None else int(np.diff(pairs.starts).max())
        at_once = loop_limits.column_tiles(self.constants, columns.centers.shape[1])
        return max(1, -(-most // at_once))

    def launch_size(
        self, kernel: cl.Kernel, n_rows: int, shares: int
    ) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the global and the local size of a launch of a kernel over some rows."""
        rows_of_item, local = self._shapes[kernel.int_ptr]
        return (n_rows // rows_of_item, shares * local[1]), local

    def budget(self, kernel: cl.Kernel) -> LaunchBudget:
        """Return the budget of launches of this kernel, because kernels differ in time per pair."""
        return self._budgets.setdefault(kernel.int_ptr, LaunchBudget())

    def parts(
        self,
        kernel: cl.Kernel,
        exponents: Exponents,
        counts: NDArray[np.int64] | None = None,
        within: range | None = None,
        shares: int | None = None,
    ) -> Iterator[range]:
        """Split row tiles by time, and by the pairs that a kernel writes (`counts`, (stride,))."""
        rows, columns, _, pairs, *_ = exponents
        n_tiles, tile = len(rows.centers), self.constants.tile
        first, end = (0, n_tiles) if within is None else (within.start, within.stop)
        windows = 1 if shares else self._windows(columns, pairs)
        kept = None
        if counts is not None:
            kept = counts.reshape(n_tiles, -1).sum(axis=1, dtype=np.int64).cumsum()
        while first < end:
            budget = self.budget(kernel).pairs() * windows // work_of_pair(rows)
            if pairs is None:
                stop = first + max(1, int(budget // (tile * columns.stride)))
            else:
                done = pairs.done(tile)
                stop = int(np.searchsorted(done, done[first] + budget, side="right")) - 1
            stop = min(end, max(stop, first + 1))
            if kept is not None:
                before = kept[first - 1] if first else 0
                stop = min(stop, int(np.searchsorted(kept, before + FILL_PAIRS, side="right")))
                stop = max(stop, first + 1)
            yield range(first, stop)
            first = stop

    def masked_parts(
        self, kernel: cl.Kernel, exponents: Exponents, shares: int | None = None
    ) -> Iterator[tuple[range, list[Any]]]:
        """Yield the row tiles of each launch as `parts`, and the kernel's MASK_ARGUMENTS."""
        pairs = exponents.pairs
        if pairs is None or pairs.masks is None:
            for part in self.parts(kernel, exponents, shares=shares):
                yield part, []
            return
        for within, masks in pairs.masks:
            for part in self.parts(kernel, exponents, within=within, shares=shares):
                yield part, [masks, np.uint32(pairs.starts[within.start])]

    def launch(
        self,
        kernel: cl.Kernel,
        exponents: Exponents,
        part: range,
        *arguments: Any,
        shares: int | None = None,
        results: Results = (),
    ) -> None:
        """Run a kernel over some row tiles; its own arguments follow those of the row loop."""
        # `shares` are work-groups along the columns, of a kernel that has such (`column_shares`).
        rows, columns, precise, pairs, *_, known, on_device = exponents
        section = slice(part.start, part.stop)
        n_rows = len(part) * self.constants.tile
        lists: tuple[Any, ...] = ()
        work = n_rows * columns.stride
        if on_device is not None:
            levels = self._levels_on_device(exponents, part)
        elif pairs is None:
            known = _levels(exponents, section) if known is None else known[section]
            above = known - exponents.row_level[section, None]
            planes: NDArray[Any] = np.maximum(above, SENTINEL)
            levels = self.work.buffer(np.swapaxes(split(planes), 0, 1) if precise else planes)
        else:
            levels, done = known, pairs.done(self.constants.tile)
            work = int(done[part.stop] - done[part.start])
            lists = np.uint32(len(pairs.tiles)), *self._lists_on_device(pairs)
        windows = 1 if shares else self._windows(columns, pairs)
        at_once = len(columns.centers)
        if windows > 1:
            at_once = loop_limits.column_tiles(self.constants, columns.centers.shape[1])
        for window in range(windows):
            with self.budget(kernel).measure(work // windows * work_of_pair(rows)):
                self.work.launch(
                    kernel, *self.launch_size(kernel, n_rows, shares or 1),
                    np.uint32(part.start * self.constants.tile), np.uint32(rows.stride),
                    np.uint32(columns.stride), np.uint32(len(columns.centers)),
                    np.uint32(window * at_once), np.uint32(at_once),
                    *split(np.asarray(exponents.k)), *dimension_argument(rows),
                    rows.shifts_buffer, rows.centers_buffer, columns.shifts_buffer,
                    columns.centers_buffer, exponents.column_logits, levels, *lists, *arguments,
                    results=results if window + 1 == windows else (),
                )  # fmt: skip


def work_of_pair(cloud: Cloud) -> int:
    """Return about how many times as long a pair takes as one with few coordinates."""
    return max(1, int(cloud.centers.shape[1]) // SLICED_FROM)


def dimension_argument(cloud: Cloud) -> tuple[np.uint32, ...]:
    """Return the kernels' DIMENSION_ARGUMENT for points of a cloud."""
    dimension = cloud.centers.shape[1]
    return (np.uint32(dimension),) if dimension >= SLICED_FROM else ()


def _levels(terms: Exponents, section: slice) -> Float64:
    """Return the log2-kernel of tile centers plus the columns' largest logits: (rows, columns)."""
    costs = center_costs(terms.rows.centers[section, None], terms.columns.centers)
    return terms.tile_max - terms.k * costs
