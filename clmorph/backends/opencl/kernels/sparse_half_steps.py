"""The host of ``cl_kernels/sparse_half_steps.cl``: iterations over stored pairs on the device."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import sparse_half_step_slots
from clmorph.backends.opencl.build.sparse_half_step_slots import (
    COLUMN_SLOTS,
    GIVEN,
    LARGEST_CHANGE,
    NUMBERS,
    PARTIALS,
    ROW_SLOTS,
)
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


@dataclass(eq=False, kw_only=True)
class StoredIteration(DeviceIteration):
    """An iteration over the pairs that are stored by row and by column.

    It has the potential of the columns for which they were stored, which columns have mass, and
    the midrange of the changes of f at the center of the trust region, cost units.
    """

    pairs: tuple[Side, Side]
    origin: Float64
    counted: NDArray[np.bool_]
    row_middle: float


class StoredSteps(ResidentSteps[StoredIteration]):
    """Iterations over stored pairs.

    most_groups: largest number of work-groups of a loop over vectors.
    """

    variant, slots = Variant("sparse_half_steps.cl"), sparse_half_step_slots

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        super().__init__(loop, take_turns)
        self._bound: BoundKernels | None = None
        units = loop.work.device.max_compute_units
        self.most_groups: int = min(MOST_GROUPS, GROUPS_PER_UNIT * units)

    def start_stored_iteration(
        self,
        stored: StoredPairs,
        vectors: tuple[StoredVectors, StoredVectors],
        center: Float64,
        inverse_rho: tuple[float, float],
        over: StoredIteration | None = None,
    ) -> StoredIteration | None:
        """Put the vectors of an iteration on the device, or return None."""
        if not self.is_possible():
            return None
        pairs: tuple[Side, Side] = stored.pairs
        self._kernels()
        buffers = self._buffers(pairs) if over is None else over.arguments
        if buffers is None:
            return None
        rows, columns = vectors
        largest = max(float(np.abs(x).max()) for x in (rows.alone, columns.alone, center))
        units = self._chosen_units(largest, float(rows.masses.sum()))
        self._give(buffers["given_rows"], pairs[0], units, rows, center)
        self._give(buffers["given_columns"], pairs[1], units, columns)
        moved = (center - rows.origin)[rows.masses > 0]
        sides = pairs[0].rows, pairs[1].rows
        n, m = (side.stride for side in sides)
        sizes = {"n": n, "m": m, "groups": self._groups(max(n, m))}
        rates, masses = (
            np.multiply(inverse_rho, units[0]),
            (rows.masses.sum(), columns.masses.sum()),
        )
        given = *rates, *np.divide(masses, units[1])
        arguments = {
            **buffers,
            **{name: np.uint32(size) for name, size in sizes.items()},
            **dict(zip((*_RATES, *_MASSES), map(self._real, given), strict=True)),
        }  # fmt: skip
        return StoredIteration(
            self, sides, arguments, np.zeros(len(NUMBERS)), units,
            pairs=pairs, origin=columns.origin, counted=columns.masses > 0,
            row_middle=0.5 * float(moved.min() + moved.max()),
        )  # fmt: skip

    def _buffers(self, pairs: tuple[Side, Side]) -> dict[str, cl.MemoryObject] | None:
        """Return the buffers of an iteration, or None if the device's memory is too small."""
        rows, columns = (side.rows.stride for side in pairs)
        longest = max(rows, columns)
        sizes = {
            "given_rows": 8 * len(GIVEN) * rows, "given_columns": 8 * (len(GIVEN) - 1) * columns,
            "rows": 8 * len(ROW_SLOTS) * rows,
            "columns": 8 * (len(COLUMN_SLOTS) - 2 + 2 * MEMORY) * columns,
            "start": 8 * columns, "maxima": 4 * longest, "sums": 4 * longest,
            "row_changes": 4 * rows, "column_changes": 4 * columns,
            "partials": 16 * PARTIALS * self._groups(longest), "newest": 8 * MEMORY,
            "products": 8 * MEMORY**2, "numbers": 8 * len(NUMBERS),
        }  # fmt: skip
        device = self._work.device
        largest, total = max(sizes.values()), sum(sizes.values())
        if largest > MOST_MEMORY * device.max_mem_alloc_size:
            return None
        if total > MOST_MEMORY * (device.global_mem_size // 4):
            return None
        try:
            return {name: self._work.empty(size) for name, size in sizes.items()}
        except (cl.MemoryError, MemoryError):
            return None

    def _give(
        self, buffer: cl.MemoryObject, side: Side, units: tuple[float, float],
        vectors: StoredVectors, *more: Float64,
    ) -> None:  # fmt: skip
        """Write the vectors of a side that the host has."""
        masses = vectors.masses / units[1]
        with np.errstate(divide="ignore"):
            logarithms = np.log(masses)
        costs = vectors.base, vectors.alone, vectors.origin, *more
        own = masses, logarithms, *(each / units[0] for each in costs)
        # Points that pad a side have no mass.
        fillers = {"LOG_WEIGHTS": -np.inf}
        values = np.stack([
            pad(each, side.rows.stride, fillers.get(name, 0.0))
            for name, each in zip(GIVEN[: len(own)], own, strict=True)
        ])  # fmt: skip
        cl.enqueue_copy(self._work.queue, buffer, self._packed(values), is_blocking=True)

    def _groups(self, stride: int) -> int:
        """Return the number of work-groups of the loops over vectors of a length."""
        return min(self.most_groups, -(-stride // (self._constants.group * self._constants.lanes)))

    def _begin(self, iteration: StoredIteration, g: Float64) -> dict[str, Float64]:
        k = LOG2_E / iteration.epsilon
        changes = (g - iteration.origin)[iteration.counted] * k
        np.clip(changes, -LARGEST_CHANGE, LARGEST_CHANGE, out=changes)
        iteration.numbers[:] = 0.0
        middles = k * iteration.row_middle, 0.5 * float(changes.min() + changes.max())
        for name, middle in zip(("ROW_NEXT", "COLUMN_NEXT"), middles, strict=True):
            iteration.numbers[NUMBERS.index(name)] = middle
        start = pad(g / iteration.units[0], iteration.sides[1].stride, 0.0)
        return {"start": self._packed(start), "numbers": self._packed(iteration.numbers)}

    def _in_order(self, side: Any, values: Float64) -> Float64:
        return values

    def _launches(self, iteration: StoredIteration, prepare: bool) -> Iterator[Launch]:
        own, sums = iteration.arguments, self._kernels().kernels["sum_stored"]
        group, width = self._constants.group, self._constants.width
        size = (int(own["groups"]) * group,)
        if prepare:
            yield PREPARATION, size, (group,)
        for side, changes in enumerate(("column_changes", "row_changes")):
            for part in iteration.pairs[side].parts:
                arguments = *part.arguments, own[changes], own["maxima"], own["sums"]
                for number, argument in enumerate(arguments):
                    sums.set_arg(number, argument)
                yield "sum_stored", (part.n_rows // width,), None
            for name in STAGES[side]:
                yield name, size, (group,)
        yield END, (group,), (group,)

    def _kernels(self, iteration: StoredIteration | None = None) -> BoundKernels:
        if self._bound is None:
            kernels = self._programs.kernels(self.variant)
            sums = self._programs.kernels(Variant("sliced_ellpack.cl"))
            self._bound = BoundKernels({**kernels, "sum_stored": sums["sum_stored"]}, ARGUMENTS)
        return self._bound
