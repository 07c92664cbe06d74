"""Launches of ``cl_kernels/particles.cl`` and ``cl_kernels/splat.cl``: move, sort, gather."""

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.kernels import launches, loop_limits
from clmorph.backends.opencl.kernels.gauss_transform import (
    BIN_CELLS,
    Moments,
    cell_side,
    make_cells,
    moments_pay,
)
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.opencl.kernels.particles import (
    ParticleSet,
    SortedSplats,
    Splats,
    whole_groups,
)
from clmorph.backends.records import WIDTH_LEVELS, Bins, Float32, Float64, bin_grid
from clmorph.errors import DeviceError

#: Entries of the (slices, bins) table of counts; fewer slices are used on large canvases.
COUNT_ENTRIES = 1 << 21
#: The number of bins around the canvas; particles farther out fall into the outermost ones.
MARGIN = 1
#: For splats with individual widths, moments are used for widths from `sigma` to this multiple of
#: `sigma`, and the sides of bins are chosen for these widths.
WIDEST = 2


class Splatting:
    """Operations on particles: move, sort, choose widths, splat."""

    def __init__(self, work: Workspace, constants: BuildConstants, programs: Programs) -> None:
        self._work, self._constants, self._programs = work, constants, programs
        self._budget = LaunchBudget()
        self._block = constants.width * constants.tile_group  # pixels of a work-group's side
        #: "gather"; "moments", if cells suit the kernel; "auto", the faster of both.
        self.method = "auto"

    @functools.cached_property
    def _moments(self) -> Moments:
        return Moments(self._work, self._constants, self._programs)

    def upload_particles(
        self, table: Float64, links: NDArray[np.uint32], weights: Float64
    ) -> ParticleSet:
        """Upload particles that move; see `clmorph.backends.interface.Operations`."""
        unit = _unit(weights)
        return ParticleSet(
            count=_checked_count(len(links)),
            unit=unit,
            table=self._work.buffer(table),
            links=self._work.buffer(links, np.uint32),
            weights=self._work.buffer(weights / unit),
        )

    def upload_splats(
        self, positions: Float32, colors: Float32, weights: Float32, spacings: Float32 | None = None
    ) -> Splats:
        """Upload particles at rest; see `clmorph.backends.interface.Operations`."""
        unit = _unit(weights)
        samples = np.column_stack((weights.astype(float) / unit, colors))
        return Splats(
            _checked_count(len(weights)),
            unit,
            self._work.buffer(positions),
            self._work.buffer(samples),
            self._work.buffer(np.ones(len(weights)) if spacings is None else spacings),
        )

    def advect(
        self,
        particles: ParticleSet,
        t: float,
        scale: tuple[float, float],
        center: tuple[float, float],
    ) -> Splats:
        """Move particles to time t and to pixel coordinates; see `interface.Operations`."""
        n = particles.count
        positions, samples = self._work.empty(8 * n), self._work.empty(16 * n)
        spacings = self._work.empty(4 * n)
        self._over_particles(
            "advect", n, np.float32(t),
            cl.cltypes.make_float2(*scale), cl.cltypes.make_float2(*center),
            particles.table, particles.links, particles.weights, positions, samples, spacings,
        )  # fmt: skip
        return Splats(n, particles.unit, positions, samples, spacings)

    def deposit(self, splats: Splats, shape: tuple[int, int]) -> tuple[Float64, Float64]:
        """Return masses and their squares by pixel; see `clmorph.backends.interface.Operations`."""
        packed = self._work.empty(16 * splats.count)
        self._over_particles("pack_weights", splats.count, splats.samples, packed)
        squares, mass = self.splat(replace(splats, samples=packed), shape, 0.0, 0.0)
        return mass, squares[..., 0] * splats.unit

    def adapt_widths(self, splats: Splats, distances: Float64, sigma: float) -> Splats:
        """Give every splat its own width; see `clmorph.backends.interface.Operations`."""
        levels, scaled = self._work.empty(splats.count), self._work.empty(16 * splats.count)
        self._over_particles(
            "choose_width_levels", splats.count,
            cl.cltypes.make_int2(distances.shape[1], distances.shape[0]), np.float32(sigma),
            self._work.buffer(np.minimum(distances, 1e30)), splats.positions, splats.samples,
            splats.spacings, levels, scaled,
        )  # fmt: skip
        return replace(splats, samples=scaled, width_levels=levels)

    def _over_particles(self, name: str, count: int, *arguments: Any) -> None:
        """Run a kernel with one work-item per particle, in launches of a bounded size."""
        first = 0
        while first < count:
            items = whole_groups(min(launches.LAUNCH_PARTICLES, count - first))
            self._work.launch(
                self._programs.kernel("particles.cl", name), (items,), None, np.uint32(first),
                *arguments,
            )  # fmt: skip
            first += items

    def width_levels(self, splats: Splats) -> NDArray[np.int64]:
        """Return the width level of each splat; see `clmorph.backends.interface.Operations`."""
        if splats.width_levels is None:
            return np.full(splats.count, WIDTH_LEVELS.base)
        levels = np.empty(splats.count, np.uint8)
        cl.enqueue_copy(self._work.queue, levels, splats.width_levels)
        return levels.astype(np.int64)

    def bin_splats(self, splats: Splats, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins; see `clmorph.backends.interface.Operations`."""
        by_bin = self._sorted(splats, shape, margin, self._constants.bin)
        order = np.empty(splats.count, np.uint32)
        cl.enqueue_copy(self._work.queue, order, by_bin.order)
        return Bins(by_bin.shape, by_bin.starts[0], order.astype(np.int64))

    def _sorted(
        self, splats: Splats, shape: tuple[int, int], margin: int, side: float
    ) -> SortedSplats:
        """Sort splats into bins without atomics: count in each slice, add up, fill the bins."""
        n = splats.count
        grid = bin_grid(shape, margin, side)
        bins = grid[0] * grid[1]
        n_bins = bins * (1 if splats.width_levels is None else WIDTH_LEVELS.count)
        work, device = self._work, self._work.device
        slices = self._constants.slices_per_unit * device.max_compute_units
        slices = whole_groups(max(1, min(slices, COUNT_ENTRIES // n_bins, n)))
        slices = max(slices, -(-n // loop_limits.sorted_particles(self._constants)))
        # There are few slices. By default, drivers of CPUs put all of them into one work-group on
        # one core, and vectorize over them with scattered accesses.
        group = (1,) if device.type & cl.device_type.CPU else None
        slice_size = -(-n // slices)
        per_launch = whole_groups(max(1, launches.LAUNCH_PARTICLES // slice_size))
        counts = np.zeros((slices, n_bins), np.uint32)
        counts_buffer = work.buffer(counts, np.uint32)
        # The kernel ignores this buffer if all widths are equal, but drivers require one.
        levels = splats.positions if splats.width_levels is None else splats.width_levels

        def over_slices(name: str, *arguments: Any) -> None:
            kernel = self._programs.kernel("particles.cl", name)
            for first in range(0, slices, per_launch):
                work.launch(
                    kernel, (min(per_launch, slices - first),), group,
                    np.uint32(n), np.uint32(slice_size), np.uint32(first), np.uint32(n_bins),
                    np.float32(1 / side), np.int32(margin), cl.cltypes.make_int2(grid[1], grid[0]),
                    np.uint32(0 if splats.width_levels is None else bins), splats.positions, levels,
                    *arguments,
                )  # fmt: skip

        over_slices("count_bins", counts_buffer)
        cl.enqueue_copy(work.queue, counts, counts_buffer)
        # A bin's particles stay together, in the order of the slices.
        starts = np.concatenate(([0], np.cumsum(counts.sum(axis=0, dtype=np.int64))))
        slots = starts[:-1] + np.cumsum(counts, axis=0, dtype=np.int64) - counts
        order, positions, samples = work.empty(4 * n), work.empty(8 * n), work.empty(16 * n)
        over_slices(
            "fill_bins", splats.samples, work.buffer(slots, np.uint32), order, positions, samples
        )
        by_level = [starts[first : first + bins + 1] for first in range(0, n_bins, bins)]
        return SortedSplats(grid, side, margin, np.stack(by_level), order, positions, samples)

    def splat(
        self, splats: Splats, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a frame; see `clmorph.backends.interface.Operations`."""
        height, width = shape
        nearest = sigma == 0
        if nearest:
            radius = 0.5
        side, margin = float(self._constants.bin), MARGIN
        by_moments = self._by_moments(splats.count, shape, sigma, radius)
        if by_moments:
            side = BIN_CELLS * make_cells(sigma, radius).side
            widest = 1 if splats.width_levels is None else WIDEST
            margin = int(np.ceil(widest * radius / side))
        bins = self._sorted(splats, shape, margin, side)
        block = self._block
        blocks = -(-height // block), -(-width // block)
        padded = blocks[0] * block, blocks[1] * block
        sums = np.zeros((4, *padded), np.float32)
        buffer = self._work.buffer(sums)
        for level, starts in enumerate(bins.starts):
            count = int(starts[-1] - starts[0])
            if count == 0:
                continue
            own, factor = bins._replace(starts=starts), 1.0
            if splats.width_levels is not None:
                factor = float(WIDTH_LEVELS.factor(level))
            wide, far = factor * sigma, factor * radius
            fits = by_moments and 1 <= factor <= WIDEST
            if fits and self._by_moments(count, shape, wide, far):
                self._moments.add(own, make_cells(wide, far), shape, padded, buffer)
                continue
            scale = 0.0 if nearest else -np.log2(np.e) / (2 * wide**2)
            kernel = np.float32(scale), np.float32(far), np.int32(nearest)
            self._gather(own, blocks, kernel, buffer)
        cl.enqueue_copy(self._work.queue, sums, buffer)
        frame = sums[:, :height, :width].astype(float) * splats.unit
        return np.moveaxis(frame[1:], 0, -1), frame[0]

    def _by_moments(self, count: int, shape: tuple[int, int], sigma: float, radius: float) -> bool:
        """Return whether to add splats by moments of cells rather than by the gather."""
        if self.method == "auto":
            return moments_pay(count, shape, sigma, radius, self._block)
        return self.method == "moments" and cell_side(sigma, radius) is not None

    def _gather(
        self,
        bins: SortedSplats,
        blocks: tuple[int, int],
        kernel: tuple[np.float32, np.float32, np.int32],
        sums: cl.Buffer,
    ) -> None:
        """Add the splats of one width level to the sums of all blocks of pixels."""
        (blocks_y, blocks_x), side = blocks, self._block
        splat = self._programs.kernel("splat.cl", "splat")
        on_device = self._work.buffer(bins.starts, np.uint32)
        visits = self._visits(bins, blocks, float(kernel[1]))
        group = self._constants.tile_group
        first_particle, end = int(bins.starts[0]), int(bins.starts[-1])
        # Crowded blocks receive their particles in parts. The parts have a fixed size, so that
        # rounding does not depend on the measured speed of the device.
        limit = loop_limits.gathered_particles(self._constants, bins.shape[0])
        most = min(launches.LAUNCH_PARTICLES, limit)
        part = most if visits.max() > most else end - first_particle
        work = (np.minimum(visits, most) + 1) * side
        for particle in range(first_particle, end, part):
            for first, stop in self._budget.parts(work):
                # The particles visited, counted for every row of a block.
                with self._budget.measure(int((visits[first:stop] + 1).sum()) * side):
                    self._work.launch(
                        splat, ((stop - first) * group, group), (group, group),
                        np.uint32(first), np.uint32(blocks_x), np.uint32(particle),
                        np.uint32(min(end, particle + part)),
                        np.float32(1 / bins.side), np.int32(bins.margin),
                        cl.cltypes.make_int2(bins.shape[1], bins.shape[0]),
                        *kernel, on_device, bins.positions, bins.samples,
                        np.uint64(blocks_y * blocks_x * side**2), sums,
                    )  # fmt: skip

    def _visits(
        self, bins: SortedSplats, blocks: tuple[int, int], radius: float
    ) -> NDArray[np.int64]:
        """Return the number of particles that each block of pixels visits, row by row."""
        sums = np.zeros((bins.shape[0] + 1, bins.shape[1] + 1), np.int64)
        sums[1:, 1:] = np.diff(bins.starts).reshape(bins.shape).cumsum(axis=0).cumsum(axis=1)
        low, high, side = [], [], self._block
        for count, n_bins in zip(blocks, bins.shape, strict=True):
            first = np.arange(count) * side
            reach = np.array([-radius, side - 1 + radius])[:, None] + first
            ends = np.clip(np.floor(reach / bins.side) + bins.margin, 0, n_bins - 1).astype(int)
            low.append(ends[0])
            high.append(ends[1] + 1)
        y0, y1, x0, x1 = low[0][:, None], high[0][:, None], low[1], high[1]
        return (sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]).ravel()


def _unit(weights: NDArray[Any]) -> float:
    """Return the largest weight; weights divided by it do not underflow in float32."""
    largest = float(np.max(weights, initial=0.0))
    return largest if largest > 0 else 1.0


def _checked_count(count: int) -> int:
    if not 0 < count < 2**31:
        raise DeviceError(f"{count} particles: expected 1 to 2^31 - 1; keep fewer pairs")
    return count
