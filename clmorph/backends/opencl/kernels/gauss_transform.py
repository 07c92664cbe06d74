"""Splatting by an improved fast Gauss transform, ``cl_kernels/gauss_transform.cl``."""

import functools
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import MOMENT_CHUNK, BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels import launches
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.opencl.kernels.particles import WHOLE_GROUPS, SortedSplats

#: The number of cells along a side of a bin, so that the moments of a bin fit into a core's nearest
#: cache.
BIN_CELLS = 8
#: Largest side of a cell, in kernel widths, for which the error of the expansion is at most
#: `clmorph.backends.interface.KERNEL_ERROR`.
LARGEST_CELL = 0.75
#: Smallest and largest side of a cell, in pixels; the gather of narrower kernels is cheap.
SIDES = 0.25, 64.0
#: The largest radius of a kernel, in kernel widths, for which cells are used.
FARTHEST_CUT = 8.0
#: The number of pairs (a, b), and of values of a (of b, rounded up), the same as in the kernels.
TERMS, ORDERS = 40, 8
#: The number of particles whose polynomials vectors form at once, the same as in the kernels.
LANES = 16
#: Bytes of moments that are handled together, so that they stay in the cache.
STRIP_BYTES = 1 << 23
#: The number of pixels of a row that one work-item of a CPU handles.
SPAN = 16
#: The number of nodes of the interpolation that determines the Chebyshev coefficients, far larger
#: than the number of coefficients.
NODES = 32


@dataclass(frozen=True)
class Cells:
    """Cells of one size, and the expansion of the Gaussian over them."""

    #: Side of a cell in pixels, a power of two.
    side: float
    #: Number of cells by which the kernel extends before the cell in which pixel 0 begins.
    reach: int
    #: Chebyshev coefficients of the kernel over a cell, by the position of a pixel in the coarser
    #: of both grids, and by cell; 0 for cells without a point within the radius of the kernel:
    #: (phases, taps, ORDERS) array.
    coefficients: NDArray[np.float64]


def cell_side(sigma: float, radius: float) -> float | None:
    """Return the side of the cells for a kernel, in pixels; None if cells are unsuitable for it."""
    if not SIDES[0] <= LARGEST_CELL * sigma < 2 * SIDES[1] or radius > FARTHEST_CUT * sigma:
        return None
    return float(2.0 ** np.floor(np.log2(LARGEST_CELL * sigma)))


@functools.lru_cache(maxsize=64)
def make_cells(sigma: float, radius: float) -> Cells:
    """Expand a kernel over its cells; `cell_side` must not be None for it."""
    side = cell_side(sigma, radius)
    assert side is not None
    phases = max(1, round(side))
    pixels = np.arange(phases)[:, None]
    reach = int(np.ceil(radius / side))
    cells = np.arange(-reach, int(np.floor((phases - 1 + radius) / side)) + 1)
    near = (cells >= np.floor((pixels - radius) / side)) & (cells <= (pixels + radius) / side)
    angles = np.pi * (np.arange(NODES) + 0.5) / NODES
    distances = pixels[..., None] - (cells[:, None] + 0.5 + 0.5 * np.cos(angles)) * side
    values = np.exp(-0.5 * (distances / sigma) ** 2)
    coefficients = values @ np.cos(np.outer(angles, np.arange(ORDERS))) * (2 / NODES)
    coefficients[..., 0] /= 2
    return Cells(side, reach, np.where(near[..., None], coefficients, 0.0))


def moments_pay(
    count: int, shape: tuple[int, int], sigma: float, radius: float, block: int
) -> bool:
    """Return whether moments of cells suit a kernel and probably take less time than the gather."""
    side = cell_side(sigma, radius)
    if side is None:
        return False
    # In nanoseconds, fitted to a CPU with two cores of 16 lanes; the gather visits a particle for
    # each block of pixels.
    blocks = cells = 1.0
    for length in shape:
        blocks *= min(2 * radius / block + 1, -(-length // block))
        cells *= (length + 2 * radius) / side + BIN_CELLS
    taps = 2 * radius / side + 2
    rows = (shape[0] + 2 * radius) / side
    pixels_and_rows = shape[1] * (rows + shape[0])
    return 22 * count + 5.5 * pixels_and_rows * taps + 28 * cells < 2.1 * block * count * blocks


def particles_of_bin(loop_rounds: int, scalar: bool, group: int, cells: int) -> int:
    """Return the number of particles of a bin in one launch of ``sum_moments``."""
    if scalar:
        terms = -(-TERMS // group)
        clearing = terms * (cells**2 + 2) + 1
        batch, taken = ORDERS + 3 + terms * (group + 2), group
    else:
        clearing = TERMS // 4 * cells**2 + 1
        batch, taken = 2 * LANES + ORDERS + 4, LANES
    chunk = 2 * clearing + 2 + batch * -(-MOMENT_CHUNK // taken)
    chunks = (loop_rounds - clearing - chunk) // chunk
    if chunks > 0:
        return chunks * MOMENT_CHUNK
    return max(1, (loop_rounds - 3 * clearing - batch) // batch * taken)


class Moments:
    """Adds many splats to the sums of a canvas by moments of cells."""

    def __init__(self, work: Workspace, constants: BuildConstants, programs: Programs) -> None:
        self._work, self._constants = work, constants
        macros = Variant("gauss_transform.cl").macros(constants)
        self._group = int(macros["MOMENT_GROUP"])
        self._scalar = macros["WIDTH"] == 1
        self._span = 1 if self._scalar else SPAN
        self._kernels = programs.kernels(Variant("gauss_transform.cl"))
        self._budgets = {name: LaunchBudget() for name in self._kernels}

    def add(
        self,
        bins: SortedSplats,
        cells: Cells,
        shape: tuple[int, int],
        padded: tuple[int, int],
        sums: cl.Buffer,
    ) -> None:
        """Add splats of one width level, sorted with the radius as margin, to the padded sums."""
        per_bin = round(bins.side / cells.side)
        (bins_y, bins_x), starts = bins.shape, bins.starts
        row_bytes = bins_x * per_bin**2 * TERMS * 16
        strip = int(np.clip(STRIP_BYTES // row_bytes, 1, bins_y))
        moments, partial = (self._work.empty(strip * row_bytes) for _ in range(2))
        along_x = self._work.empty(strip * per_bin * shape[1] * ORDERS * 16)
        starts_buffer = self._work.buffer(starts, np.uint32)
        # Each coefficient multiplies four channels.
        coefficients = self._work.buffer(np.repeat(cells.coefficients, 4))
        phases, taps, _ = cells.coefficients.shape
        per_pixel = max(1, round(1 / cells.side))
        geometry = tuple(map(np.int32, (per_pixel, phases, cells.reach, taps)))
        for top in range(0, bins_y, strip):
            rows = min(strip, bins_y - top)
            if starts[top * bins_x] == starts[(top + rows) * bins_x]:
                continue
            self._sum_moments(bins, starts_buffer, top, rows, cells, moments, partial)
            self._over_rows(
                "sum_rows", 0, rows * per_bin, shape[1], 8 * taps, (
                    np.uint32(top * bins_x),
                    np.int32(bins.margin), np.int32(bins_x), np.int32(per_bin),
                    *geometry, starts_buffer, coefficients, moments, along_x,
                ),
            )  # fmt: skip
            # The pixels that kernels of the strip can reach, and a few more.
            first_row = (top - bins.margin) * per_bin
            low = int((first_row - taps) * cells.side)
            high = int((first_row + rows * per_bin + taps + 1) * cells.side) + 1
            self._over_rows(
                "sum_columns", max(0, low), min(shape[0], high), shape[1], 4 * taps, (
                    np.int32(first_row), np.int32(rows * per_bin),
                    *geometry, coefficients, along_x,
                    np.uint64(padded[0] * padded[1]), np.uint64(padded[1]), sums,
                ),
            )  # fmt: skip

    def _sum_moments(
        self,
        bins: SortedSplats,
        starts_buffer: cl.Buffer,
        top: int,
        rows: int,
        cells: Cells,
        moments: cl.Buffer,
        partial: cl.Buffer,
    ) -> None:
        """Compute the moments of every cell of a strip."""
        bins_x, starts = bins.shape[1], bins.starts
        strip = slice(top * bins_x, (top + rows) * bins_x)
        counts = np.diff(starts[strip.start : strip.stop + 1])
        per_bin = round(bins.side / cells.side)
        first_particle, end = int(starts[strip.start]), int(starts[strip.stop])
        # As in the gather, crowded bins are summed in parts of a fixed size.
        limit = particles_of_bin(self._constants.loop_rounds, self._scalar, self._group, per_bin)
        most = min(launches.LAUNCH_PARTICLES, limit)
        part = most if counts.max() > most else end - first_particle
        work = np.minimum(counts, part) + per_bin**2
        budget = self._budgets["sum_moments"]
        for particle in range(first_particle, end, part):
            for first, stop in budget.parts(work):
                with budget.measure(int(work[first:stop].sum())):
                    self._work.launch(
                        self._kernels["sum_moments"],
                        ((stop - first) * self._group,), (self._group,),
                        np.uint32(strip.start + first), np.uint32(strip.start),
                        np.uint32(particle), np.uint32(min(end, particle + part)),
                        np.int32(bins.margin), np.int32(bins_x), np.int32(per_bin),
                        np.float32(1 / cells.side), starts_buffer,
                        bins.positions, bins.samples, moments, partial,
                    )  # fmt: skip

    def _over_rows(
        self, name: str, first: int, end: int, width: int, cost: int, arguments: tuple
    ) -> None:
        """Run a kernel over rows of cells or pixels; `cost` is the work of one pixel."""
        items = -(-width // self._span)
        group = None if self._span == 1 else (1, 1)
        if group is None:  # a driver chooses it; the kernels leave out what is beyond the width
            items = WHOLE_GROUPS * -(-items // WHOLE_GROUPS)
        for row, count, _ in self._budgets[name].rows(end - first, width * cost):
            self._work.launch(
                self._kernels[name], (items, count), group,
                np.uint32(first + row), np.int32(self._span), np.int32(width), *arguments,
            )  # fmt: skip
