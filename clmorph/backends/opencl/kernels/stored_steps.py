"""The host side of ``cl_kernels/stored_steps.cl``: iterations over stored pairs on the device."""

import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

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
#: The numbers of those arguments of the kernels of a stage that change from launch to launch.
CONTROL, STAGE, RADIUS = 2, 3, 11
#: The share of the limits of memory that buffers may take: a pool rounds sizes up.
MOST_MEMORY = 7 / 8


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
    buffers : dict of buffers
        ``given_rows`` and ``given_columns`` hold vectors that the host writes, ``rows`` and
        ``columns`` those that kernels write, (slots, stride) float64.
    origin : (M,) array
        Potential of the columns for which the pairs were stored.
    counted : (M,) array of bool
        The columns of positive mass.
    row_middle : float
        Midrange of the changes of f at the center of the trust region, cost units.
    epsilon : float
    """

    steps: "StoredSteps"
    pairs: tuple[Side, Side]
    balanced: int
    scalars: tuple[float, float, float, float]
    buffers: dict[str, Any]
    origin: Float64
    counted: NDArray[np.bool_]
    row_middle: float
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

    Attributes
    ----------
    most_groups : int
        Largest number of work-groups of a loop over vectors.
    """

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        self._work, self._constants, self._programs = loop.work, loop.constants, loop.programs
        self._kernels: dict[int, dict[str, cl.Kernel]] = {}
        #: The iteration for which the kernels' arguments are set.
        self._bound: dict[int, weakref.ref[StoredIteration] | None] = {}
        self.most_groups: int = GROUPS_PER_UNIT * loop.work.device.max_compute_units
        self.set_potential = take_turns(self._set_potential)
        self.iterate = take_turns(self._iterate)
        self.potentials = take_turns(self._potentials)

    def start_stored_iteration(
        self,
        stored: StoredPairs,
        vectors: tuple[StoredVectors, StoredVectors],
        center: Float64,
        inverse_rho: tuple[float, float],
        over: StoredIteration | None = None,
    ) -> StoredIteration | None:
        """Put the vectors of an iteration on the device, or return None."""
        if not Variant("stored_steps.cl").suits(self._constants):
            return None
        pairs: tuple[Side, Side] = stored.pairs
        balanced = int(inverse_rho[0] == 0) + 2 * int(inverse_rho[1] == 0)
        self._own_kernels(balanced)
        buffers = self._buffers(pairs) if over is None else over.buffers
        if buffers is None:
            return None
        rows, columns = vectors
        self._give(buffers["given_rows"], pairs[0], rows, center)
        self._give(buffers["given_columns"], pairs[1], columns)
        moved = (center - rows.origin)[rows.masses > 0]
        return StoredIteration(
            self, pairs, balanced,
            (*inverse_rho, float(rows.masses.sum()), float(columns.masses.sum())), buffers,
            columns.origin, columns.masses > 0, 0.5 * float(moved.min() + moved.max()),
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
            "partials": 8 * PARTIALS * self._groups(longest), "scalars": 8 * SCALARS,
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
        self, buffer: cl.MemoryObject, side: Side, vectors: StoredVectors, *more: Float64
    ) -> None:
        """Write the vectors of a side that the host has."""
        with np.errstate(divide="ignore"):
            logarithms = np.log(vectors.masses)
        own = vectors.masses, logarithms, vectors.base, vectors.alone, vectors.origin, *more
        # Points that pad a side have no mass.
        fillers = {"LOG_WEIGHTS": -np.inf}
        values = np.stack([
            pad(each, side.rows.stride, fillers.get(name, 0.0))
            for name, each in zip(GIVEN[: len(own)], own, strict=True)
        ])  # fmt: skip
        cl.enqueue_copy(self._work.queue, buffer, values, is_blocking=True)

    def _groups(self, stride: int) -> int:
        """Return the number of work-groups of the loops over vectors of a length."""
        return min(self.most_groups, -(-stride // (self._constants.group * self._constants.lanes)))

    def _set_potential(self, iteration: StoredIteration, g: Float64, epsilon: float) -> None:
        """Write the potential at which the next iteration begins; see `ResidentIteration`."""
        work, k = self._work, LOG2_E / epsilon
        if epsilon != iteration.epsilon:
            self._bound[iteration.balanced] = None
        iteration.epsilon = epsilon
        iteration.go_to_start()
        changes = (g - iteration.origin)[iteration.counted] * k
        np.clip(changes, -LARGEST_CHANGE, LARGEST_CHANGE, out=changes)
        iteration.numbers[:] = 0.0
        middles = k * iteration.row_middle, 0.5 * float(changes.min() + changes.max())
        for name, middle in zip(("ROW_NEXT", "COLUMN_NEXT"), middles, strict=True):
            iteration.numbers[NUMBERS.index(name)] = middle
        values = pad(np.asarray(g, float), iteration.pairs[1].rows.stride, 0.0)
        for name, content in (("start", values), ("numbers", iteration.numbers)):
            cl.enqueue_copy(work.queue, iteration.buffers[name], content, is_blocking=True)

    def _iterate(
        self, iteration: StoredIteration, begun: bool, place: int, count: int, radius: float
    ) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        work, own = self._work, iteration.buffers
        kernels = self._bind(iteration)
        control = iteration.control(begun, place, count)
        group, width = self._constants.group, self._constants.width
        groups = self._groups(max(side.rows.stride for side in iteration.pairs))
        events: list[cl.Event] = []

        def enqueue(name: str, size: int, local: int | None, arguments: dict[int, Any]) -> None:
            kernel = kernels[name]
            for number, argument in arguments.items():
                kernel.set_arg(number, argument)
            shape = None if local is None else (local,)
            events.append(
                cl.enqueue_nd_range_kernel(work.queue, kernel, (size,), shape, wait_for=events[-1:])
            )

        def half_step(side: int) -> None:
            changes = own["row_changes"], own["column_changes"]
            for part in iteration.pairs[side].parts:
                arguments = *part.arguments, changes[1 - side], own["maxima"], own["sums"]
                enqueue("sum_stored", part.n_rows // width, None, dict(enumerate(arguments)))
            changing = {CONTROL: control, RADIUS: np.float64(radius)}
            for stage in range(STAGES[iteration.balanced][side]):
                changing[STAGE] = np.uint32(stage)
                name = ("row", "column")[side]
                enqueue(f"{name}_loops", groups * group, group, changing)
                enqueue(f"{name}_joins", group, group, changing)

        prepared, iteration.prepared = iteration.prepared, -1
        try:
            if prepared != iteration.at:
                enqueue("prepare_changes", groups * group, group, {1: control})
            half_step(0)
            half_step(1)
            events.append(
                cl.enqueue_copy(
                    work.queue, iteration.numbers, own["numbers"], is_blocking=False,
                    wait_for=events[-1:],
                )
            )  # fmt: skip
            events[-1].wait()
        except BaseException:
            # Ctrl-C may come between a command and the list of its event.
            work.queue.finish()
            raise
        found = dict(zip(NUMBERS, iteration.numbers.tolist(), strict=True))
        iteration.has_prepared(bool(found["FOUND"]))
        return read_numbers(found)

    def _potentials(self, iteration: StoredIteration) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        found = []
        for side, name, slot in (
            (0, "rows", ROW_SLOTS.index("SHIFTED")), (1, "columns", iteration.image),
            (1, "columns", COLUMN_SLOTS.index("SOFTMIN")),
        ):  # fmt: skip
            cloud = iteration.pairs[side].rows
            values = np.empty(len(cloud))
            cl.enqueue_copy(
                self._work.queue, values, iteration.buffers[name],
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

    def _bind(self, iteration: StoredIteration) -> dict[str, cl.Kernel]:
        """Return kernels with all arguments set that stay the same while an iteration goes on.

        To set an argument takes some microseconds, and a launch has more than twenty.
        """
        balanced = iteration.balanced
        kernels = self._own_kernels(balanced)
        bound = self._bound.get(balanced)
        if bound is not None and bound() is iteration:
            return kernels
        self._bound[balanced] = None
        own = iteration.buffers
        rows, columns = (np.uint32(side.rows.stride) for side in iteration.pairs)
        groups = np.uint32(self._groups(max(int(rows), int(columns))))
        k, none = np.float64(LOG2_E / iteration.epsilon), np.uint32(0)
        numbers = map(np.float64, (iteration.epsilon, *iteration.scalars, 0.0))
        names = "maxima", "sums", "given_rows", "given_columns", "rows", "columns"
        after = "partials", "scalars", "products", "numbers"
        head = (rows, columns, none, none, groups, k, *numbers, *(own[name] for name in names))
        for side in ("row", "column"):
            arguments = *head, own[f"{side}_changes"], *(own[name] for name in after)
            for kind in ("loops", "joins"):
                for number, argument in enumerate(arguments):
                    kernels[f"{side}_{kind}"].set_arg(number, argument)
        prepare = (
            columns, none, k, own["start"], own["given_columns"], own["columns"],
            own["column_changes"], own["numbers"],
        )  # fmt: skip
        for number, argument in enumerate(prepare):
            kernels["prepare_changes"].set_arg(number, argument)
        self._bound[balanced] = weakref.ref(iteration)
        return kernels
