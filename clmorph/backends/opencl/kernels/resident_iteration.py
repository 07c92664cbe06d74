"""The host of both iterations on the device: what it sets, starts, awaits and reads."""

import math
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.clouds import split
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.records import SOURCE, Float64, IterationNumbers, ProgramError, next_source


@dataclass(eq=False)
class DeviceIteration:
    """An iteration on the device, as `clmorph.backends.records.ResidentIteration` has it.

    Its sides are clouds, or parts of stored pairs. The arguments of kernels stay while it goes
    on. Of them ``rows`` and ``columns`` hold vectors, (slots, stride), and ``start`` is the
    host's potential. With a line of `numbers` for each of many problems it is theirs.
    """

    steps: "ResidentSteps[Any]"
    sides: tuple[Any, Any]
    arguments: dict[str, Any]
    numbers: Float64
    units: tuple[float, float] = (1.0, 1.0)  #: of costs and masses on the device, powers of two
    epsilon: float = 0.0
    precise: bool = False
    version: int = 0  #: changes with the buffers among the arguments
    n_pairs: int = 0  #: pairs of points that the softmins of an iteration sum
    prepared: Any = -1  #: the part SOURCE of the controls for which a softmin is prepared

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potential at which the next iteration begins."""
        self.steps.set_potential(self, g, epsilon, precise)

    def iterate(self, control: Any, radius: Any) -> IterationNumbers:
        """Run one iteration, with one wait."""
        return self.steps.iterate(self, control, radius)

    def keep(self, problems: NDArray[np.intp]) -> None:
        """Go on with some of many problems."""
        self.steps.keep(self, problems)

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, both images of g, and T(f) after the last iteration."""
        return self.steps.potentials(self)


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

    def bind(self, iteration: DeviceIteration, scalars: Callable[[Any], dict[str, Any]]) -> None:
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
    with np.errstate(invalid="ignore"):  # before the second iteration one image may be anything
        return values.view(np.float32).reshape(*values.shape, 2).sum(axis=-1, dtype=float)


def _power_near(size: float) -> float:
    """Return a power of two near a size."""
    return 2.0 ** round(math.log2(size)) if size > 0 else 1.0


#: A kernel's name, and its global and local size.
Launch = tuple[str, tuple[int, ...], tuple[int, ...] | None]
T = TypeVar("T", bound=DeviceIteration)


class ResidentSteps(ABC, Generic[T]):
    """Iterations on the device.

    take_turns: makes methods run one at a time on a device, see `OpenCLOperations`.
    """

    #: The variant of the kernels of the iteration, and the module of what stands in their buffers.
    variant: Variant
    slots: Any

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        self._work, self._programs, self._constants = loop.work, loop.programs, loop.constants
        self._in_pairs = not loop.constants.float64
        self._is_possible: bool | None = None
        self.set_potential = take_turns(self._set_potential)
        self.iterate = take_turns(self._iterate)
        self.keep = take_turns(self._keep)
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
                error.tell("iterations run on the host, which is slower")
        return self._is_possible

    @abstractmethod
    def _kernels(self, iteration: T) -> BoundKernels:
        """Return the kernels of an iteration."""

    @abstractmethod
    def _launches(self, iteration: T, prepare: bool) -> Iterator[Launch]:
        """Return the launches of an iteration; with `prepare` the first softmin is prepared."""

    @abstractmethod
    def _begin(self, iteration: T, g: Float64) -> dict[str, Float64]:
        """Return what a new potential g leaves in buffers, by their names."""

    @abstractmethod
    def _in_order(self, side: Any, values: Float64) -> Float64:
        """Return values of a side in the caller's order."""

    def _keep(self, iteration: T, problems: NDArray[np.intp]) -> None:
        """Go on with some of many problems."""

    def _scalars(self, iteration: T) -> dict[str, Any]:
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

    def _read(self, iteration: T, values: Float64) -> Float64:
        """Return potentials, in the caller's units, from what was read."""
        return of_pairs(values) * iteration.units[0] if self._in_pairs else values

    def _found(self, iteration: T) -> IterationNumbers:
        """Return the numbers that were read, in the caller's units."""
        names, numbers = self.slots.NUMBERS, iteration.numbers
        if self._in_pairs:
            numbers[...] = of_pairs(numbers)
            cost, mass = iteration.units
            scales = {"MASS": mass, "ROW_DUAL": cost * mass, "COLUMN_DUAL": cost * mass}
            for place, name in enumerate(names):
                numbers[..., place] *= scales.get(name, cost if name == "MOVED" else 1.0)
        values: Any = numbers.tolist() if numbers.ndim == 1 else numbers.T.copy()
        found = dict(zip(names, values, strict=True))
        return IterationNumbers(
            found["MASS"], found["ROW_DUAL"], found["RESIDUAL_SIZE"], found["COLUMN_DUAL"],
            found["FOUND"] != 0, found["CUT"] != 0,
            (found["ROW_FINITE"] == 0) & (found["COLUMN_FINITE"] == 0), found.get("MOVED", 0.0),
        )  # fmt: skip

    def _tell(self, iteration: T, bound: BoundKernels, control: Any, radius: Any) -> list[cl.Event]:
        """Tell kernels of the next iteration, and return what they have to wait for."""
        bound.set("control", np.uint32(control))
        bound.set("radius", self._real(radius))
        return []

    def _set_potential(self, iteration: T, g: Float64, epsilon: float, precise: bool) -> None:
        """Write the potential at which the next iteration begins; see `ResidentIteration`."""
        iteration.epsilon, iteration.precise, iteration.prepared = epsilon, precise, -1
        for name, content in self._begin(iteration, np.asarray(g, float)).items():
            buffer = iteration.arguments[name]
            cl.enqueue_copy(self._work.queue, buffer, content, is_blocking=True)

    def _iterate(self, iteration: T, control: Any, radius: Any) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        queue, bound = self._work.queue, self._kernels(iteration)
        bound.bind(iteration, self._scalars)
        prepare = bool(np.any(iteration.prepared != control & SOURCE))
        iteration.prepared, events = -1, list[cl.Event]()
        launched, began = list[tuple[cl.Kernel, cl.Event]](), time.perf_counter()
        try:
            events += self._tell(iteration, bound, control, radius)
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
        found = self._found(iteration)
        iteration.prepared = next_source(control, found.extrapolated)
        return found

    def _potentials(self, iteration: T) -> tuple[Float64, Float64, Float64]:
        """Return f, both images of g, (2, M), and T(f) after the last iteration."""
        slots, (rows, columns), found, events = self.slots, iteration.sides, [], []
        places = (
            (rows, "rows", slots.ROW_SLOTS.index("SHIFTED"), 1),
            (columns, "columns", slots.COLUMN_SLOTS.index("IMAGE_0"), 2),
            (columns, "columns", slots.COLUMN_SLOTS.index("SOFTMIN"), 1),
        )
        try:
            for side, name, slot, count in places:
                found.append(np.empty((count, side.stride)))
                events.append(
                    cl.enqueue_copy(
                        self._work.queue, found[-1], iteration.arguments[name],
                        src_offset=8 * slot * side.stride, is_blocking=False,
                    )
                )  # fmt: skip
        finally:
            if events:
                cl.wait_for_events(events)
        f, *images, t_columns = (
            self._in_order(side, each)
            for (side, *_), values in zip(places, found, strict=True)
            for each in self._read(iteration, values[:, : len(side)])
        )
        return f, np.array(images), t_columns
