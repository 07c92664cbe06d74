"""The host of both iterations on the device: what it sets, starts, awaits and reads."""

import functools
import math
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, TypeVar, cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.clouds import split
from clmorph.backends.opencl.kernels.launches import LaunchBudget, set_argument
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop
from clmorph.backends.records import SOURCE, Float64, IterationNumbers, next_source

#: The arguments that change in each iteration, see `DeviceIteration._tell`.
TOLD = "control", "radius"


class BoundKernels:
    """Kernels of their own, whose arguments, by name, stay set while an iteration goes on.

    The budget learns from the seconds that iterations take.
    """

    def __init__(
        self, kernels: dict[str, cl.Kernel], arguments: dict[str, tuple[str, ...]],
        budget: LaunchBudget | None = None,
    ) -> None:  # fmt: skip
        self.kernels, self.budget = kernels, budget
        self._places: dict[str, list[tuple[str, int]]] = {}
        self._told: dict[str, list[tuple[str, int]]] = {}
        for kernel, names in arguments.items():
            places = list(enumerate(names))
            for number, name in places:
                self._places.setdefault(name, []).append((kernel, number))
            self._told[kernel] = [(name, number) for number, name in places if name in TOLD]
        self._iteration: weakref.ref[DeviceIteration] | None = None
        self._epsilon, self._version = 0.0, 0
        self._scalars: dict[str, dict[int, bytes]] = {kernel: {} for kernel in arguments}

    def bind(self, iteration: "DeviceIteration") -> None:
        """Set what stays the same in an iteration, and the scalars that follow from its epsilon."""
        bound = None if self._iteration is None else self._iteration()
        if bound is not iteration or self._version != iteration.version:
            self._iteration, self._epsilon = None, 0.0
            for name in self._places.keys() & iteration.arguments.keys():
                self.set(name, iteration.arguments[name])
            self._iteration, self._version = weakref.ref(iteration), iteration.version
        if self._epsilon != iteration.epsilon:
            self._epsilon = 0.0
            for name, value in iteration.scalars().items():
                self.set(name, value)
            self._epsilon = iteration.epsilon

    def set(self, name: str, value: Any) -> None:
        """Set an argument of all kernels that take it."""
        for kernel, number in self._places.get(name, ()):
            set_argument(self.kernels[kernel], number, value, self._scalars[kernel])

    def tell(self, kernel: str, told: dict[str, Any]) -> None:
        """Set arguments of one iteration alone."""
        for name, number in self._told.get(kernel, ()) if told else ():
            set_argument(self.kernels[kernel], number, told[name], self._scalars[kernel])


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
Method = TypeVar("Method", bound=Callable[..., Any])


class ResidentSteps:
    """What all iterations of one kind have on a device: its kernels, and its kind of numbers.

    take_turns: makes functions run one at a time on a device, see `OpenCLOperations`.
    """

    variant: Variant  #: of the kernels between softmins

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        # What takes turns is made once for each function, not with each call.
        self.loop, self.take_turns = loop, functools.cache(take_turns)
        self.in_pairs = not loop.constants.float64
        self.bound: dict[Any, BoundKernels] = {}

    def is_possible(self) -> bool:
        """Return whether the device has what iterations need; its compiler is asked once."""
        instead = "iterations run on the host, which is slower"
        return self.loop.programs.has(self.variant, instead)

    def units(self, cost: float, mass: float) -> tuple[float, float]:
        """Return units in which pairs of float32 lose no digits, by the largest cost and a mass."""
        return (_power_near(cost), _power_near(mass)) if self.in_pairs else (1.0, 1.0)

    def real(self, value: float) -> Any:
        """Return a number as kernels take it."""
        return as_pairs(value).view("f4,f4")[()][0] if self.in_pairs else np.float64(value)

    def packed(self, values: Float64) -> Any:
        """Return numbers as kernels have them in buffers."""
        return as_pairs(values) if self.in_pairs else values

    def buffer(self, values: Float64) -> cl.Buffer:
        """Return a buffer of numbers."""
        packed = self.packed(np.asarray(values, float))
        return self.loop.work.buffer(packed, packed.dtype)


def in_turn(method: Method) -> Method:
    """Let a method of an iteration run when no other operation does on its device."""

    @functools.wraps(method)
    def run(self: "DeviceIteration", *arguments: Any) -> Any:
        return self.steps.take_turns(method)(self, *arguments)

    return cast(Method, run)


class DeviceIteration(ABC):
    """An iteration on the device, as `clmorph.backends.records.ResidentIteration` has it.

    Its sides are clouds, or parts of stored pairs. The arguments of kernels stay while it goes
    on. Of them ``rows`` and ``columns`` hold vectors, (slots, stride), and ``start`` is the
    host's potential. With a line of `numbers` for each of many problems it is theirs. The units
    are those of costs and masses on the device, powers of two.
    """

    slots: Any  #: the module of what stands in buffers
    numbers: Float64
    epsilon, precise = 0.0, False
    version = 0  #: changes with the buffers among the arguments
    n_pairs = 0  #: pairs of points that the softmins of an iteration sum
    prepared: Any = -1  #: the part SOURCE of the controls for which a softmin is prepared

    def __init__(
        self, steps: Any, sides: tuple[Any, Any], units: tuple[float, float],
        arguments: dict[str, Any],
    ) -> None:  # fmt: skip
        self.steps, self.sides, self.units, self.arguments = steps, sides, units, arguments
        self.loop: RowLoop = steps.loop

    @abstractmethod
    def _kernels(self) -> BoundKernels:
        """Return the kernels of the iteration."""

    @abstractmethod
    def _launches(self, prepare: bool) -> Iterable[Launch]:
        """Return the launches of an iteration; with `prepare` the first softmin is prepared."""

    @abstractmethod
    def _begin(self, g: Float64) -> dict[str, Float64]:
        """Return what a new potential g leaves in buffers, by their names."""

    def _in_order(self, side: Any, values: Float64) -> Float64:
        """Return values of a side in the caller's order."""
        return values

    def keep(self, problems: NDArray[np.intp]) -> None:
        """Go on with some of many problems."""
        assert len(problems) == 1

    def scalars(self) -> dict[str, Any]:
        """Return the arguments that follow from epsilon."""
        epsilon, real = self.epsilon / self.units[0], self.steps.real
        return {"k": real(LOG2_E / epsilon), "epsilon": real(epsilon)}

    def _found(self) -> IterationNumbers:
        """Return the numbers that were read, in the caller's units."""
        names, numbers = self.slots.NUMBERS, self.numbers
        if self.steps.in_pairs:
            numbers[...] = of_pairs(numbers)
            cost, mass = self.units
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

    def _tell(self, control: Any, radius: Any, events: list[cl.Event]) -> dict[str, Any]:
        """Return arguments of the next iteration alone; add what its first kernel waits for."""
        return {"control": np.uint32(control), "radius": self.steps.real(radius)}

    @in_turn
    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Write the potential at which the next iteration begins; see `ResidentIteration`."""
        self.epsilon, self.precise, self.prepared = epsilon, precise, -1
        for name, content in self._begin(np.asarray(g, float)).items():
            buffer, content = self.arguments[name], self.steps.packed(content)
            cl.enqueue_copy(self.loop.work.queue, buffer, content, is_blocking=True)

    @in_turn
    def iterate(self, control: Any, radius: Any) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        queue, bound = self.loop.work.queue, self._kernels()
        bound.bind(self)
        prepare = bool(np.asarray(self.prepared != control & SOURCE).any())
        self.prepared, events = -1, list[cl.Event]()
        launched, began = list[tuple[cl.Kernel, cl.Event]](), time.perf_counter()
        try:
            told = self._tell(control, radius, events)
            for name, size, group in self._launches(prepare):
                # To set a scalar takes 16 microseconds, in which the kernel before runs.
                bound.tell(name, told)
                kernel, before = bound.kernels[name], events[-1:]
                events.append(
                    cl.enqueue_nd_range_kernel(queue, kernel, size, group, wait_for=before)
                )
                launched.append((kernel, events[-1]))
            numbers = self.arguments["numbers"]
            events.append(
                cl.enqueue_copy(
                    queue, self.numbers, numbers, is_blocking=False, wait_for=events[-1:]
                )
            )
            events[-1].wait()
        except BaseException:
            # Ctrl-C may come between a command and the list of its event.
            queue.finish()
            raise
        if bound.budget:
            bound.budget.learn(self.n_pairs, time.perf_counter() - began)
        for kernel, event in launched:
            self.loop.work.note(kernel, event)
        found = self._found()
        self.prepared = next_source(control, found.extrapolated)
        return found

    @in_turn
    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, both images of g, (2, M), and T(f) after the last iteration."""
        (rows, columns), found, events = self.sides, [], []
        places = (
            (rows, "rows", self.slots.ROW_SLOTS.index("SHIFTED"), 1),
            (columns, "columns", self.slots.COLUMN_SLOTS.index("IMAGE_0"), 2),
            (columns, "columns", self.slots.COLUMN_SLOTS.index("SOFTMIN"), 1),
        )
        try:
            for side, name, slot, count in places:
                found.append(np.empty((count, side.stride)))
                events.append(
                    cl.enqueue_copy(
                        self.loop.work.queue, found[-1], self.arguments[name],
                        src_offset=8 * slot * side.stride, is_blocking=False,
                    )
                )  # fmt: skip
        finally:
            if events:
                cl.wait_for_events(events)
        if self.steps.in_pairs:
            found = [of_pairs(values) * self.units[0] for values in found]
        f, *images, t_columns = (
            self._in_order(side, each)
            for (side, *_), values in zip(places, found, strict=True)
            for each in values[:, : len(side)]
        )
        return f, np.array(images), t_columns
