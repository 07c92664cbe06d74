"""Launches of ``cl_kernels/splat.cl``: place, bin, gather."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.errors import DeviceError
from clmorph.opencl import program
from clmorph.opencl.knobs import Knobs
from clmorph.opencl.launches import LaunchBudget, Workspace
from clmorph.operations import Bins, Float32, Float64, bin_grid

#: Entries of the (bins, slices) table of counts; fewer slices are used on large canvases.
COUNT_ENTRIES = 1 << 22
#: Particles that one launch moves, sorts or lets a block of pixels look at.
LAUNCH_PARTICLES = 1 << 20
#: Bins around the canvas; particles farther out fall into these, wherever they are.
MARGIN = 1


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

    def __init__(self, work: Workspace, knobs: Knobs) -> None:
        self._work, self._knobs = work, knobs
        built = program.build(work.context, "splat.cl", knobs.splat_constants())
        names = ("place", "count_bins", "fill_bins", "splat")
        self._kernels = {name: cl.Kernel(built, name) for name in names}
        self._budget = LaunchBudget()

    def upload_particles(
        self, table: Float64, links: NDArray[np.uint32], weights: Float64
    ) -> ParticleSet:
        """Take moving particles; see `clmorph.operations.Operations`."""
        unit = _unit(weights)
        return ParticleSet(
            count=_checked_count(len(links)),
            unit=unit,
            table=self._work.buffer(table),
            links=self._work.buffer(links, np.uint32),
            weights=self._work.buffer(weights / unit),
        )

    def upload_splats(self, positions: Float32, colors: Float32, weights: Float32) -> Splats:
        """Take resting particles; see `clmorph.operations.Operations`."""
        unit = _unit(weights)
        samples = np.column_stack((weights.astype(float) / unit, colors))
        return Splats(
            _checked_count(len(weights)),
            unit,
            self._work.buffer(positions),
            self._work.buffer(samples),
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
        positions, samples = self._work.empty(8 * n), self._work.empty(16 * n)
        for first in range(0, n, LAUNCH_PARTICLES):
            self._run(
                "place", (min(LAUNCH_PARTICLES, n - first),), None,
                np.uint32(first), np.float32(t),
                cl.cltypes.make_float2(*scale), cl.cltypes.make_float2(*center),
                particles.table, particles.links, particles.weights, positions, samples,
            )  # fmt: skip
        return Splats(n, particles.unit, positions, samples)

    def bin_splats(self, splats: Splats, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins; see `clmorph.operations.Operations`."""
        by_bin = self._sort(splats, shape, margin)
        order = np.empty(splats.count, np.uint32)
        cl.enqueue_copy(self._work.queue, order, by_bin.order)
        return Bins(by_bin.shape, by_bin.starts, order.astype(np.int64))

    def _sort(self, splats: Splats, shape: tuple[int, int], margin: int) -> SortedSplats:
        """Sort splats into bins, without atomics: count by slice, add up, fill."""
        n = splats.count
        grid = bin_grid(shape, margin, self._knobs.bin)
        n_bins = grid[0] * grid[1]
        units = self._work.context.devices[0].max_compute_units
        slices = max(1, min(self._knobs.slices_per_unit * units, COUNT_ENTRIES // n_bins, n))
        slice_size = -(-n // slices)
        per_launch = max(1, LAUNCH_PARTICLES // slice_size)
        counts = np.zeros((n_bins, slices), np.uint32)
        counts_buffer = self._work.buffer(counts, np.uint32)

        def over_slices(name: str, *arguments: Any) -> None:
            for first in range(0, slices, per_launch):
                self._run(
                    name, (min(per_launch, slices - first),), None,
                    np.uint32(n), np.uint32(slice_size), np.uint32(first), np.uint32(slices),
                    np.int32(margin), cl.cltypes.make_int2(grid[1], grid[0]), *arguments,
                )  # fmt: skip

        over_slices("count_bins", splats.positions, counts_buffer)
        cl.enqueue_copy(self._work.queue, counts, counts_buffer)
        ends = np.cumsum(counts, dtype=np.int64)
        slots = ends.reshape(counts.shape) - counts
        order = self._work.empty(4 * n)
        positions, samples = self._work.empty(8 * n), self._work.empty(16 * n)
        over_slices(
            "fill_bins", splats.positions, splats.samples, self._work.buffer(slots, np.uint32),
            order, positions, samples,
        )  # fmt: skip
        return SortedSplats(grid, np.append(slots[:, 0], n), order, positions, samples)

    def splat(
        self, splats: Splats, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a frame; see `clmorph.operations.Operations`."""
        height, width = shape
        nearest = sigma == 0
        if nearest:
            radius = 0.5
        bins = self._sort(splats, shape, MARGIN)
        side = self._knobs.width * self._knobs.tile_group
        blocks_y, blocks_x = -(-height // side), -(-width // side)
        padded = blocks_y * side, blocks_x * side
        starts = self._work.buffer(bins.starts, np.uint32)
        sums = np.zeros((4, *padded), np.float32)
        buffer = self._work.buffer(sums)
        exponent_scale = 0.0 if nearest else -np.log2(np.e) / (2 * sigma**2)
        visits = self._visits(bins, (blocks_y, blocks_x), side, radius)
        group = self._knobs.tile_group
        # Crowded blocks are given their particles in parts, of a fixed size so that rounding
        # does not depend on how fast the device is today.
        part = splats.count if visits.max() <= LAUNCH_PARTICLES else LAUNCH_PARTICLES
        for particle in range(0, splats.count, part):
            for first, stop in self._block_parts(np.minimum(visits, LAUNCH_PARTICLES), side):
                with self._budget.measure(_cost(visits[first:stop], side)):
                    self._run(
                        "splat", ((stop - first) * group, group), (group, group),
                        np.uint32(first), np.uint32(blocks_x), np.uint32(particle),
                        np.uint32(min(splats.count, particle + part)),
                        np.int32(MARGIN), cl.cltypes.make_int2(bins.shape[1], bins.shape[0]),
                        np.float32(exponent_scale), np.float32(radius), np.int32(nearest),
                        starts, bins.positions, bins.samples,
                        np.uint64(padded[0] * padded[1]), buffer,
                    )  # fmt: skip
        cl.enqueue_copy(self._work.queue, sums, buffer)
        frame = sums[:, :height, :width].astype(float) * splats.unit
        return np.moveaxis(frame[1:], 0, -1), frame[0]

    def _visits(
        self, bins: SortedSplats, blocks: tuple[int, int], side: int, radius: float
    ) -> NDArray[np.int64]:
        """Particles that each block of pixels looks at, row by row."""
        sums = np.zeros((bins.shape[0] + 1, bins.shape[1] + 1), np.int64)
        sums[1:, 1:] = np.diff(bins.starts).reshape(bins.shape).cumsum(axis=0).cumsum(axis=1)
        low, high = [], []
        for count, n_bins in zip(blocks, bins.shape, strict=True):
            first = np.arange(count) * side
            reach = np.array([-radius, side - 1 + radius])[:, None] + first
            ends = np.clip(np.floor(reach / self._knobs.bin) + MARGIN, 0, n_bins - 1).astype(int)
            low.append(ends[0])
            high.append(ends[1] + 1)
        y0, y1, x0, x1 = low[0][:, None], high[0][:, None], low[1], high[1]
        return (sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]).ravel()

    def _block_parts(self, visits: NDArray[np.int64], side: int) -> Iterator[tuple[int, int]]:
        """Split the blocks so that no launch runs long."""
        work = np.cumsum((visits + 1) * side)
        first = 0
        while first < len(work):
            before = work[first - 1] if first else 0
            stop = int(np.searchsorted(work, before + self._budget.pairs(), side="right"))
            stop = max(first + 1, stop)
            yield first, stop
            first = stop

    def _run(
        self, name: str, size: tuple[int, ...], group: tuple[int, ...] | None, *arguments: Any
    ) -> None:
        self._work.launch(self._kernels[name], size, group, *arguments)


def _cost(visits: NDArray[np.int64], side: int) -> int:
    """Work of a launch: particles looked at, once for every row of a block."""
    return int((visits + 1).sum()) * side


def _unit(weights: NDArray[Any]) -> float:
    """Largest weight: dividing by it keeps float32 away from its smallest numbers."""
    largest = float(np.max(weights, initial=0.0))
    return largest if largest > 0 else 1.0


def _checked_count(count: int) -> int:
    if not 0 < count < 2**31:
        raise DeviceError(f"{count} particles: expected 1 to 2^31 - 1; keep fewer pairs")
    return count
