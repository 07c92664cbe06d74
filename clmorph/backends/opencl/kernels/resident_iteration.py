"""The host of both iterations on the device: what it sets, starts, awaits and reads."""

import math
import time
import warnings
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.build.program import ProgramError
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.clouds import split
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.records import Float64, IterationNumbers
from clmorph.errors import ClmorphWarning


@dataclass(frozen=True)
class Slots:
    """The names of what stands in the buffers of an iteration, in their order."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    numbers: tuple[str, ...]


@dataclass(eq=False)
class DeviceIteration:
    """An iteration on the device, as `clmorph.backends.records.ResidentIteration` has it.

    Its sides are clouds, or parts of stored pairs. The arguments of kernels stay while it goes
    on. Of them ``rows`` and ``columns`` hold vectors, (slots, stride), and ``start`` is the
    host's potential.
    """

    steps: "ResidentSteps"
    slots: Slots
    sides: tuple[Any, Any]
    arguments: dict[str, Any]
    epsilon: float = 0.0
    precise: bool = False
    version: int = 0  #: changes with the buffers among the arguments
    n_pairs: int = 0  #: pairs of points that the softmins of an iteration sum
    units: tuple[float, float] = (1.0, 1.0)  #: of costs and masses on the device, powers of two

    def __post_init__(self) -> None:
        self.numbers: Float64 = np.zeros(len(self.slots.numbers))
        self._images, self._guesses = map(self.slots.columns.index, ("IMAGE_0", "GUESS_0"))
        self._parity: Any = 0  # which of two slots the next image has
        self.go_to_start()

    @property
    def image_slots(self) -> tuple[int, ...]:
        """The slots that hold the last iteration's images."""
        return (self._images + self._parity,)

    def chosen(
        self, f: Float64, images: list[Float64], t_columns: Float64
    ) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f), from what has been read of all slots."""
        return f, images[0], t_columns

    def go_to_start(self) -> None:
        """Take the host's potential as the next one."""
        #: The slots of the next g, and of that for which a softmin is prepared; -1 if none is.
        self.at: Any = self.slots.columns.index("START")
        self.prepared: Any = -1

    def go_on(self, extrapolated: Any, which: Any = True) -> None:
        """Take the last iteration's guess, or its image, as the next potential."""
        self.at = (self._guesses if extrapolated else self._images) + self._parity
        self._parity = 1 - self._parity

    def go_back(self, which: Any = True) -> None:
        """Drop the last iteration, and take the image of the one before as the next potential."""
        self.at = self._images + 1 - self._parity

    def keep(self, problems: NDArray[np.intp]) -> None:
        """Go on with the only problem."""

    @property
    def is_unprepared(self) -> bool:
        """Whether the next iteration has to prepare its first softmin."""
        return bool(self.prepared != self.at)

    def read(self) -> IterationNumbers:
        """Return the last iteration's numbers, and note which softmin is prepared."""
        found = dict(zip(self.slots.numbers, self.numbers.tolist(), strict=True))
        self.prepared = (self._guesses if found["FOUND"] else self._images) + self._parity
        return IterationNumbers(
            found["MASS"], found["ROW_DUAL"], found["RESIDUAL_SIZE"], found["COLUMN_DUAL"],
            bool(found["FOUND"]), bool(found["CUT"]),
            found["ROW_FINITE"] == 0 and found["COLUMN_FINITE"] == 0, found.get("MOVED", 0.0),
        )  # fmt: skip

    def control(self, begun: Any, place: Any, count: Any) -> Any:
        """Return what kernels need to know of an iteration; see ``cl_kernels/vector_steps.cl``."""
        return self.at | self._parity << 6 | begun << 7 | place << 8 | count << 12

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potential at which the next iteration begins."""
        self.steps.set_potential(self, g, epsilon, precise)

    def iterate(self, begun: Any, place: Any, count: Any, radius: Any) -> IterationNumbers:
        """Run one iteration, with one wait."""
        return self.steps.iterate(self, begun, place, count, radius)

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        return self.steps.potentials(self)


class BatchIteration(DeviceIteration):
    """Iterations of many problems on the device; each stops by itself, and `keep` leaves some.

    The table, (problems, fields), is what kernels are told of each problem.
    """

    table: Any = None

    def begin(
        self,
        table: NDArray[np.uint32],
        counts: tuple[NDArray[np.int64], NDArray[np.int64]],
        lists: Callable[[NDArray[np.bool_]], None],
    ) -> "BatchIteration":
        """Take lines and counts of the problems, and a function that lists the tiles of some."""
        self.table, self._counts, self._list = table, counts, lists
        self._here = np.arange(len(table))
        self.numbers = np.zeros((len(table), len(self.slots.numbers)))
        self._parity = np.zeros(len(table), np.int64)
        self.go_to_start()
        return self

    def go_to_start(self) -> None:
        """Take the host's potentials, of all problems, as the next ones."""
        if self.table is None:
            return
        if len(self._here) < len(self.table):
            self._here = np.arange(len(self.table))
            self._list(np.ones(len(self.table), bool))
        self.at = np.full(len(self.table), self.slots.columns.index("START"))
        self.prepared = -1

    def go_on(self, extrapolated: Any, which: Any = True) -> None:
        """Take the guesses, or the images, of some problems as the next potentials."""
        here = self._here[np.broadcast_to(which, self._here.shape)]
        taken = np.where(extrapolated, self._guesses, self._images)
        taken = np.broadcast_to(taken, self._here.shape)
        self.at[self._here] = np.where(which, taken + self._parity[self._here], self.at[self._here])
        self._parity[here] = 1 - self._parity[here]

    def go_back(self, which: Any = True) -> None:
        """Drop the last iteration of some problems, which go on at the images before."""
        here = self._here[np.broadcast_to(which, self._here.shape)]
        self.at[here] = self._images + 1 - self._parity[here]

    @property
    def is_unprepared(self) -> bool:
        """Whether the next iteration has to prepare the first softmin of any problem."""
        return bool(np.any((self.prepared != self.at)[self._here]))

    def control(self, begun: Any, place: Any, count: Any) -> Any:
        """Return what kernels need to know of an iteration of each problem."""
        own = (self.of_all(each).astype(np.int64) for each in (begun, place, count))
        return super().control(*own)

    def of_all(self, values: Any) -> Float64:
        """Return numbers of the problems that are left as such of all problems."""
        own = np.zeros(len(self.table))
        own[self._here] = values
        return own

    def read(self) -> IterationNumbers:
        """Return the last iteration's numbers, and note which softmins are prepared."""
        found = dict(zip(self.slots.numbers, self.numbers[self._here].T, strict=True))
        self.prepared = self._parity + np.where(
            self.numbers[:, self.slots.numbers.index("FOUND")] != 0, self._guesses, self._images
        )
        return IterationNumbers(
            found["MASS"], found["ROW_DUAL"], found["RESIDUAL_SIZE"], found["COLUMN_DUAL"],
            found["FOUND"] != 0, found["CUT"] != 0,
            (found["ROW_FINITE"] == 0) & (found["COLUMN_FINITE"] == 0), np.zeros(len(self._here)),
        )  # fmt: skip

    @property
    def image_slots(self) -> tuple[int, ...]:
        """Both slots of images: problems may have either one."""
        return self._images, self._images + 1

    def chosen(
        self, f: Float64, images: list[Float64], t_columns: Float64
    ) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) of the problems that are left."""
        here = np.zeros(len(self.table), bool)
        here[self._here] = True
        of_rows, of_columns = (np.repeat(here, counts) for counts in self._counts)
        parity = np.repeat(self._parity, self._counts[1])
        image = np.where(parity, *(each[: len(parity)] for each in images[::-1]))
        n, m = len(of_rows), len(of_columns)  # points that pad tiles come after all others
        return f[:n][of_rows], image[of_columns], t_columns[:m][of_columns]

    def keep(self, problems: NDArray[np.int64]) -> None:
        """Go on with some of the problems."""
        self._here = self._here[problems]
        left = np.zeros(len(self.table), bool)
        left[self._here] = True
        self._list(left)
        self.prepared = -1  # levels have the order of the lists


class BoundKernels:
    """Kernels of their own, whose arguments, by name, stay set while an iteration goes on.

    The budget learns from the seconds that iterations take.
    """

    def __init__(
        self, kernels: dict[str, cl.Kernel], arguments: dict[str, tuple[str, ...]],
        budget: LaunchBudget | None = None,
    ) -> None:  # fmt: skip
        self.kernels, self.budget = kernels, budget
        self._places: dict[str, list[tuple[cl.Kernel, int]]] = {}
        for kernel, names in arguments.items():
            for number, name in enumerate(names):
                self._places.setdefault(name, []).append((kernels[kernel], number))
        self._iteration: weakref.ref[DeviceIteration] | None = None
        self._epsilon, self._version = 0.0, 0
        self._scalars: dict[str, bytes] = {}

    def bind(
        self, iteration: DeviceIteration, scalars: Callable[[DeviceIteration], dict[str, Any]]
    ) -> None:
        """Set what stays the same in an iteration, and the scalars that follow from its epsilon."""
        bound = None if self._iteration is None else self._iteration()
        if bound is not iteration or self._version != iteration.version:
            self._iteration, self._epsilon = None, 0.0
            for name in self._places.keys() & iteration.arguments.keys():
                self.set(name, iteration.arguments[name])
            self._iteration, self._version = weakref.ref(iteration), iteration.version
        if self._epsilon != iteration.epsilon:
            self._epsilon = 0.0
            for name, value in scalars(iteration).items():
                self.set(name, value)
            self._epsilon = iteration.epsilon

    def set(self, name: str, value: Any) -> None:
        """Set an argument of all kernels that take it; a scalar only where it has changed.

        See `Workspace.launch`: Ctrl-C may come between any two of these steps.
        """
        scalar = value.tobytes() if isinstance(value, np.generic) else b""
        if scalar and self._scalars.get(name) == scalar:
            return
        self._scalars.pop(name, None)
        for kernel, number in self._places.get(name, ()):
            kernel.set_arg(number, value)
        if scalar:
            self._scalars[name] = scalar


def as_pairs(values: Any) -> NDArray[np.float32]:
    """Return numbers as pairs of float32, (..., 2), which have no infinity."""
    return np.ascontiguousarray(np.moveaxis(split(np.clip(values, SENTINEL, -SENTINEL)), 0, -1))


def of_pairs(values: Float64) -> Float64:
    """Return the numbers whose pairs of float32 were read into this array."""
    return values.view(np.float32).reshape(*values.shape, 2).sum(axis=-1, dtype=float)


def _power_near(size: float) -> float:
    """Return a power of two near a size."""
    return 2.0 ** round(math.log2(size)) if size > 0 else 1.0


#: A kernel's name, and its global and local size.
Launch = tuple[str, tuple[int, ...], tuple[int, ...] | None]


class ResidentSteps(ABC):
    """Iterations on the device.

    take_turns: makes methods run one at a time on a device, see `OpenCLOperations`.
    """

    #: The variant of the kernels of the iteration.
    variant: Variant

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        self._work, self._programs, self._constants = loop.work, loop.programs, loop.constants
        self._in_pairs = not loop.constants.float64
        self._is_possible: bool | None = None
        self.set_potential = take_turns(self._set_potential)
        self.iterate = take_turns(self._iterate)
        self.potentials = take_turns(self._potentials)

    def is_possible(self) -> bool:
        """Return whether the device has what iterations need; its compiler is asked once."""
        if self._is_possible is None:
            self._is_possible = self.variant.suits(self._constants)
            try:
                if self._is_possible:
                    self._programs.kernels(self.variant)
            except ProgramError as error:
                self._is_possible = False
                warnings.warn(
                    f"iterations run on the host, which is slower: {error}",
                    ClmorphWarning,
                    stacklevel=2,
                )
        return self._is_possible

    @abstractmethod
    def _kernels(self, iteration: DeviceIteration) -> BoundKernels:
        """Return the kernels of an iteration."""

    @abstractmethod
    def _launches(self, iteration: DeviceIteration, prepare: bool) -> Iterator[Launch]:
        """Return the launches of an iteration; with `prepare` the first softmin is prepared."""

    @abstractmethod
    def _begin(self, iteration: DeviceIteration, g: Float64) -> dict[str, Float64]:
        """Return what a new potential g leaves in buffers, by their names."""

    @abstractmethod
    def _in_order(self, side: Any, values: Float64) -> Float64:
        """Return values of a side in the caller's order."""

    def _scalars(self, iteration: DeviceIteration) -> dict[str, Any]:
        """Return the arguments that follow from epsilon."""
        epsilon = iteration.epsilon / iteration.units[0]
        return {"k": self._real(LOG2_E / epsilon), "epsilon": self._real(epsilon)}

    def _chosen_units(self, cost: float, mass: float) -> tuple[float, float]:
        """Return units in which pairs of float32 lose no digits, by the largest cost and a mass."""
        if not self._in_pairs:
            return 1.0, 1.0
        return _power_near(cost), _power_near(mass)

    def _real(self, value: float) -> Any:
        """Return a number as kernels take it."""
        return as_pairs(value).view("f4,f4")[()][0] if self._in_pairs else np.float64(value)

    def _packed(self, values: Float64) -> Any:
        """Return numbers as kernels have them in buffers."""
        return as_pairs(values) if self._in_pairs else values

    def _buffer(self, values: Float64) -> cl.Buffer:
        """Return a buffer of numbers."""
        packed = self._packed(np.asarray(values, float))
        return self._work.buffer(packed, packed.dtype)

    def _read(self, iteration: DeviceIteration, values: Float64) -> Float64:
        """Return potentials, in the caller's units, from what was read."""
        return of_pairs(values) * iteration.units[0] if self._in_pairs else values

    def _read_numbers(self, iteration: DeviceIteration) -> None:
        """Bring the numbers that were read to the caller's units."""
        if not self._in_pairs:
            return
        iteration.numbers[...] = of_pairs(iteration.numbers)
        cost, mass = iteration.units
        scales = {"MASS": mass, "ROW_DUAL": cost * mass, "COLUMN_DUAL": cost * mass, "MOVED": cost}
        for place, name in enumerate(iteration.slots.numbers):
            iteration.numbers[..., place] *= scales.get(name, 1.0)

    def _tell(
        self, iteration: DeviceIteration, bound: BoundKernels, control: Any, radius: Any,
        prepare: bool,
    ) -> list[cl.Event]:  # fmt: skip
        """Tell kernels of the next iteration, and return what they have to wait for."""
        if prepare:
            bound.set("first_control", np.uint32(control))
        bound.set("control", np.uint32(control))
        bound.set("radius", self._real(radius))
        return []

    def _set_potential(
        self, iteration: DeviceIteration, g: Float64, epsilon: float, precise: bool
    ) -> None:
        """Write the potential at which the next iteration begins; see `ResidentIteration`."""
        iteration.epsilon, iteration.precise = epsilon, precise
        iteration.go_to_start()
        for name, content in self._begin(iteration, np.asarray(g, float)).items():
            buffer = iteration.arguments[name]
            cl.enqueue_copy(self._work.queue, buffer, content, is_blocking=True)

    def _iterate(
        self, iteration: DeviceIteration, begun: Any, place: Any, count: Any, radius: Any
    ) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        queue, bound = self._work.queue, self._kernels(iteration)
        bound.bind(iteration, self._scalars)
        prepare, iteration.prepared = iteration.is_unprepared, -1
        control, events = iteration.control(begun, place, count), list[cl.Event]()
        launched, began = list[tuple[cl.Kernel, cl.Event]](), time.perf_counter()
        try:
            events += self._tell(iteration, bound, control, radius, prepare)
            for name, size, group in self._launches(iteration, prepare):
                kernel, before = bound.kernels[name], events[-1:]
                events.append(
                    cl.enqueue_nd_range_kernel(queue, kernel, size, group, wait_for=before)
                )
                launched.append((kernel, events[-1]))
            events.append(
                cl.enqueue_copy(
                    queue, iteration.numbers, iteration.arguments["numbers"],
                    is_blocking=False, wait_for=events[-1:],
                )
            )  # fmt: skip
            events[-1].wait()
        except BaseException:
            # Ctrl-C may come between a command and the list of its event.
            queue.finish()
            raise
        if bound.budget:
            bound.budget.learn(iteration.n_pairs, time.perf_counter() - began)
        for kernel, event in launched:
            self._work.note(kernel, event)
        self._read_numbers(iteration)
        return iteration.read()

    def _potentials(self, iteration: DeviceIteration) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        slots, found, events = iteration.slots, [], []
        places = (
            (0, "rows", slots.rows.index("SHIFTED")),
            *((1, "columns", slot) for slot in iteration.image_slots),
            (1, "columns", slots.columns.index("SOFTMIN")),
        )  # fmt: skip
        try:
            for side, name, slot in places:
                cloud = iteration.sides[side]
                found.append(np.empty(len(cloud)))
                events.append(
                    cl.enqueue_copy(
                        self._work.queue, found[-1], iteration.arguments[name],
                        src_offset=8 * slot * cloud.stride, is_blocking=False,
                    )
                )  # fmt: skip
        finally:
            if events:
                cl.wait_for_events(events)
        f, *images, t_columns = (
            self._in_order(iteration.sides[side], self._read(iteration, values))
            for (side, *_), values in zip(places, found, strict=True)
        )
        return iteration.chosen(f, images, t_columns)
