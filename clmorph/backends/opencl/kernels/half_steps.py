"""The host side of ``cl_kernels/half_steps.cl``: iterations whose vectors stay on the device."""

import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build.constants import SENTINEL
from clmorph.backends.opencl.build.half_step_slots import (
    COLUMN_SLOTS,
    GIVEN,
    NUMBERS,
    ROW_SLOTS,
)
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.backends.opencl.kernels.log_sum_exp import LogSumExp
from clmorph.backends.opencl.kernels.potential_places import PotentialPlaces, read_numbers
from clmorph.backends.opencl.kernels.row_loop import KEPT_LEVELS, LOG2_E, RowLoop
from clmorph.backends.records import Float64, IterationNumbers

#: The largest number of pairs of points on the host's processor, where a softmin of so many takes
#: some tens of milliseconds in its one launch, and on other devices: a single work-group of a
#: graphics card has a small share of its float64 arithmetic. Measured speeds decide nothing here,
#: so that a problem is always solved in the same way.
MOST_PAIRS, MOST_PAIRS_ELSEWHERE = 1 << 25, 1 << 22


@dataclass(eq=False)
class DeviceIteration(PotentialPlaces):
    """An iteration on the device, as `clmorph.backends.interface.ResidentIteration` has it.

    Attributes
    ----------
    steps : HalfSteps
    rows, columns : Cloud
    rates : (float, float)
        Inverses of the marginal penalties.
    sides : (buffer, buffer)
        Vectors of the rows and of the columns, (slots, stride) float64.
    costs : (buffer, buffer)
        Costs between tile centers, (row tiles, column tiles) float64, and their transpose.
    work : dict of buffers
    epsilon : float
    precise : bool
    """

    steps: "HalfSteps"
    rows: Cloud
    columns: Cloud
    rates: tuple[float, float]
    sides: tuple[cl.Buffer, cl.Buffer]
    costs: tuple[cl.Buffer, cl.Buffer]
    work: dict[str, Any]
    numbers: Float64 = field(default_factory=lambda: np.zeros(len(NUMBERS)))
    epsilon: float = 0.0
    precise: bool = False

    def __post_init__(self) -> None:
        self.place(COLUMN_SLOTS)

    def set_potential(self, g: Float64, epsilon: float, precise: bool) -> None:
        """Set the potential at which the next iteration begins."""
        self.steps.set_potential(self, g, epsilon, precise)

    def iterate(self, begun: bool, place: int, count: int, radius: float) -> IterationNumbers:
        """Run one iteration, with one wait."""
        return self.steps.iterate(self, begun, place, count, radius)

    def potentials(self) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        return self.steps.potentials(self)


class _Bound:
    """Kernels of their own, whose arguments stay set while an iteration goes on.

    Parameters
    ----------
    kernels : dict of kernels by name
    """

    def __init__(self, kernels: dict[str, cl.Kernel]) -> None:
        self.kernels = kernels
        self.iteration: weakref.ref[DeviceIteration] | None = None
        self.epsilon = 0.0
        self._known: dict[tuple[str, int], bytes] = {}

    def set(self, name: str, first: int, *arguments: Any) -> None:
        """Set arguments of a kernel from a number on; a scalar only where it has changed.

        See `Workspace.launch`: Ctrl-C may come between any two of these steps.
        """
        kernel = self.kernels[name]
        for number, argument in enumerate(arguments, first):
            if isinstance(argument, np.generic | np.ndarray):
                value = argument.tobytes()
                if self._known.get((name, number)) == value:
                    continue
                self._known.pop((name, number), None)
                kernel.set_arg(number, argument)
                self._known[name, number] = value
            else:
                kernel.set_arg(number, argument)


class HalfSteps:
    """Iterations on the device.

    Parameters
    ----------
    loop : RowLoop
    log_sum_exp : LogSumExp
    take_turns : callable
        Makes methods run one at a time on a device, see `OpenCLOperations`.
    """

    def __init__(
        self, loop: RowLoop, log_sum_exp: LogSumExp, take_turns: Callable[[Any], Any]
    ) -> None:
        self._loop, self._log_sum_exp = loop, log_sum_exp
        self._bound: dict[Any, _Bound] = {}
        self.set_potential = take_turns(self._set_potential)
        self.iterate = take_turns(self._iterate)
        self.potentials = take_turns(self._potentials)

    def start_iteration(
        self, rows: Cloud, columns: Cloud, weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
    ) -> DeviceIteration | None:  # fmt: skip
        """Put the vectors of an iteration on the device, or return None."""
        loop, work = self._loop, self._loop.work
        tiles = len(rows.centers), len(columns.centers)
        is_processor = work.device.type & cl.device_type.CPU
        most = MOST_PAIRS if is_processor else MOST_PAIRS_ELSEWHERE
        if (
            not Variant("half_steps.cl").suits(loop.constants)
            or tiles[0] * tiles[1] > KEPT_LEVELS
            or rows.stride * columns.stride > most
        ):
            return None
        differences = rows.centers[:, None] - columns.centers
        costs = 0.5 * np.einsum("pqd,pqd->pq", differences, differences)
        sides = []
        for cloud, masses, slots in (
            (rows, weights[0], len(ROW_SLOTS)),
            (columns, weights[1], len(COLUMN_SLOTS) - 2 + 2 * MEMORY),
        ):
            vectors = np.zeros((slots, cloud.stride))
            n = len(cloud)
            own = masses[cloud.order]
            with np.errstate(divide="ignore"):
                logarithms = np.log(own)
            given = own, logarithms, cloud.own_costs, cloud.offsets, cloud.log2_weights
            for place, values in enumerate(given):
                vectors[place, :n] = values
            # Points that pad a side have no mass.
            for name, filler in (
                ("LOG_WEIGHTS", -np.inf), ("LOG2_WEIGHTS", SENTINEL),
            ):  # fmt: skip
                vectors[GIVEN.index(name), n:] = filler
            for name in ("OWN_COSTS", "OFFSETS"):
                vectors[GIVEN.index(name), n:] = vectors[GIVEN.index(name), n - 1]
            sides.append(work.buffer(vectors, np.float64))
        made = DeviceIteration(
            self, rows, columns, inverse_rho,
            (sides[0], sides[1]),
            (work.buffer(costs, np.float64), work.buffer(costs.T, np.float64)), {},
        )  # fmt: skip
        longest = max(rows.stride, columns.stride)
        shares = max(loop.column_shares(rows, columns), loop.column_shares(columns, rows))
        n_bytes = {
            "maxima": 4 * shares * longest, "sums": 4 * shares * longest,
            "logits": 8 * longest, "levels": 8 * tiles[0] * tiles[1],
            "start": 8 * columns.stride, "row_level": 8 * tiles[0], "column_level": 8 * tiles[1],
            "tile_max": 8 * max(tiles), "products": 8 * MEMORY**2, "numbers": 8 * len(NUMBERS),
        }  # fmt: skip
        made.work = {name: work.empty(size) for name, size in n_bytes.items()}
        return made

    def _set_potential(
        self, iteration: DeviceIteration, g: Float64, epsilon: float, precise: bool
    ) -> None:
        """Write the potential at which the next iteration begins; see `ResidentIteration`."""
        columns, work = iteration.columns, self._loop.work
        values = pad(np.asarray(g, float)[columns.order], columns.stride, 0.0)
        iteration.epsilon, iteration.precise = epsilon, precise
        iteration.go_to_start()
        cl.enqueue_copy(work.queue, iteration.work["start"], values, is_blocking=True)

    def _budget(self, iteration: DeviceIteration) -> LaunchBudget:
        loop = self._loop
        return loop.budget(
            loop.kernel("log_sum_exp.cl", "log_sum_exp", iteration.rows, iteration.precise)
        )

    def _iterate(
        self, iteration: DeviceIteration, begun: bool, place: int, count: int, radius: float
    ) -> IterationNumbers:
        """Enqueue one iteration, wait for it, and return its numbers."""
        check_cancelled()
        work, loop = self._loop.work, self._loop
        bound = self._kernels(iteration)
        control = iteration.control(begun, place, count)
        kernels = bound.kernels
        group = (loop.constants.group,)
        events: list[cl.Event] = []

        def enqueue(name: str, size: tuple[int, ...], local: tuple[int, ...]) -> None:
            events.append(
                cl.enqueue_nd_range_kernel(
                    work.queue, kernels[name], size, local, wait_for=events[-1:]
                )
            )

        rows, columns = iteration.rows, iteration.columns
        pairs = 2 * rows.stride * columns.stride
        prepared, iteration.prepared = iteration.prepared, -1
        with self._budget(iteration).measure(pairs):
            try:
                if prepared != iteration.at:
                    bound.set("prepare_rows", 3, control)
                    enqueue("prepare_rows", group, group)
                enqueue("rows", *self._sizes(rows, columns))
                bound.set("row_step", 4, control)
                enqueue("row_step", group, group)
                enqueue("columns", *self._sizes(columns, rows))
                bound.set("column_step", 4, control)
                bound.set("column_step", 9, np.float64(radius))
                enqueue("column_step", group, group)
                events.append(
                    cl.enqueue_copy(
                        work.queue,
                        iteration.numbers,
                        iteration.work["numbers"],
                        is_blocking=False,
                        wait_for=events[-1:],
                    )
                )
            finally:
                if events:
                    cl.wait_for_events(events[-1:])
        found = dict(zip(NUMBERS, iteration.numbers.tolist(), strict=True))
        iteration.has_prepared(bool(found["FOUND"]))
        return read_numbers(found)

    def _potentials(self, iteration: DeviceIteration) -> tuple[Float64, Float64, Float64]:
        """Return f, the image of g, and T(f) after the last iteration."""
        work, found, events = self._loop.work, [], []
        places = (
            (0, iteration.rows, ROW_SLOTS.index("SHIFTED")),
            (1, iteration.columns, iteration.image),
            (1, iteration.columns, COLUMN_SLOTS.index("SOFTMIN")),
        )  # fmt: skip
        try:
            for side, cloud, place in places:
                found.append(np.empty(len(cloud)))
                events.append(
                    cl.enqueue_copy(
                        work.queue,
                        found[-1],
                        iteration.sides[side],
                        src_offset=8 * place * cloud.stride,
                        is_blocking=False,
                    )
                )
        finally:
            if events:
                cl.wait_for_events(events)
        f, g, t_columns = (
            unsort(cloud, values) for (_, cloud, _), values in zip(places, found, strict=True)
        )
        return f, g, t_columns

    def _sizes(self, own: Cloud, other: Cloud) -> tuple[tuple[int, ...], tuple[int, ...]]:
        constants = self._loop.constants
        return (
            (own.stride // constants.width, self._loop.column_shares(own, other)),
            (constants.group, 1),
        )

    def _kernels(self, iteration: DeviceIteration) -> _Bound:
        """Return kernels with all arguments set but those that change in an iteration."""
        dimension = iteration.rows.centers.shape[1]
        key = dimension, iteration.precise
        programs = self._loop.programs
        if key not in self._bound:
            softmin = Variant("log_sum_exp.cl", dimension, iteration.precise)
            steps = programs.kernels(Variant("half_steps.cl"))
            for side in ("rows", "columns"):
                steps[side] = programs.kernels(softmin)["log_sum_exp"]
            self._bound[key] = _Bound(steps)
        bound = self._bound[key]
        if bound.iteration is None or bound.iteration() is not iteration:
            bound.iteration, bound.epsilon = None, 0.0
            self._set_buffers(bound, iteration)
            bound.iteration = weakref.ref(iteration)
        if bound.epsilon != iteration.epsilon:
            bound.epsilon = 0.0
            k = LOG2_E / iteration.epsilon
            for name in ("rows", "columns"):
                bound.set(name, 6, *split(np.asarray(k)))
            for name in ("row_step", "column_step"):
                bound.set(name, 5, np.float64(k), np.float64(iteration.epsilon))
            bound.set("prepare_rows", 4, np.float64(k))
            bound.epsilon = iteration.epsilon
        return bound

    def _set_buffers(self, bound: _Bound, iteration: DeviceIteration) -> None:
        """Set what stays the same while an iteration goes on: sizes, rates and buffers."""
        rows, columns, own = iteration.rows, iteration.columns, iteration.work
        planes, none = np.uint32(1 + iteration.precise), np.uint32(0)
        sizes = np.uint32(rows.stride), np.uint32(columns.stride)
        for name, to, of in (("rows", rows, columns), ("columns", columns, rows)):
            tiles = np.uint32(len(of.centers))
            bound.set(name, 0, none, np.uint32(to.stride), np.uint32(of.stride), tiles, none, tiles)
            bound.set(
                name, 8, to.shifts_buffer, to.centers_buffer, of.shifts_buffer, of.centers_buffer,
                own["logits"], own["levels"], np.uint32(to.stride), own["maxima"], own["sums"],
            )  # fmt: skip
        for name, to, of, costs, level, following in (
            ("row_step", rows, columns, iteration.costs[1], "row_level", "column_level"),
            ("column_step", columns, rows, iteration.costs[0], "column_level", "row_level"),
        ):
            shares = np.uint32(self._loop.column_shares(to, of))
            bound.set(name, 0, *sizes, shares, planes, none)
            bound.set(
                name, 7, *map(np.float64, iteration.rates), np.float64(0), own["maxima"],
                own["sums"], own[level], *iteration.sides, costs, own["tile_max"],
                own[following], own["logits"], own["levels"], own["products"], own["numbers"],
            )  # fmt: skip
        bound.set("prepare_rows", 0, *sizes, planes, none)
        bound.set(
            "prepare_rows", 5, own["start"], iteration.sides[1], iteration.costs[0],
            own["tile_max"], own["row_level"], own["logits"], own["levels"],
        )  # fmt: skip
