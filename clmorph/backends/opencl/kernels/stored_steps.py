"""The host side of ``cl_kernels/stored_steps.cl``: iterations over stored pairs on the device."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build.stored_step_slots import (
    COLUMN_SLOTS,
    GIVEN,
    LARGEST_CHANGE,
    NUMBERS,
    PARTIALS,
    ROW_SLOTS,
    SCALARS,
    STAGES,
)
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.clouds import pad
from clmorph.backends.opencl.kernels.potential_places import PotentialPlaces, read_numbers
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.opencl.kernels.sliced_ellpack import Side
from clmorph.backends.records import Float64, IterationNumbers, StoredPairs, StoredVectors

#: Work-groups of a loop over vectors, for each compute unit.
GROUPS_PER_UNIT = 8


@dataclass(eq=False)
class StoredIteration(PotentialPlaces):
    """An iteration over stored pairs, as `clmorph.backends.interface.ResidentIteration` has it.

    Attributes
    ----------
    steps : StoredSteps
    pairs : (Side, Side)
        The stored pairs by row and by column.
    balanced : int
    scalars : tuple of float
        Inverses of the marginal penalties, and the masses of both sides.
    given, vectors : (buffer, buffer)
        Vectors of the rows and of the columns, (slots, stride) float64: of the host, and others.
    work : dict of buffers
    origin : (M,) array
        Potential of the columns for which the pairs were stored.
    epsilon : float
    """

    steps: "StoredSteps"
    pairs: tuple[Side, Side]
    balanced: int
    scalars: tuple[float, float, float, float]
    given: tuple[cl.MemoryObject, cl.MemoryObject]
    vectors: tuple[cl.MemoryObject, cl.MemoryObject]
    work: dict[str, Any]
    origin: Float64
    numbers: Float64 = field(default_factory=lambda: np.zeros(len(NUMBERS)))
    epsilon: float = 0.0

    def __post_init__(self) -> None:
        self.place(COLUMN_SLOTS)

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potential at which the next iteration begins; exponents are small in any case."""
        self.steps.set_potential(self, g, epsilon)

    def iterate(self, begun: bool, place: int, count: int, radius: float) -> IterationNumbers:
        """Run one iteration, with one wait."""
        return self.steps.iterate(self, begun, place, count, radius)

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        return self.steps.potentials(self)


class StoredSteps:
    """Iterations over stored pairs on the device.

    Parameters
    ----------
    loop : RowLoop
    take_turns : callable
        Makes methods run one at a time on a device, see `OpenCLOperations`.
    """

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        self._work, self._constants, self._programs = loop.work, loop.constants, loop.programs
        self._kernels: dict[int, dict[str, cl.Kernel]] = {}
        self.set_potential = take_turns(self._set_potential)
        self.iterate = take_turns(self._iterate)
        self.potentials = take_turns(self._potentials)

    def start_stored_iteration(
        self,
        stored: StoredPairs,
        vectors: tuple[StoredVectors, StoredVectors],
        center: Float64,
        inverse_rho: tuple[float, float],
    ) -> StoredIteration | None:
        """Put the vectors of an iteration on the device, or return None."""
        work, device = self._work, self._work.device
        pairs: tuple[Side, Side] = stored.pairs
        strides = tuple(side.rows.stride for side in pairs)
        slots = len(ROW_SLOTS), len(COLUMN_SLOTS) - 2 + 2 * MEMORY
        n_bytes = [8 * count * stride for count, stride in zip(slots, strides, strict=True)]
        if (
            not Variant("stored_steps.cl").suits(self._constants)
            or max(n_bytes) > device.max_mem_alloc_size
            or sum(n_bytes) > device.global_mem_size // 4
        ):
            return None
        given = (
            self._given(vectors[0], strides[0], center), self._given(vectors[1], strides[1])
        )  # fmt: skip
        buffers = work.empty(n_bytes[0]), work.empty(n_bytes[1])
        longest, groups = max(strides), self._groups(max(strides))
        sizes = {
            "start": 8 * strides[1], "maxima": 4 * longest, "sums": 4 * longest,
            "row_changes": 4 * strides[0], "column_changes": 4 * strides[1],
            "partials": 8 * PARTIALS * groups, "scalars": 8 * SCALARS, "products": 8 * MEMORY**2,
            "numbers": 8 * len(NUMBERS),
        }  # fmt: skip
        balanced = int(inverse_rho[0] == 0) + 2 * int(inverse_rho[1] == 0)
        rows, columns = (float(each.masses.sum()) for each in vectors)
        return StoredIteration(
            self, pairs, balanced, (*inverse_rho, rows, columns), given, buffers,
            {name: work.empty(size) for name, size in sizes.items()}, vectors[1].origin,
        )  # fmt: skip

    def _given(self, vectors: StoredVectors, stride: int, *more: Float64) -> cl.MemoryObject:
        """Return a buffer of the vectors that the host writes for a side."""
        with np.errstate(divide="ignore"):
            logarithms = np.log(vectors.masses)
        own = vectors.masses, logarithms, vectors.base, vectors.alone, vectors.origin, *more
        # Points that pad a side have no mass.
        fillers = {"LOG_WEIGHTS": -np.inf}
        values = np.stack([
            pad(each, stride, fillers.get(name, 0.0))
            for name, each in zip(GIVEN[: len(own)], own, strict=True)
        ])  # fmt: skip
        buffer = self._work.empty(values.nbytes)
        cl.enqueue_copy(self._work.queue, buffer, values, is_blocking=True)
        return buffer

    def _groups(self, stride: int) -> int:
        """Return the number of work-groups of the loops over vectors of a length."""
        at_once = self._constants.group * self._constants.lanes
        most: int = GROUPS_PER_UNIT * self._work.device.max_compute_units
        return min(most, -(-stride // at_once))

    def _set_potential(self, iteration: StoredIteration, g: Float64, epsilon: float) -> None:
        """Write the potential at which the next iteration begins; see `ResidentIteration`."""
        work, stride = self._work, iteration.pairs[1].rows.stride
        iteration.epsilon = epsilon
        iteration.go_to_start()
        changes = (g - iteration.origin) * (LOG2_E / epsilon)
        np.clip(changes, -LARGEST_CHANGE, LARGEST_CHANGE, out=changes)
        iteration.numbers[:] = 0.0
        middle = 0.5 * float(changes.min() + changes.max())
        iteration.numbers[NUMBERS.index("COLUMN_NEXT")] = middle
        values = pad(np.asarray(g, float), stride, 0.0)
        cl.enqueue_copy(work.queue, iteration.work["start"], values, is_blocking=True)
        cl.enqueue_copy(work.queue, iteration.work["numbers"], iteration.numbers, is_blocking=True)

    def _iterate(
        self, iteration: StoredIteration, begun: bool, place: int, count: int, radius: float
    ) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        work, own = self._work, iteration.work
        kernels = self._own_kernels(iteration.balanced)
        control = iteration.control(begun, place, count)
        k = np.float64(LOG2_E / iteration.epsilon)
        rows, columns = (side.rows.stride for side in iteration.pairs)
        sizes = np.uint32(rows), np.uint32(columns)
        group, width = self._constants.group, self._constants.width
        groups = self._groups(max(rows, columns))
        events: list[cl.Event] = []

        def enqueue(name: str, size: int, local: int | None, *arguments: Any) -> None:
            kernel = kernels[name]
            for number, argument in enumerate(arguments):
                kernel.set_arg(number, argument)
            shape = None if local is None else (local,)
            events.append(
                cl.enqueue_nd_range_kernel(work.queue, kernel, (size,), shape, wait_for=events[-1:])
            )

        def half_step(side: int) -> None:
            changes = own["row_changes"], own["column_changes"]
            for part in iteration.pairs[side].parts:
                enqueue(
                    "sum_stored", part.n_rows // width, None, *part.arguments, changes[1 - side],
                    own["maxima"], own["sums"],
                )  # fmt: skip
            for stage in range(STAGES[iteration.balanced][side]):
                arguments = (
                    *sizes, control, np.uint32(stage), np.uint32(groups), k,
                    *map(np.float64, (iteration.epsilon, *iteration.scalars, radius)),
                    own["maxima"], own["sums"], *iteration.given, *iteration.vectors,
                    changes[side], own["partials"], own["scalars"], own["products"],
                    own["numbers"],
                )  # fmt: skip
                name = ("row", "column")[side]
                enqueue(f"{name}_loops", groups * group, group, *arguments)
                enqueue(f"{name}_joins", group, group, *arguments)

        prepared, iteration.prepared = iteration.prepared, -1
        try:
            if prepared != iteration.at:
                enqueue(
                    "prepare_changes", groups * group, group, sizes[1], control, k,
                    own["start"], iteration.given[1], iteration.vectors[1], own["column_changes"],
                    own["numbers"],
                )  # fmt: skip
            half_step(0)
            half_step(1)
            events.append(
                cl.enqueue_copy(
                    work.queue, iteration.numbers, own["numbers"], is_blocking=False,
                    wait_for=events[-1:],
                )
            )  # fmt: skip
        finally:
            if events:
                cl.wait_for_events(events[-1:])
        found = dict(zip(NUMBERS, iteration.numbers.tolist(), strict=True))
        iteration.has_prepared(bool(found["FOUND"]))
        return read_numbers(found)

    def _potentials(self, iteration: StoredIteration) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        found = []
        for side, slot in (
            (0, ROW_SLOTS.index("SHIFTED")), (1, iteration.image),
            (1, COLUMN_SLOTS.index("SOFTMIN")),
        ):  # fmt: skip
            cloud = iteration.pairs[side].rows
            values = np.empty(len(cloud))
            cl.enqueue_copy(
                self._work.queue, values, iteration.vectors[side],
                src_offset=8 * slot * cloud.stride, is_blocking=True,
            )  # fmt: skip
            found.append(values)
        return found[0], found[1], found[2]

    def _own_kernels(self, balanced: int) -> dict[str, cl.Kernel]:
        """Return kernels whose arguments nothing else sets."""
        if balanced not in self._kernels:
            kernels = self._programs.kernels(Variant("stored_steps.cl", balanced=balanced))
            sums = self._programs.kernels(Variant("sliced_ellpack.cl"))
            self._kernels[balanced] = {**kernels, "sum_stored": sums["sum_stored"]}
        return self._kernels[balanced]
