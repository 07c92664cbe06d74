"""The host of both iterations on the device: what it sets, starts, awaits and reads."""

import contextlib
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.opencl.kernels.launches import Workspace
from clmorph.backends.opencl.kernels.row_loop import LOG2_E
from clmorph.backends.records import Float64, IterationNumbers


@dataclass(frozen=True)
class Slots:
    """The names of what stands in the buffers of an iteration, in their order."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    numbers: tuple[str, ...]


@dataclass(eq=False)
class DeviceIteration:
    """An iteration on the device, as `clmorph.backends.interface.ResidentIteration` has it.

    Of its potentials the last and the next one are kept.

    sides: (rows, columns), clouds, or parts of stored pairs, with a length and a stride; arguments:
    what kernels take while the iteration goes on, by name: scalars, and buffers. ``rows`` and
    ``columns`` hold vectors, (slots, stride) float64; ``start`` is the host's potential.
    """

    steps: "ResidentSteps"
    slots: Slots
    sides: tuple[Any, Any]
    arguments: dict[str, Any]
    epsilon: float = 0.0
    precise: bool = False

    def __post_init__(self) -> None:
        self.numbers = np.zeros(len(self.slots.numbers))
        self._images, self._guesses = map(self.slots.columns.index, ("IMAGE_0", "GUESS_0"))
        self._parity = 0  # which of two slots the next image has
        self.go_to_start()

    @property
    def image(self) -> int:
        """The slot of the last iteration's image."""
        return self._images + self._parity

    def go_to_start(self) -> None:
        """Take the host's potential as the next one."""
        #: The slots of the next g, and of that for which a softmin is prepared; -1 if none is.
        self.at, self.prepared = self.slots.columns.index("START"), -1

    def go_on(self, extrapolated: bool) -> None:
        """Take the last iteration's guess, or its image, as the next potential."""
        self.at = (self._guesses if extrapolated else self._images) + self._parity
        self._parity = 1 - self._parity

    def go_back(self) -> None:
        """Drop the last iteration, and take the image of the one before as the next potential."""
        self.at = self._images + 1 - self._parity

    def read(self) -> IterationNumbers:
        """Return the last iteration's numbers, and note which softmin is prepared."""
        found = dict(zip(self.slots.numbers, self.numbers.tolist(), strict=True))
        self.prepared = (self._guesses if found["FOUND"] else self._images) + self._parity
        return IterationNumbers(
            found["MASS"], found["ROW_DUAL"], found["RESIDUAL_SIZE"], found["COLUMN_DUAL"],
            bool(found["FOUND"]), bool(found["CUT"]),
            found["ROW_FINITE"] == 0 and found["COLUMN_FINITE"] == 0, found.get("MOVED", 0.0),
        )  # fmt: skip

    def control(self, begun: bool, place: int, count: int) -> np.uint32:
        """Return what kernels need to know of an iteration; see ``cl_kernels/half_steps.cl``."""
        return np.uint32(self.at | self._parity << 6 | int(begun) << 7 | place << 8 | count << 12)

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potential at which the next iteration begins."""
        self.steps.set_potential(self, g, epsilon, precise)

    def iterate(self, begun: bool, place: int, count: int, radius: float) -> IterationNumbers:
        """Run one iteration, with one wait."""
        return self.steps.iterate(self, begun, place, count, radius)

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        return self.steps.potentials(self)


class BoundKernels:
    """Kernels of their own, whose arguments stay set while an iteration goes on.

    arguments: the names of the arguments of kernels, in their order.
    """

    def __init__(
        self, kernels: dict[str, cl.Kernel], arguments: dict[str, tuple[str, ...]]
    ) -> None:
        self.kernels = kernels
        self._places: dict[str, list[tuple[cl.Kernel, int]]] = {}
        for kernel, names in arguments.items():
            for number, name in enumerate(names):
                self._places.setdefault(name, []).append((kernels[kernel], number))
        self._iteration: weakref.ref[DeviceIteration] | None = None
        self._epsilon = 0.0
        self._scalars: dict[str, bytes] = {}

    def bind(
        self, iteration: DeviceIteration, scalars: Callable[[DeviceIteration], dict[str, Any]]
    ) -> None:
        """Set what stays the same in an iteration, if it is that of another one.

        scalars: a function that returns arguments which follow from epsilon.
        """
        if self._iteration is None or self._iteration() is not iteration:
            self._iteration, self._epsilon = None, 0.0
            for name in self._places.keys() & iteration.arguments.keys():
                self.set(name, iteration.arguments[name])
            self._iteration = weakref.ref(iteration)
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


#: A kernel's name, and its global and local size.
Launch = tuple[str, tuple[int, ...], tuple[int, ...] | None]


class ResidentSteps(ABC):
    """Iterations on the device.

    take_turns: makes methods run one at a time on a device, see `OpenCLOperations`.
    """

    def __init__(self, work: Workspace, take_turns: Callable[[Any], Any]) -> None:
        self._work = work
        self.set_potential = take_turns(self._set_potential)
        self.iterate = take_turns(self._iterate)
        self.potentials = take_turns(self._potentials)

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
        epsilon = iteration.epsilon
        return {"k": np.float64(LOG2_E / epsilon), "epsilon": np.float64(epsilon)}

    def _measured(self, iteration: DeviceIteration) -> contextlib.AbstractContextManager[None]:
        """Return a context in which the launches of an iteration are timed."""
        return contextlib.nullcontext()

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
        self, iteration: DeviceIteration, begun: bool, place: int, count: int, radius: float
    ) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        queue, bound = self._work.queue, self._kernels(iteration)
        bound.bind(iteration, self._scalars)
        control = iteration.control(begun, place, count)
        prepare, iteration.prepared = iteration.prepared != iteration.at, -1
        if prepare:
            bound.set("first_control", control)
        bound.set("control", control)
        bound.set("radius", np.float64(radius))
        events: list[cl.Event] = []
        with self._measured(iteration):
            try:
                for name, size, group in self._launches(iteration, prepare):
                    kernel, before = bound.kernels[name], events[-1:]
                    events.append(
                        cl.enqueue_nd_range_kernel(queue, kernel, size, group, wait_for=before)
                    )
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
        return iteration.read()

    def _potentials(self, iteration: DeviceIteration) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        slots, found, events = iteration.slots, [], []
        places = (
            (0, "rows", slots.rows.index("SHIFTED")), (1, "columns", iteration.image),
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
        f, g, t_columns = (
            self._in_order(iteration.sides[side], values)
            for (side, *_), values in zip(places, found, strict=True)
        )
        return f, g, t_columns
