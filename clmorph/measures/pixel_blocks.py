"""Square blocks of pixels: an image at the resolution at which its transport is solved."""

from dataclasses import dataclass

import numpy as np

from clmorph._shared.typing import Array, IntArray
from clmorph.errors import InputError
from clmorph.measures.cluster import means_over
from clmorph.measures.measure import Measure


@dataclass(frozen=True, eq=False)
class PixelBlocks:
    """An image's pixels, gathered into square blocks."""

    #: The pixels.
    fine: Measure
    #: The blocks: each has the mass of its pixels, and their mean position and mean color, weighted
    #: by mass if there is some.
    coarse: Measure
    #: Pixels along a block, a power of two; there can be fewer at the right and lower border.
    side: int

    @property
    def owners(self) -> IntArray:
        """(N,) index of the block of each pixel."""
        return _owners(self.fine.shape, self.side)

    @property
    def heaviest(self) -> IntArray:
        """(blocks,) index of the pixel with the largest mass in each block."""
        order = np.lexsort((self.fine.weights, self.owners))
        last = np.cumsum(np.bincount(self.owners, minlength=len(self.coarse))) - 1
        return np.asarray(order[last], np.int64)

    def share_out(self, total: Array) -> Array:
        """Divide a total of each block, (blocks,), among its pixels by their mass: (N,) array."""
        weights = self.coarse.weights[self.owners]
        return np.divide(
            total[self.owners] * self.fine.weights, weights,
            out=np.zeros(len(self.fine)), where=weights > 0,
        )  # fmt: skip


def block_side(shape: tuple[int, int], size: int | None) -> int:
    """Return the least power of two of pixels that gives at most `size` blocks a side."""
    side = 1
    while size is not None and -(-max(shape) // side) > size:
        side *= 2
    return side


def solved_size(shape: tuple[int, int], size: int | None) -> int:
    """Return the actual number of blocks along the longer side, which can be half of `size`."""
    return -(-max(shape) // block_side(shape, size))


def group_pixels(measure: Measure, size: int | None) -> PixelBlocks:
    """Gather a lifted image's pixels into square blocks, at most `size` along the longer side."""
    side = block_side(measure.shape, size)
    if side == 1:
        return PixelBlocks(measure, measure, 1)
    if measure.has_metric_map:
        raise InputError(
            "solve_size: blocks of pixels need one color metric, but each pixel has its own here; "
            "give solve_size=None, or one metric"
        )
    owners = _owners(measure.shape, side)
    height, width = (-(-length // side) for length in measure.shape)
    count = height * width
    mass = np.asarray(np.bincount(owners, measure.weights, count), float)
    mean = means_over(owners, count, measure.weights)
    coarse = Measure(
        mean(measure.positions), np.clip(mean(measure.colors), 0.0, 1.0), mass, (height, width),
        measure.color_weight, measure.extent, measure.color_space, measure.color_metric,
        warped=None if measure.warped is None else mean(measure.warped),
        features=None if measure.features is None else mean(measure.features),
    )  # fmt: skip
    return PixelBlocks(measure, coarse, side)


def _owners(shape: tuple[int, int], side: int) -> IntArray:
    """Return the index of the block of each pixel, row by row."""
    height, width = shape
    columns = -(-width // side)
    row, column = np.arange(height) // side, np.arange(width) // side
    return (row[:, None] * columns + column).ravel()
