"""Constants with which the kernels are built, chosen for the kind of device."""

import math
import sys
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl

from clmorph.backends.opencl.devices.quirks import LONGEST_LOOP, find_quirks

#: The number that represents minus infinity in float32 exponents. It is far below all of them, yet
#: the sum of a few is finite. It is exact in float32, hence the same number in any precision.
SENTINEL = float(np.float32(-1e30))
#: The number of particles of a bin whose moments are summed before they are added to the total.
MOMENT_CHUNK = 1024
#: The number of columns handled together if an exponent fills two registers.
PRECISE_UNROLL = 4
#: The largest number of columns handled together if a mask has chosen them: it may choose few.
MASKED_UNROLL = 4
#: The number of stored pairs of a row that are handled together.
STORED_UNROLL = 4
#: The largest argument of exp in iterations whose numbers are pairs of float32.
MAX_EXPONENT_OF_PAIRS = 70.0
#: The number of seeds of a leaf, and of nodes below a node, of the tree of ``nearest_seeds.cl``.
SEED_LEAF, SEED_WAYS = 8, 4


#: From this dimension on a tile's exponents are formed slice by slice, `SLICE` coordinates at once:
#: programs are then the same for all dimensions, and are built as for this one.
SLICED_FROM, SLICE = 12, 16

#: The largest number of registers for the coordinates of a work-item's rows, where it has several.
ROW_REGISTERS = 24


@dataclass(frozen=True)
class BuildConstants:
    """Constants that affect speed and rounding only; see the headers of ``cl_kernels/*.cl``."""

    #: Lanes of one work-item.
    width: int
    #: Work-items of a work-group in the row reductions.
    group: int
    #: Columns handled together in the log-sum-exp.
    unroll: int
    #: Work-items along each side of a splatting work-group.
    tile_group: int
    #: Points of one tile of a cloud.
    tile: int = 64
    #: The function for powers of two. 1: the device's built-in exp2; 0: the polynomial.
    exp2_builtin: int = 0
    #: Arithmetic of precise exponents (``exponents.cl``). 2: float64; 1: pairs of float32.
    precise: int = 2
    #: Side of a bin of particles, in pixels.
    bin: int = 8
    #: Particles that are summed before they are added to the total.
    chunk: int = 256
    #: Slices of the particle list that are sorted at once, per compute unit.
    slices_per_unit: int = 8
    #: The number of rounds that all loops of a work-item may take together; 0: any number. Only on
    #: some devices it is limited, see the quirk ``short_loops``.
    longest_loop: int = 0
    #: Rows of a work-item of the log-sum-exp where they are more than `width`: see `stacks`.
    rows: int = 1
    #: Work-items of the one group that takes the vectors of a problem in an iteration over all
    #: pairs: one group uses a small part of a card, and a larger group more of it.
    step_group: int = 1
    #: 1: the device computes in float64, of which iterations and grids need little; 0: it does not.
    float64: int = 1

    @property
    def group_rows(self) -> int:
        """Rows of a work-group: those that a mask of columns serves."""
        return self.width * self.group

    @property
    def bounds_first(self) -> bool:
        """Whether bounds over a vector of rows, which a work-item has for itself, are of use."""
        return self.group == 1 and self.width > 1

    @property
    def blocks(self) -> int:
        """Groups of `width` rows that a work-item takes with the same staged columns."""
        # A single work-item takes all rows of its tile, unless its loops must be short.
        return self.tile // self.width if self.group == 1 and not self.longest_loop else 1

    def stacks(self, dimension: int, precise: bool) -> int:
        """Return how many work-items share their rows, and the columns, in the log-sum-exp."""
        if dimension >= SLICED_FROM:
            return 1
        registers = self.width * dimension * (2 if precise else 1)
        most = min(self.group, self.rows // self.width, ROW_REGISTERS // registers)
        return 1 << max(0, most.bit_length() - 1)

    @property
    def loop_rounds(self) -> int:
        """Rounds that all loops of a work-item may take together, more than any where unlimited."""
        return self.longest_loop or sys.maxsize

    @property
    def slice_rows(self) -> int:
        """C of SELL-C-sigma, rows of a slice: a multiple of `width` that divides `tile`."""
        return math.gcd(self.tile, 16)

    @property
    def lanes(self) -> int:
        """Float64 lanes of a work-item: as many bytes as the float32 ones, but not more than 8."""
        return max(1, min(8, self.width // 2)) if self.float64 else 1


def choose_constants(device: cl.Device, quirks: frozenset[str] | None = None) -> BuildConstants:
    """Return constants for a device, by its type, limits and quirks, which are found by default."""
    if quirks is None:
        quirks = find_quirks(device)
    if device.type & cl.device_type.CPU:
        vector = int(device.native_vector_width_float)
        largest = device.max_work_group_size
        constants = cpu_constants(vector) if vector > 1 else lanes_constants(largest)
    else:
        constants = gpu_constants(device.max_work_group_size)
    return apply_quirks(constants, quirks)


def apply_quirks(constants: BuildConstants, quirks: frozenset[str]) -> BuildConstants:
    """Return constants that work around quirks."""
    made = constants
    if "small_groups" in quirks:
        made = replace(
            made, group=min(made.group, 16), tile_group=min(made.tile_group, 4),
            step_group=min(made.step_group, 16),
        )  # fmt: skip
    if "inexact_exp2" in quirks:
        made = replace(made, exp2_builtin=0)
    if "no_vectors" in quirks:
        made = replace(made, width=1, rows=1, unroll=min(made.unroll, 8))
    if "no_float64" in quirks:
        made = replace(made, precise=1, float64=0)
    if "slow_float64" in quirks:
        made = replace(made, precise=1)
    if "short_loops" in quirks:
        made = replace(made, longest_loop=made.longest_loop or LONGEST_LOOP)
    if "small_local_memory" in quirks:
        tile = max(16, made.width)
        group = min(made.group, tile // made.width)
        made = replace(
            made, tile=tile, group=group, step_group=min(made.step_group, 64),
            unroll=min(made.unroll, tile),
        )  # fmt: skip
    return made


def cpu_constants(vector: int) -> BuildConstants:
    """Return constants for a CPU with vectors of `vector` floats."""
    width = next(width for width in (16, 8, 4, 2, 1) if width <= max(1, vector))
    return BuildConstants(width, group=1, unroll=32 if width == 16 else 8, tile_group=1)


def lanes_constants(largest_group: int) -> BuildConstants:
    """Return constants for a CPU whose driver (llvmpipe) puts work-items into SIMD lanes."""
    # Every number is read lane by lane, for four rows: with eight it takes minutes to compile.
    sides = (8, 4, 2, 1)
    group = next(group for group in (16, *sides) if group <= largest_group)
    tile_group = next(side for side in sides if side**2 <= largest_group)
    return BuildConstants(4, group, unroll=4, tile_group=tile_group, step_group=group)


def gpu_constants(largest_group: int) -> BuildConstants:
    """Return constants for a GPU whose work-groups have at most `largest_group` items."""
    return BuildConstants(
        width=1,
        group=next(group for group in (64, 32, 16, 8, 4, 2, 1) if group <= largest_group),
        unroll=8,
        tile_group=next(side for side in (16, 8, 4, 2, 1) if side**2 <= largest_group),
        exp2_builtin=1,
        slices_per_unit=64,
        rows=4 if largest_group >= 4 else 1,
        step_group=1 << min(8, largest_group.bit_length() - 1),
    )
