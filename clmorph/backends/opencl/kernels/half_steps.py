"""The host of ``cl_kernels/half_steps.cl``: iterations whose vectors stay on the device."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import half_step_slots
from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM
from clmorph.backends.opencl.build.half_step_slots import (
    COLUMN_SLOTS,
    GIVEN,
    NUMBERS,
    PROBLEM,
    ROW_SLOTS,
)
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.batches import Batch, as_batch, pairs_of, runs
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.resident_iteration import (
    BoundKernels,
    DeviceIteration,
    Launch,
    ResidentSteps,
)
from clmorph.backends.opencl.kernels.row_loop import KEPT_LEVELS, LOG2_E, RowLoop, work_of_pair
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs
from clmorph.backends.records import Float64

#: The largest number of pairs of points on the host's processor, where a softmin of so many takes
#: some tens of milliseconds in its one launch, and on other devices: a single work-group of a
#: graphics card has a small share of its float64 arithmetic. Measured speeds decide nothing here,
#: so that a problem is always solved in the same way.
MOST_PAIRS, MOST_PAIRS_ELSEWHERE = 1 << 25, 1 << 22
#: The largest number of pairs of points, those that pad tiles included, of many problems.
MOST_OF_MANY = 1 << 27
#: Names of the arguments of kernels, in their order. "rows" and "columns" are softmins.
_RATES = ("epsilon", "inverse_rho_source", "inverse_rho_target")
_LOGITS = "logits", "levels"


def _step(own: str, other: str) -> tuple[str, ...]:
    """Return the arguments of both steps, after the softmin of one side and for the other's."""
    return (
        "problems", "control", "n", "m", f"{own}_shares", "planes", "n_listed", "k", *_RATES,
        "maxima", "sums", f"{own}_level", "rows", "columns", f"{other}_costs", "tile_max",
        f"{other}_level", *_LOGITS, "numbers",
    )  # fmt: skip


ARGUMENTS = {
    "prepare_rows": (
        "problems", "control", "n", "m", "planes", "n_listed", "k", "start", "columns",
        "row_costs", "tile_max", "row_level", *_LOGITS,
    ),
    "row_step": _step("row", "column"),
    "column_step": (*_step("column", "row"), "radius", "products"),
}  # fmt: skip


def _arguments(listed: bool, sliced: bool) -> dict[str, tuple[str, ...]]:
    """Return the arguments of all kernels; softmins of many problems see listed tiles."""
    softmins = {
        own: (
            "none", n, m, f"{other}_tiles", "none", f"{other}_tiles", "k_high", "k_low",
            *(("dimension",) if sliced else ()),
            f"{own}_shifts", f"{own}_centers", f"{other}_shifts", f"{other}_centers", *_LOGITS,
            *(("n_listed", f"{own}_starts", f"{own}_listed") if listed else ()),
            n, "maxima", "sums",
        )
        for own, other, n, m in (("row", "column", "n", "m"), ("column", "row", "m", "n"))
    }  # fmt: skip
    return ARGUMENTS | {"rows": softmins["row"], "columns": softmins["column"]}


#: Where the control of a problem stands, before the two halves of its radius.
CONTROL = PROBLEM.index("CONTROL")


@dataclass(eq=False, kw_only=True)
class BatchIteration(DeviceIteration):
    """Iterations of many problems, each of which stops by itself, or of one.

    The table, (problems, fields), is what kernels are told of each problem that is left. If there
    are many, softmins see `listed` pairs of tiles, and the table has controls.
    """

    batches: tuple[Batch, Batch]
    lists: tuple[TilePairs, TilePairs]
    listed: bool
    table: NDArray[np.uint32] = field(init=False)


class HalfSteps(ResidentSteps[BatchIteration]):
    """Iterations over all pairs of points, of one problem or of many."""

    variant, slots = Variant("half_steps.cl"), half_step_slots

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        super().__init__(loop, take_turns)
        self._loop = loop
        self._bound: dict[Any, BoundKernels] = {}

    def _fits(self, pairs: Any) -> bool:
        """Return whether the device can iterate over so many pairs of points of each problem."""
        is_processor = self._work.device.type & cl.device_type.CPU
        most = MOST_PAIRS if is_processor else MOST_PAIRS_ELSEWHERE
        fits = np.max(pairs) <= most and np.sum(pairs) <= MOST_OF_MANY
        return bool(fits) and self.is_possible()

    def start_iteration(
        self, rows: Cloud | Batch, columns: Cloud | Batch, weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
        corrections: tuple[Float64 | float, Float64 | float] = (0.0, 0.0),
    ) -> DeviceIteration | None:  # fmt: skip
        """Put the vectors of an iteration on the device, or return None."""
        tile, batches = self._loop.constants.tile, (as_batch(rows), as_batch(columns))
        blocks = batches[0].tiles * batches[1].tiles
        clouds = batches[0].cloud, batches[1].cloud
        if blocks.max() > KEPT_LEVELS or not self._fits(blocks * tile**2 * work_of_pair(clouds[0])):
            return None
        masses, costs = [], []
        for side, own, added in zip(batches, weights, corrections, strict=True):
            within = runs(np.zeros_like(side.tiles), side.tiles * tile)
            padded = within >= np.repeat(side.counts, side.tiles * tile)
            masses.append(np.where(padded[: len(side.cloud)], 0.0, own[side.cloud.order]))
            # Costs of rows alone are added to their softmins, and to no logits.
            shifts = np.broadcast_to(added, own.shape)[side.cloud.order]
            costs.append(side.cloud.own_costs + shifts)
        low = np.min([cloud.box[0] for cloud in clouds], axis=0)
        high = np.max([cloud.box[1] for cloud in clouds], axis=0)
        offsets = sum(float(np.abs(cloud.offsets).max()) for cloud in clouds)
        units = self._chosen_units(0.5 * np.sum((high - low) ** 2) + offsets, masses[0].sum())
        lists = pairs_of(*batches), pairs_of(*batches[::-1])
        listed = isinstance(rows, Batch)
        arguments = self._given(
            clouds, (masses[0], masses[1]), (costs[0], costs[1]), inverse_rho, units,
            len(blocks), int(blocks.sum()), lists if listed else (None, None),
        )  # fmt: skip
        made = BatchIteration(
            self, clouds, arguments, np.zeros(0), units, batches=batches, lists=lists, listed=listed
        )
        self._keep(made, np.arange(len(blocks)))
        return made

    def _keep(self, iteration: BatchIteration, problems: NDArray[np.intp]) -> None:
        """Write lines of some problems, and list the pairs of their tiles, if there are many."""
        (rows, columns), tile, work = iteration.batches, self._loop.constants.tile, self._work
        left = np.zeros(len(rows.counts), bool)
        left[problems] = True
        blocks = np.where(left, rows.tiles * columns.tiles, 0)
        fields = {
            "FIRST_ROW": rows.first_tiles * tile, "N": rows.tiles * tile,
            "FIRST_COLUMN": columns.first_tiles * tile, "M": columns.tiles * tile,
            "FIRST_PAIR": np.cumsum(blocks) - blocks, "NUMBER": np.arange(len(left)),
        }  # fmt: skip
        table = np.zeros((len(problems), len(PROBLEM)), np.uint32)
        for name, values in fields.items():
            table[:, PROBLEM.index(name)] = values[problems]
        listed, units = iteration.listed, iteration.units
        arguments: dict[str, Any] = {"problems": work.buffer(table, np.uint32)}
        arguments["n_listed"] = np.uint32(blocks.sum() if listed else 0)
        for own, side, others, pairs in zip(
            ("row", "column"), iteration.batches, iteration.batches[::-1], iteration.lists,
            strict=True,
        ):  # fmt: skip
            there = np.repeat(left, side.tiles)
            kept = np.repeat(there, np.diff(pairs.starts))
            arguments[f"{own}_costs"] = self._buffer(pairs.distances[kept] / units[0])
            if listed:
                per_tile = np.where(there, np.repeat(others.tiles, side.tiles), 0)
                starts = np.append(0, np.cumsum(per_tile))
                arguments[f"{own}_starts"] = work.buffer(starts, np.uint32)
                arguments[f"{own}_listed"] = work.buffer(pairs.tiles[kept], np.uint32)
        iteration.arguments |= arguments
        iteration.table, iteration.n_pairs = table, 2 * int(blocks.sum()) * tile**2
        iteration.numbers = np.zeros((len(table), len(NUMBERS)) if listed else len(NUMBERS))
        iteration.version, iteration.prepared = iteration.version + 1, -1

    def _given(
        self,
        clouds: tuple[Cloud, Cloud],
        masses: tuple[Float64, Float64],
        own_costs: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
        units: tuple[float, float],
        count: int,
        n_pairs: int,
        lists: tuple[TilePairs | None, TilePairs | None],
    ) -> dict[str, Any]:
        """Return the arguments of `count` problems with so many pairs of tiles."""
        loop, work, (rows, columns) = self._loop, self._work, clouds
        tiles = len(rows.centers), len(columns.centers)
        sides = []
        for cloud, own, costs, slots in (
            (rows, masses[0], own_costs[0], len(ROW_SLOTS)),
            (columns, masses[1], own_costs[1], len(COLUMN_SLOTS) - 2 + 2 * MEMORY),
        ):
            with np.errstate(divide="ignore"):
                logarithms = np.log(own / units[1])
            costs, offsets = costs / units[0], cloud.offsets / units[0]
            # Points that pad a side have no mass.
            given = (
                (own / units[1], 0.0), (logarithms, -np.inf), (costs, costs[-1]),
                (offsets, offsets[-1]), (cloud.log2_weights, SENTINEL),
            )  # fmt: skip
            vectors = np.zeros((slots, cloud.stride))
            vectors[: len(GIVEN)] = [pad(values, cloud.stride, filler) for values, filler in given]
            sides.append(self._buffer(vectors))
        longest = max(rows.stride, columns.stride)
        stacks = loop.constants.stacks(rows.centers.shape[1], precise=False)
        shares = (
            loop.column_shares(rows, columns, lists[0], stacks),
            loop.column_shares(columns, rows, lists[1], stacks),
        )
        n_bytes = {
            "maxima": 4 * max(shares) * longest, "sums": 4 * max(shares) * longest,
            "logits": 8 * longest, "levels": 8 * n_pairs,
            "start": 8 * columns.stride, "row_level": 8 * tiles[0], "column_level": 8 * tiles[1],
            "tile_max": 8 * max(tiles), "products": 8 * MEMORY**2 * count,
            "numbers": 8 * len(NUMBERS) * count,
        }  # fmt: skip
        numbers = {
            "none": 0, "dimension": rows.centers.shape[1], "n": rows.stride, "m": columns.stride,
            "row_tiles": tiles[0], "column_tiles": tiles[1], "control": 0,
            "row_shares": shares[0], "column_shares": shares[1],
        }  # fmt: skip
        return {
            **{name: work.empty(size) for name, size in n_bytes.items()},
            **{name: np.uint32(number) for name, number in numbers.items()},
            "rows": sides[0], "columns": sides[1], "radius": self._real(0.0),
            "row_shifts": rows.shifts_buffer, "row_centers": rows.centers_buffer,
            "column_shifts": columns.shifts_buffer, "column_centers": columns.centers_buffer,
            "inverse_rho_source": self._real(inverse_rho[0] * units[0]),
            "inverse_rho_target": self._real(inverse_rho[1] * units[0]),
        }  # fmt: skip

    def _begin(self, iteration: BatchIteration, g: Float64) -> dict[str, Float64]:
        everyone = np.arange(len(iteration.batches[0].counts))
        if len(iteration.table) < len(everyone):
            self._keep(iteration, everyone)
        columns = iteration.sides[1]
        own = g[columns.order] / iteration.units[0]
        return {"start": self._packed(pad(own, columns.stride, 0.0))}

    def _in_order(self, side: Cloud, values: Float64) -> Float64:
        return unsort(side, values)

    def _tell(
        self, iteration: BatchIteration, bound: BoundKernels, control: Any, radius: Any
    ) -> list[cl.Event]:
        if not iteration.listed:
            return super()._tell(iteration, bound, control, radius)
        table, radii = iteration.table, self._packed(np.asarray(radius, float))
        table[:, CONTROL] = control
        table[:, CONTROL + 1 : CONTROL + 3] = radii.view(np.uint32).reshape(-1, 2)
        buffer = iteration.arguments["problems"]
        return [cl.enqueue_copy(self._work.queue, buffer, table, is_blocking=False)]

    def _launches(self, iteration: BatchIteration, prepare: bool) -> Iterator[Launch]:
        items, (rows, columns) = self._loop.constants.step_group, iteration.sides
        problems = iteration.numbers.size // len(NUMBERS)
        group, whole = (items,), (items * problems,)
        kernel = self._softmin_kernel(iteration)
        if prepare:
            yield "prepare_rows", whole, group
        for softmin, step, own, shares in (
            ("rows", "row_step", rows, "row_shares"),
            ("columns", "column_step", columns, "column_shares"),
        ):
            size = self._loop.launch_size(kernel, own.stride, int(iteration.arguments[shares]))
            yield softmin, *size
            yield step, whole, group

    def _softmin_kernel(self, iteration: BatchIteration) -> cl.Kernel:
        return self._loop.kernel(
            "log_sum_exp.cl", "log_sum_exp", iteration.sides[0], iteration.precise, iteration.listed
        )

    def _kernels(self, iteration: BatchIteration) -> BoundKernels:
        precise, listed = iteration.precise, iteration.listed
        dimension = min(iteration.sides[0].centers.shape[1], SLICED_FROM)
        programs, key = self._loop.programs, (dimension, precise, listed)
        if key not in self._bound:
            kernels = programs.kernels(self.variant)
            for side in ("rows", "columns"):
                own = programs.kernels(Variant("log_sum_exp.cl", dimension, precise, listed))
                kernels[side] = own["log_sum_exp"]
            budget = self._loop.budget(self._softmin_kernel(iteration))
            self._bound[key] = BoundKernels(
                kernels, _arguments(listed, dimension == SLICED_FROM), budget
            )
        return self._bound[key]

    def _scalars(self, iteration: BatchIteration) -> dict[str, Any]:
        high, low = split(np.asarray(LOG2_E / iteration.epsilon))
        planes = np.uint32(1 + iteration.precise)
        return super()._scalars(iteration) | {"k_high": high, "k_low": low, "planes": planes}
