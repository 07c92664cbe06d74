"""The host of ``cl_kernels/sparse_half_steps.cl``: iterations over stored pairs on the device."""

import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import MEMORY
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
from clmorph.backends.opencl.kernels.potential_places import PotentialPlaces, read_numbers
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.opencl.kernels.sliced_ellpack import Side
from clmorph.backends.records import Float64, IterationNumbers, StoredPairs, StoredVectors

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
_SIZES, _RATES = ("n", "m"), ("epsilon", "inverse_rho_source", "inverse_rho_target")
_MASSES, _GIVEN = ("source_mass", "target_mass"), ("given_rows", "given_columns")
_VECTORS, _FOUND = ("rows", "columns"), ("partials", "numbers")
ARGUMENTS = {
    PREPARATION: (
        "m", "control", "k", "start", "given_columns", "columns", "column_changes", "numbers",
    ),
    "row_softmins": (
        *_SIZES, "control", "k", *_RATES, "maxima", "sums", *_GIVEN, *_VECTORS, *_FOUND,
    ),
    "row_step": (
        *_SIZES, "control", "k", *_RATES, "source_mass", *_GIVEN, *_VECTORS, "row_changes", *_FOUND,
    ),
    "column_softmins": (
        *_SIZES, "k", *_RATES, *_MASSES, "maxima", "sums", *_GIVEN, *_VECTORS, *_FOUND,
    ),
    "column_step": (*_SIZES, "control", *_RATES, "target_mass", *_GIVEN, *_VECTORS, *_FOUND),
    "extrapolate": (
        "m", "control", *_RATES, *_MASSES, "columns", "partials", "products", "newest", "numbers",
    ),
    "next_potential": (
        "m", "control", "k", *_RATES[1:], "radius", "given_columns", "columns", "column_changes",
        *_FOUND,
    ),
    END: ("control", "groups", "partials", "newest", "products", "numbers"),
}  # fmt: skip
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
        self._kernels: dict[str, cl.Kernel] = {}
        #: The iteration for which the kernels' arguments are set.
        self._bound: weakref.ref[StoredIteration] | None = None
        units = loop.work.device.max_compute_units
        self.most_groups: int = min(MOST_GROUPS, GROUPS_PER_UNIT * units)
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
        if not Variant("sparse_half_steps.cl").suits(self._constants):
            return None
        pairs: tuple[Side, Side] = stored.pairs
        self._own_kernels()
        buffers = self._buffers(pairs) if over is None else over.buffers
        if buffers is None:
            return None
        rows, columns = vectors
        self._give(buffers["given_rows"], pairs[0], rows, center)
        self._give(buffers["given_columns"], pairs[1], columns)
        moved = (center - rows.origin)[rows.masses > 0]
        return StoredIteration(
            self, pairs,
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
            self._bound = None
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
        changing = {"control": control, "radius": np.float64(radius)}

        def enqueue(name: str, size: int, local: tuple[int, ...] | None) -> None:
            events.append(
                cl.enqueue_nd_range_kernel(
                    work.queue, kernels[name], (size,), local, wait_for=events[-1:]
                )
            )

        def run(name: str, n_groups: int) -> None:
            for number, argument in enumerate(ARGUMENTS[name]):
                if argument in changing:
                    kernels[name].set_arg(number, changing[argument])
            enqueue(name, n_groups * group, (group,))

        def half_step(side: int) -> None:
            changes = own["row_changes"], own["column_changes"]
            for part in iteration.pairs[side].parts:
                arguments = *part.arguments, changes[1 - side], own["maxima"], own["sums"]
                for number, argument in enumerate(arguments):
                    kernels["sum_stored"].set_arg(number, argument)
                enqueue("sum_stored", part.n_rows // width, None)
            for name in STAGES[side]:
                run(name, groups)

        prepared, iteration.prepared = iteration.prepared, -1
        try:
            if prepared != iteration.at:
                run(PREPARATION, groups)
            half_step(0)
            half_step(1)
            run(END, 1)
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

    def _own_kernels(self) -> dict[str, cl.Kernel]:
        """Return kernels whose arguments nothing else sets."""
        if not self._kernels:
            kernels = self._programs.kernels(Variant("sparse_half_steps.cl"))
            sums = self._programs.kernels(Variant("sliced_ellpack.cl"))
            self._kernels = {**kernels, "sum_stored": sums["sum_stored"]}
        return self._kernels

    def _bind(self, iteration: StoredIteration) -> dict[str, cl.Kernel]:
        """Return kernels with all arguments set that stay the same while an iteration goes on.

        To set an argument takes some microseconds.
        """
        kernels, bound = self._own_kernels(), self._bound
        if bound is not None and bound() is iteration:
            return kernels
        self._bound = None
        rows, columns = (side.rows.stride for side in iteration.pairs)
        sizes = {"n": rows, "m": columns, "groups": self._groups(max(rows, columns)), "control": 0}
        numbers = {
            "k": LOG2_E / iteration.epsilon, "epsilon": iteration.epsilon, "radius": 0.0,
            **dict(zip((*_RATES[1:], *_MASSES), iteration.scalars, strict=True)),
        }  # fmt: skip
        known = iteration.buffers | {name: np.uint32(size) for name, size in sizes.items()}
        known |= {name: np.float64(number) for name, number in numbers.items()}
        for name, arguments in ARGUMENTS.items():
            for number, argument in enumerate(arguments):
                kernels[name].set_arg(number, known[argument])
        self._bound = weakref.ref(iteration)
        return kernels
