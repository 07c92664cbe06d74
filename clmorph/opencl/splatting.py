"""Launches of ``cl_kernels/splat.cl``: place, bin, gather."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.errors import DeviceError
from clmorph.opencl import program
from clmorph.opencl.knobs import Knobs
from clmorph.opencl.launches import LaunchBudget, launch
from clmorph.operations import Bins, Float32, Float64, bin_grid, bin_margin

#: Entries of the (bins, slices) table of counts; fewer slices are used on large canvases.
COUNT_ENTRIES = 1 << 22
#: Particles moved by one launch.
PLACE_PARTICLES = 1 << 22


@dataclass(frozen=True)
class ParticleSet:
    """Moving particles on the device; weights are divided by `unit`."""

    count: int
    unit: float
    table: cl.Buffer  # (points, 5) float32
    links: cl.Buffer  # (count, 2) uint32
    weights: cl.Buffer  # (count, 2) float32


@dataclass(frozen=True)
class Splats:
    """Resting particles on the device; weights are divided by `unit`."""

    count: int
    unit: float
    positions: cl.Buffer  # (count, 2) float32, pixels
    samples: cl.Buffer  # (count, 4) float32: weight, color


class SortedSplats(NamedTuple):
    """Splats by bin: see `clmorph.operations.Bins`; `order` still on the device."""

    shape: tuple[int, int]
    starts: NDArray[np.int64]
    order: cl.Buffer
    positions: cl.Buffer
    samples: cl.Buffer


class Splatting:
    """The splatting half of `OpenCLOperations`."""

    def __init__(self, context: cl.Context, queue: cl.CommandQueue, knobs: Knobs) -> None:
        self.context, self.queue, self.knobs = context, queue, knobs
        built = program.build(context, "splat.cl", knobs.splat_constants())
        names = ("place", "count_bins", "fill_bins", "splat")
        self._kernels = {name: cl.Kernel(built, name) for name in names}
        # Work of a splat launch: particles visited, times the pixels of a block.
        self._budget = LaunchBudget()

    def upload_particles(
        self, table: Float64, links: NDArray[np.uint32], weights: Float64
    ) -> ParticleSet:
        """Take moving particles; see `clmorph.operations.Operations`."""
        unit = _unit(weights)
        return ParticleSet(
            count=_checked_count(len(links)),
            unit=unit,
            table=self._buffer(table),
            links=self._buffer(links, np.uint32),
            weights=self._buffer(weights / unit),
        )

    def upload_splats(self, positions: Float32, colors: Float32, weights: Float32) -> Splats:
        """Take resting particles; see `clmorph.operations.Operations`."""
        unit = _unit(weights)
        samples = np.column_stack((weights.astype(float) / unit, colors))
        return Splats(
            _checked_count(len(weights)), unit, self._buffer(positions), self._buffer(samples)
        )

    def place(
        self,
        particles: ParticleSet,
        t: float,
        scale: tuple[float, float],
        center: tuple[float, float],
    ) -> Splats:
        """Move particles to time t and onto a canvas; see `clmorph.operations.Operations`."""
        n = particles.count
        positions, samples = self._empty(8 * n), self._empty(16 * n)
        for first in range(0, n, PLACE_PARTICLES):
            self._run(
                "place", (min(PLACE_PARTICLES, n - first),), None,
                np.uint32(first), np.float32(t),
                cl.cltypes.make_float2(*scale), cl.cltypes.make_float2(*center),
                particles.table, particles.links, particles.weights, positions, samples,
            )  # fmt: skip
        return Splats(n, particles.unit, positions, samples)

    def bin_splats(self, splats: Splats, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins; see `clmorph.operations.Operations`."""
        by_bin = self._sort(splats, shape, margin)
        order = np.empty(splats.count, np.uint32)
        cl.enqueue_copy(self.queue, order, by_bin.order)
        return Bins(by_bin.shape, by_bin.starts, order.astype(np.int64))

    def _sort(self, splats: Splats, shape: tuple[int, int], margin: int) -> SortedSplats:
        """Sort splats into bins, without atomics: count by slice, add up, fill."""
        n = splats.count
        grid = bin_grid(shape, margin, self.knobs.bin)
        n_bins = grid[0] * grid[1]
        units = self.context.devices[0].max_compute_units
        slices = max(1, min(self.knobs.slices_per_unit * units, COUNT_ENTRIES // n_bins, n))
        slice_size = -(-n // slices)
        arguments = (
            np.uint32(n), np.uint32(slice_size), np.int32(margin),
            cl.cltypes.make_int2(grid[1], grid[0]), splats.positions,
        )  # fmt: skip
        counts = np.zeros((n_bins, slices), np.uint32)
        buffer = self._buffer(counts, np.uint32)
        self._run("count_bins", (slices,), None, *arguments, buffer)
        cl.enqueue_copy(self.queue, counts, buffer)
        ends = np.cumsum(counts, dtype=np.int64)
        slots = ends.reshape(counts.shape) - counts
        order = self._empty(4 * n)
        positions, samples = self._empty(8 * n), self._empty(16 * n)
        self._run(
            "fill_bins", (slices,), None, *arguments[:4], splats.positions, splats.samples,
            self._buffer(slots, np.uint32), order, positions, samples,
        )  # fmt: skip
        starts = np.append(slots[:, 0], n)
        return SortedSplats(grid, starts, order, positions, samples)

    def splat(
        self, splats: Splats, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a frame; see `clmorph.operations.Operations`."""
        height, width = shape
        nearest = sigma == 0
        if nearest:
            radius = 0.5
        margin = bin_margin(radius, self.knobs.bin)
        bins = self._sort(splats, shape, margin)
        side = self.knobs.width * self.knobs.tile_group
        blocks_y, blocks_x = -(-height // side), -(-width // side)
        padded = blocks_y * side, blocks_x * side
        starts = self._buffer(bins.starts, np.uint32)
        sums = np.empty((4, *padded), np.float32)
        buffer = self._empty(sums.nbytes)
        exponent_scale = 0.0 if nearest else -np.log2(np.e) / (2 * sigma**2)
        reach = int(radius) + 1
        first = 0
        while first < blocks_y:
            rows, visits = self._rows_within_budget(bins, margin, first, blocks_y, side, reach)
            with self._budget.measure(visits):
                self._run(
                    "splat",
                    (blocks_x * self.knobs.tile_group, rows * self.knobs.tile_group),
                    (self.knobs.tile_group, self.knobs.tile_group),
                    np.uint32(first * self.knobs.tile_group), np.uint32(padded[1]),
                    np.int32(margin), cl.cltypes.make_int2(bins.shape[1], bins.shape[0]),
                    np.float32(exponent_scale), np.float32(radius), np.int32(nearest),
                    starts, bins.positions, bins.samples, np.uint64(padded[0] * padded[1]), buffer,
                )  # fmt: skip
            first += rows
        cl.enqueue_copy(self.queue, sums, buffer)
        frame = sums[:, :height, :width].astype(float) * splats.unit
        return np.moveaxis(frame[1:], 0, -1), frame[0]

    def _rows_within_budget(
        self, bins: SortedSplats, margin: int, first: int, blocks_y: int, side: int, reach: int
    ) -> tuple[int, int]:
        """Block rows for the next launch, and the particles it visits, times pixels."""
        per_row = np.diff(bins.starts[:: bins.shape[1]])
        visits = 0
        for block in range(first, blocks_y):
            low = max(0, (block * side - reach) // self.knobs.bin + margin)
            high = ((block + 1) * side + reach) // self.knobs.bin + margin + 1
            # A block visits a strip of the bins it can reach; three is a generous share.
            more = 3 * int(per_row[low:high].sum()) * side + side * side
            if block > first and visits + more > self._budget.pairs():
                return block - first, visits
            visits += more
        return blocks_y - first, visits

    def _run(
        self, name: str, size: tuple[int, ...], group: tuple[int, ...] | None, *arguments: Any
    ) -> None:
        launch(self.queue, self._kernels[name], size, group, *arguments)

    def _buffer(self, values: NDArray[Any], dtype: Any = np.float32) -> cl.Buffer:
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, dtype))

    def _empty(self, n_bytes: int) -> cl.Buffer:
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, max(4, n_bytes))


def _unit(weights: NDArray[Any]) -> float:
    """Largest weight: dividing by it keeps float32 away from its smallest numbers."""
    largest = float(np.max(weights, initial=0.0))
    return largest if largest > 0 else 1.0


def _checked_count(count: int) -> int:
    if not 0 < count < 2**31:
        raise DeviceError(f"{count} particles: expected 1 to 2^31 - 1; keep fewer pairs")
    return count
