"""The host of ``cl_kernels/sparse_half_steps.cl``: iterations over stored pairs on the device."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import sparse_half_step_slots as slots
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.clouds import pad
from clmorph.backends.opencl.kernels.resident_iteration import (
    BoundKernels,
    DeviceIteration,
    Launch,
    ResidentSteps,
)
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.opencl.kernels.sliced_ellpack import Side
from clmorph.backends.records import Float64, StoredPairs, StoredVectors

#: Work-groups of a loop over vectors, for each compute unit, and at most: each of them joins what
#: all of them have found.
GROUPS_PER_UNIT, MOST_GROUPS = 8, 256
#: The kernels that follow the sums over stored pairs by row, and by column, and one that prepares
#: the first sum.
STAGES = (
    ("row_softmins", "row_step"),
    ("column_softmins", "column_step", "extrapolate", "next_potential"),
)  # fmt: skip
PREPARATION, END = "prepare_changes", "end_iteration"
#: Names of the arguments of kernels, in their order.
_RATES, _MASSES = ("inverse_rho_source", "inverse_rho_target"), ("source_mass", "target_mass")
_STAGE = (
    "n", "m", "control", "k", "epsilon", *_RATES, *_MASSES, "given_rows", "given_columns",
    "rows", "columns", "partials", "numbers",
)  # fmt: skip
_OWN = {
    PREPARATION: ("start", "column_changes"),
    "row_softmins": ("maxima", "sums"),
    "row_step": ("row_changes",),
    "column_softmins": ("maxima", "sums"),
    "column_step": (),
    "extrapolate": ("products", "newest"),
    "next_potential": ("radius", "column_changes"),
    END: ("groups", "newest", "products"),
}
ARGUMENTS = {name: (*_STAGE, *own) for name, own in _OWN.items()}
#: The share of the limits of memory that buffers may take: a pool rounds sizes up.
MOST_MEMORY = 7 / 8


class StoredSteps(ResidentSteps):
    """Iterations over stored pairs.

    most_groups: largest number of work-groups of a loop over vectors.
    """

    variant = Variant("sparse_half_steps.cl")

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        super().__init__(loop, take_turns)
        units = loop.work.device.max_compute_units
        self.most_groups: int = min(MOST_GROUPS, GROUPS_PER_UNIT * units)

    def start_stored_iteration(
        self, stored: StoredPairs, vectors: tuple[StoredVectors, StoredVectors], center: Float64,
        inverse_rho: tuple[float, float], over: "StoredIteration | None" = None,
    ) -> "StoredIteration | None":  # fmt: skip
        """Put the vectors of an iteration on the device, or return None."""
        if not self.is_possible():
            return None
        self.kernels()
        buffers = self._buffers(stored.pairs) if over is None else over.arguments
        if buffers is None:
            return None
        return StoredIteration(self, stored.pairs, buffers, vectors, center, inverse_rho)

    def _buffers(self, pairs: tuple[Side, Side]) -> dict[str, cl.MemoryObject] | None:
        """Return the buffers of an iteration, or None if the device's memory is too small."""
        rows, columns = (side.rows.stride for side in pairs)
        longest = max(rows, columns)
        sizes = {
            "given_rows": 8 * len(slots.GIVEN) * rows,
            "given_columns": 8 * (len(slots.GIVEN) - 1) * columns,
            "rows": 8 * len(slots.ROW_SLOTS) * rows,
            "columns": 8 * (len(slots.COLUMN_SLOTS) - 2 + 2 * MEMORY) * columns,
            "start": 8 * columns, "maxima": 4 * longest, "sums": 4 * longest,
            "row_changes": 4 * rows, "column_changes": 4 * columns,
            "partials": 16 * slots.PARTIALS * self.groups(longest), "newest": 8 * MEMORY,
            "products": 8 * MEMORY**2, "numbers": 8 * len(slots.NUMBERS),
        }  # fmt: skip
        device = self.loop.work.device
        largest, total = max(sizes.values()), sum(sizes.values())
        limits = (
            MOST_MEMORY * device.max_mem_alloc_size,
            MOST_MEMORY * (device.global_mem_size // 4),
        )
        if largest > limits[0] or total > limits[1]:
            return None
        try:
            return {name: self.loop.work.empty(size) for name, size in sizes.items()}
        except (cl.MemoryError, MemoryError):
            return None

    def groups(self, stride: int) -> int:
        """Return the number of work-groups of the loops over vectors of a length."""
        constants = self.loop.constants
        return min(self.most_groups, -(-stride // (constants.group * constants.lanes)))

    def kernels(self) -> BoundKernels:
        """Return the kernels of all iterations."""
        if None not in self.bound:
            kernels = self.loop.programs.kernels(self.variant)
            sums = self.loop.programs.kernels(Variant("sliced_ellpack.cl"))
            self.bound[None] = BoundKernels(
                {**kernels, "sum_stored": sums["sum_stored"]}, ARGUMENTS
            )
        return self.bound[None]


class StoredIteration(DeviceIteration):
    """An iteration over the pairs that are stored by row and by column."""

    slots = slots

    def __init__(
        self, steps: StoredSteps, pairs: tuple[Side, Side], buffers: dict[str, cl.MemoryObject],
        vectors: tuple[StoredVectors, StoredVectors], center: Float64,
        inverse_rho: tuple[float, float],
    ) -> None:  # fmt: skip
        rows, columns = vectors
        largest = max(float(np.abs(x).max()) for x in (rows.alone, columns.alone, center))
        units = steps.units(largest, float(rows.masses.sum()))
        super().__init__(steps, (pairs[0].rows, pairs[1].rows), units, dict(buffers))
        self.numbers, self._pairs = np.zeros(len(slots.NUMBERS)), pairs
        self._origin, self._counted = columns.origin, columns.masses > 0
        self._give("given_rows", self.sides[0].stride, rows, center)
        self._give("given_columns", self.sides[1].stride, columns)
        moved = (center - rows.origin)[rows.masses > 0]
        #: The midrange of the changes of f at the center of the trust region, cost units.
        self._row_middle = 0.5 * float(moved.min() + moved.max())
        n, m = (side.stride for side in self.sides)
        sizes = {"n": n, "m": m, "groups": steps.groups(max(n, m))}
        rates, masses = np.multiply(inverse_rho, units[0]), [own.masses.sum() for own in vectors]
        given = *rates, *np.divide(masses, units[1])
        self.arguments |= {name: np.uint32(size) for name, size in sizes.items()}
        self.arguments |= dict(zip((*_RATES, *_MASSES), map(steps.real, given), strict=True))

    def _give(self, name: str, stride: int, vectors: StoredVectors, *more: Float64) -> None:
        """Write the vectors of a side that the host has."""
        masses = vectors.masses / self.units[1]
        with np.errstate(divide="ignore"):
            logarithms = np.log(masses)
        costs = vectors.base, vectors.alone, vectors.origin, *more
        own = masses, logarithms, *(each / self.units[0] for each in costs)
        # Points that pad a side have no mass.
        fillers = 0.0, -np.inf, *(0.0 for _ in costs)
        values = [pad(each, stride, filler) for each, filler in zip(own, fillers, strict=True)]
        buffer, packed = self.arguments[name], self.steps.packed(np.stack(values))
        cl.enqueue_copy(self.loop.work.queue, buffer, packed, is_blocking=True)

    def _begin(self, g: Float64) -> dict[str, Float64]:
        k = LOG2_E / self.epsilon
        changes = (g - self._origin)[self._counted] * k
        np.clip(changes, -slots.LARGEST_CHANGE, slots.LARGEST_CHANGE, out=changes)
        self.numbers[:] = 0.0
        middles = k * self._row_middle, 0.5 * float(changes.min() + changes.max())
        for name, middle in zip(("ROW_NEXT", "COLUMN_NEXT"), middles, strict=True):
            self.numbers[slots.NUMBERS.index(name)] = middle
        start = pad(g / self.units[0], self.sides[1].stride, 0.0)
        return {"start": start, "numbers": self.numbers}

    def _launches(self, prepare: bool) -> Iterator[Launch]:
        own, sums = self.arguments, self._kernels().kernels["sum_stored"]
        group, width = self.loop.constants.group, self.loop.constants.width
        size = (int(own["groups"]) * group,)
        if prepare:
            yield PREPARATION, size, (group,)
        for side, changes in enumerate(("column_changes", "row_changes")):
            for part in self._pairs[side].parts:
                arguments = *part.arguments, own[changes], own["maxima"], own["sums"]
                for number, argument in enumerate(arguments):
                    sums.set_arg(number, argument)
                yield "sum_stored", (part.n_rows // width,), None
            for name in STAGES[side]:
                yield name, size, (group,)
        yield END, (group,), (group,)

    def _kernels(self) -> BoundKernels:
        return self.steps.kernels()
