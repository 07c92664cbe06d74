"""Bounds of the shares of pairs of tiles, by ``cl_kernels/near_field.cl``."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.opencl.kernels.clouds import WIDTH_OF_GROUPS, Cloud
from clmorph.backends.opencl.kernels.row_loop import RowLoop, dimension_argument
from clmorph.backends.opencl.kernels.tile_pairs import TileBounds

#: The largest number of bounds that one launch writes, unless a single block has more.
LAUNCH_BOUNDS = 1 << 21
#: The number of work-items along a list is a multiple of this, so that work-groups are not small.
ENTRIES = 32


class TileLists(NamedTuple):
    """The column tiles to bound for consecutive blocks of `WIDTH_OF_GROUPS` row tiles."""

    #: The number of the first block.
    first: int
    #: Numbers of column tiles, ascending in each list: (n,) array.
    numbers: NDArray[np.uint32]
    #: (blocks,) The part of `numbers` that is a block's list; later ones do not begin earlier.
    begins: NDArray[np.int64]
    lengths: NDArray[np.int64]


class BoundTiles(NamedTuple):
    """Bounds of consecutive row tiles."""

    #: The row tiles.
    part: range
    #: Index at which the bounds of each row tile begin: (row tiles + 1,) array.
    starts: NDArray[np.int64]
    #: Base-2 logarithms, rounded up: (n,) array.
    values: NDArray[np.float32]
    #: Numbers of column tiles: the lists of these row tiles.
    numbers: NDArray[np.uint32]
    #: (row tiles,) `starts` less the index in `numbers` at which the row tile's list begins.
    list_offsets: NDArray[np.int64]


def all_tiles(n_rows: int, n_columns: int) -> TileLists:
    """Return lists of all column tiles."""
    blocks = -(-n_rows // WIDTH_OF_GROUPS)
    return TileLists(
        0,
        np.arange(n_columns, dtype=np.uint32),
        np.zeros(blocks, np.int64),
        np.full(blocks, n_columns, np.int64),
    )


def tile_bounds(
    loop: RowLoop,
    cloud: Cloud,
    sides: list[tuple[TileBounds, TileBounds]],
    k: float,
    lists: Iterable[TileLists],
) -> Iterator[BoundTiles]:
    """Yield B of `kernels.tile_pairs` of listed pairs, each the largest over the sides."""
    n_rows, n_columns = (len(terms.level) for terms in sides[0])
    work, width = loop.work, loop.constants.width
    kernel = loop.kernel("near_field.cl", "bound_tiles", cloud, listed=True)
    budget = loop.budget(kernel)

    def packed(of: TileBounds) -> NDArray[np.float32]:
        return np.column_stack((of.centers, of.sides, of.slopes, of.level))

    buffers = [
        (work.buffer(packed(rows)), work.buffer(packed(columns).T)) for rows, columns in sides
    ]
    for of_blocks, numbers, begins, lengths in lists:
        rows_of = np.full(len(lengths), WIDTH_OF_GROUPS)
        rows_of[-1] = min(
            WIDTH_OF_GROUPS, n_rows - (of_blocks + len(lengths) - 1) * WIDTH_OF_GROUPS
        )
        done = np.concatenate(([0], np.cumsum(rows_of * lengths)))
        first = 0
        while first < len(lengths):
            most = min(LAUNCH_BOUNDS, budget.pairs())
            stop = int(np.searchsorted(done, done[first] + most, side="right")) - 1
            stop = max(stop, first + 1)
            own = slice(first, stop)
            listed = slice(int(begins[first]), int((begins[own] + lengths[own]).max()))
            table = np.stack(
                (begins[own] - listed.start, lengths[own], done[own] - done[first]), axis=1
            )
            block = of_blocks + first
            count = int(done[stop] - done[first])
            # Whole numbers of work-groups: the kernel leaves out what is beyond a list.
            size = ENTRIES * -(-int(lengths[own].max()) // (ENTRIES * width)), len(table)
            on_device = work.buffer(table, np.uint32), work.buffer(numbers[listed], np.uint32)
            out, found = work.empty(4 * count), np.empty((len(sides), count), np.float32)
            for side, values in zip(buffers, found, strict=True):
                with budget.measure(count):
                    work.launch(
                        kernel, size, None,
                        *map(np.uint32, (n_rows, n_columns, WIDTH_OF_GROUPS, block)),
                        np.float32(k), *dimension_argument(cloud), *side, *on_device, out,
                        results=((values, out),),
                    )  # fmt: skip
            starts = np.concatenate(([0], np.cumsum(np.repeat(lengths[own], rows_of[own]))))
            begin = block * WIDTH_OF_GROUPS
            yield BoundTiles(
                range(begin, begin + len(starts) - 1), starts, found.max(axis=0),
                numbers[listed],
                starts[:-1] - np.repeat(table[:, 0], rows_of[own]),
            )  # fmt: skip
            first = stop
