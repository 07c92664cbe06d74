"""Boxes of columns, by which ``mark_columns`` bounds many columns of a tile at once."""

from typing import NamedTuple

import numpy as np
import pyopencl as cl

from clmorph._shared.boxes import boxes_of_runs
from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM
from clmorph.backends.opencl.kernels.clouds import Cloud, pad
from clmorph.backends.opencl.kernels.row_loop import RowLoop
from clmorph.backends.records import Float64


class ColumnBoxes(NamedTuple):
    """What ``mark_columns`` knows of boxes, `width` a tile; empty where it forms no bounds."""

    lows: cl.Buffer  #: (D, tiles * lanes) least coordinates, less the tile's center
    highs: cl.Buffer  #: (D, tiles * lanes) largest ones
    most: cl.Buffer  #: (tiles * lanes,) largest logit without its linear part
    slopes: cl.Buffer  #: (tiles, D) slopes of the linear part, in units of k
    sides: cl.Buffer  #: (tiles, D) half sides of the tiles


def column_boxes(
    loop: RowLoop, columns: Cloud, values: Float64, tile_max: Float64, k: float
) -> ColumnBoxes:
    """Divide the columns of each tile into boxes, by their k g_j + log2 b_j and its largest."""
    work, constants = loop.work, loop.constants
    if not constants.bounds_first or columns.centers.shape[1] >= SLICED_FROM:
        return ColumnBoxes(*(work.empty(4) for _ in ColumnBoxes._fields))
    shifts = columns.shifts
    tiles, _, dimension = shifts.shape
    logits = pad(values, columns.stride, SENTINEL).reshape(tiles, -1)
    present = logits > 0.5 * SENTINEL
    slopes = columns.fits.slopes(np.where(present, logits / k, 0.0), present)
    rest = logits - tile_max[:, None] - k * np.einsum("ntd,nd->nt", shifts, slopes)
    rest = np.where(present, rest, SENTINEL).reshape(tiles, constants.width, -1).max(axis=2)
    points = shifts.reshape(-1, dimension)
    lows, highs = boxes_of_runs(
        points, np.arange(0, len(points), constants.tile // constants.width)
    )
    return ColumnBoxes(
        work.buffer(lows.T), work.buffer(highs.T), work.buffer(rest), work.buffer(slopes),
        work.buffer(columns.half_sides),
    )  # fmt: skip
