"""Particles on the device, and their sort into bins."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.constants import BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.kernels import launches, loop_limits
from clmorph.backends.opencl.kernels.launches import Workspace
from clmorph.backends.records import WIDTH_LEVELS, bin_grid

#: Entries of the (slices, bins) table of counts; fewer slices are used on large canvases.
COUNT_ENTRIES = 1 << 21
#: Launches of more work-items than this take a multiple of it.
WHOLE_GROUPS = 64


@dataclass(frozen=True)
class ParticleSet:
    """Particles that move, on the device; weights are divided by `unit`."""

    count: int
    unit: float
    table: cl.Buffer  # (points, 6) float32
    links: cl.Buffer  # (count, 2) uint32
    weights: cl.Buffer  # (count, 2) float32


@dataclass(frozen=True)
class Splats:
    """Particles at rest, on the device; weights are divided by `unit`."""

    count: int
    unit: float
    positions: cl.Buffer  # (count, 2) float32, pixels
    samples: cl.Buffer  # (count, 4) float32: weight, color
    spacings: cl.Buffer  # (count,) float32, pixels
    width_levels: cl.Buffer | None = None  # (count,) uint8, if widths differ


class SortedSplats(NamedTuple):
    """Splats by width level and bin, see `records.Bins`; `order` is on the device."""

    shape: tuple[int, int]
    side: float  # of a bin, in pixels
    margin: int  # bins around the canvas; particles farther out fall into these
    starts: NDArray[np.int64]  # (levels, bins + 1); one level if all have the same width
    order: cl.Buffer
    positions: cl.Buffer
    samples: cl.Buffer


def whole_groups(items: int) -> int:
    """Return how many items to launch together: drivers make groups of 1 for prime numbers."""
    return items // WHOLE_GROUPS * WHOLE_GROUPS or items


def sort_splats(
    work: Workspace,
    programs: Programs,
    constants: BuildConstants,
    splats: Splats,
    shape: tuple[int, int],
    margin: int,
    side: float,
) -> SortedSplats:
    """Sort splats into bins without atomics: count in each slice, add up, fill the bins."""
    n = splats.count
    grid = bin_grid(shape, margin, side)
    bins = grid[0] * grid[1]
    n_bins = bins * (1 if splats.width_levels is None else WIDTH_LEVELS.count)
    device = work.device
    slices = constants.slices_per_unit * device.max_compute_units
    slices = whole_groups(max(1, min(slices, COUNT_ENTRIES // n_bins, n)))
    slices = max(slices, -(-n // loop_limits.sorted_particles(constants)))
    # There are few slices. By default, drivers of CPUs put all of them into one work-group on one
    # core, and vectorize over them with scattered accesses.
    group = (1,) if device.type & cl.device_type.CPU else None
    slice_size = -(-n // slices)
    per_launch = whole_groups(max(1, launches.LAUNCH_PARTICLES // slice_size))
    counts = np.zeros((slices, n_bins), np.uint32)
    counts_buffer = work.buffer(counts, np.uint32)
    # The kernel ignores this buffer if all widths are equal, but drivers require one.
    levels = splats.positions if splats.width_levels is None else splats.width_levels

    def over_slices(name: str, *arguments: Any) -> None:
        kernel = programs.kernel("particles.cl", name)
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
