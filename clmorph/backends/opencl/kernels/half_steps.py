"""The host of ``cl_kernels/half_steps.cl``: iterations whose vectors stay on the device."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.build import half_step_slots as slots
from clmorph.backends.opencl.build.constants import SENTINEL, SLICED_FROM
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.batches import Batch, as_batch, pairs_of, runs
from clmorph.backends.opencl.kernels.clouds import Cloud, pad, split, unsort
from clmorph.backends.opencl.kernels.resident_iteration import (
    BoundKernels,
    DeviceIteration,
    Launch,
    ResidentSteps,
    in_turn,
)
from clmorph.backends.opencl.kernels.row_loop import LOG2_E, RowLoop, work_of_pair
from clmorph.backends.opencl.kernels.tile_pairs import TilePairs, center_costs
from clmorph.backends.records import Float64

#: The largest number of pairs of points of a problem: one launch sums them in some tens of
#: milliseconds. A device whose `speed_factor` is above 1 takes the second number, multiplied by it.
#: One work-group computes between the sums there, and still needs less time than the host.
MOST_PAIRS, MOST_OF_FAST = 1 << 25, 1 << 27
#: The largest number of pairs of tiles.
MOST_LEVELS = 1 << 21
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
CONTROL = slots.PROBLEM.index("CONTROL")


class HalfSteps(ResidentSteps):
    """Iterations over all pairs of points, of one problem or of many."""

    variant = Variant("half_steps.cl")

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any], factor: int) -> None:
        super().__init__(loop, take_turns)
        self.factor = factor  #: `speed_factor` of the device

    def start_iteration(
        self, rows: Cloud | Batch, columns: Cloud | Batch, weights: tuple[Float64, Float64],
        inverse_rho: tuple[float, float],
        corrections: tuple[Float64 | float, Float64 | float] = (0.0, 0.0),
    ) -> DeviceIteration | None:  # fmt: skip
        """Put the vectors of an iteration on the device, or return None for too many pairs."""
        batches = as_batch(rows), as_batch(columns)
        blocks = batches[0].tiles * batches[1].tiles
        pairs = blocks * self.loop.constants.tile**2 * work_of_pair(batches[0].cloud)
        most = MOST_PAIRS if self.factor == 1 else self.factor * MOST_OF_FAST
        listed = isinstance(rows, Batch)
        fits = blocks.max() <= MOST_LEVELS and pairs.max() <= most
        fits &= not listed or pairs.sum() <= MOST_OF_MANY
        if not fits or not self.is_possible():
            return None
        return BatchIteration(self, batches, listed, weights, inverse_rho, corrections)


class BatchIteration(DeviceIteration):
    """Iterations of many problems, each of which stops by itself, or of one.

    The table, (problems, fields), is what kernels are told of each problem that is left. If there
    are many, softmins see `listed` pairs of tiles, and the table has controls.
    """

    slots = slots
    table: NDArray[np.uint32]

    def __init__(
        self, steps: HalfSteps, batches: tuple[Batch, Batch], listed: bool,
        weights: tuple[Float64, Float64], inverse_rho: tuple[float, float],
        corrections: tuple[Float64 | float, Float64 | float],
    ) -> None:  # fmt: skip
        rows, columns = clouds = batches[0].cloud, batches[1].cloud
        units = 1.0, 1.0
        if steps.in_pairs:
            low = np.min([cloud.box[0] for cloud in clouds], axis=0)
            high = np.max([cloud.box[1] for cloud in clouds], axis=0)
            offsets = sum(float(np.abs(cloud.offsets).max()) for cloud in clouds)
            units = steps.units(0.5 * np.sum((high - low) ** 2) + offsets, weights[0].sum())
        super().__init__(steps, clouds, units, {})
        self.batches, self.listed = batches, listed
        #: Costs between the centers of tiles, rows first and columns first, and the lists of many.
        self.costs, self.lists = list[Float64](), list[TilePairs]()
        if listed:
            self.lists = [pairs_of(*batches), pairs_of(*batches[::-1])]
            self.costs = [pairs.distances for pairs in self.lists]
        else:
            costs = center_costs(rows.centers[:, None], columns.centers)
            self.costs = [costs.ravel(), costs.T.ravel()]
        constants, work = self.loop.constants, self.loop.work
        stacks = constants.stacks(rows.centers.shape[1], precise=False)
        given, most_shares = self.arguments, 0
        for name, own, other, pairs, own_weights, added in zip(
            ("row", "column"), batches, batches[::-1], self.lists or (None, None), weights,
            corrections, strict=True,
        ):  # fmt: skip
            cloud, tiles = own.cloud, len(own.cloud.centers)
            shares = self.loop.column_shares(cloud, other.cloud, pairs, stacks)
            most_shares = max(most_shares, shares)
            given |= {
                f"{name}s": self._vectors(name, own, own_weights, added),
                f"{name}_tiles": np.uint32(tiles), f"{name}_shares": np.uint32(shares),
                f"{name}_level": work.empty(8 * tiles),
                f"{name}_shifts": cloud.shifts_buffer, f"{name}_centers": cloud.centers_buffer,
            }  # fmt: skip
        for rate, inverse in zip(("source", "target"), inverse_rho, strict=True):
            given[f"inverse_rho_{rate}"] = steps.real(inverse * units[0])
        count, longest = len(own.counts), max(rows.stride, columns.stride)
        n_bytes = {
            "maxima": 4 * most_shares * longest, "sums": 4 * most_shares * longest,
            "logits": 8 * longest, "levels": 8 * len(self.costs[0]),
            "start": 8 * columns.stride, "products": 8 * MEMORY**2 * count,
            "tile_max": 8 * max(len(cloud.centers) for cloud in clouds),
            "numbers": 8 * len(slots.NUMBERS) * count,
        }  # fmt: skip
        numbers = {
            "none": 0, "control": 0, "dimension": rows.centers.shape[1],
            "n": rows.stride, "m": columns.stride,
        }  # fmt: skip
        given |= {name: work.empty(size) for name, size in n_bytes.items()}
        given |= {name: np.uint32(number) for name, number in numbers.items()}
        given["radius"] = steps.real(0.0)
        self._sequences: dict[tuple[bool, bool, int], list[Launch]] = {}
        self._keep(np.arange(count))

    def _vectors(self, name: str, own: Batch, weights: Float64, added: Float64 | float) -> Any:
        """Return the vectors of a side, of which the host gives the first."""
        cloud, (cost, mass) = own.cloud, self.units
        masses = weights[cloud.order] / mass
        if self.listed:
            tile = self.loop.constants.tile
            within = runs(np.zeros_like(own.tiles), own.tiles * tile)
            masses[within >= np.repeat(own.counts, own.tiles * tile)] = 0.0
        with np.errstate(divide="ignore"):
            logarithms = np.log(masses)
        # Costs of rows alone are added to their softmins, and to no logits.
        costs = (cloud.own_costs + np.broadcast_to(added, weights.shape)[cloud.order]) / cost
        offsets = cloud.offsets / cost
        # Points that pad a side have no mass.
        given = (
            (masses, 0.0), (logarithms, -np.inf), (costs, costs[-1]), (offsets, offsets[-1]),
            (cloud.log2_weights, SENTINEL),
        )  # fmt: skip
        count = {"row": len(slots.ROW_SLOTS), "column": len(slots.COLUMN_SLOTS) - 2 + 2 * MEMORY}
        vectors = np.zeros((count[name], cloud.stride))
        vectors[: len(given)] = [pad(values, cloud.stride, filler) for values, filler in given]
        return self.steps.buffer(vectors)

    def _keep(self, problems: NDArray[np.intp]) -> None:
        """Write lines of some problems, and list the pairs of their tiles, if there are many."""
        (rows, columns), tile, work = self.batches, self.loop.constants.tile, self.loop.work
        left = np.zeros(len(rows.counts), bool)
        left[problems] = True
        blocks = np.where(left, rows.tiles * columns.tiles, 0)
        fields = {
            "FIRST_ROW": rows.first_tiles * tile, "N": rows.tiles * tile,
            "FIRST_COLUMN": columns.first_tiles * tile, "M": columns.tiles * tile,
            "FIRST_PAIR": np.cumsum(blocks) - blocks, "NUMBER": np.arange(len(left)),
        }  # fmt: skip
        self.table = np.zeros((len(problems), len(slots.PROBLEM)), np.uint32)
        for name, values in fields.items():
            self.table[:, slots.PROBLEM.index(name)] = values[problems]
        self.arguments["problems"] = work.buffer(self.table, np.uint32)
        self.arguments["n_listed"] = np.uint32(blocks.sum() if self.listed else 0)
        for number, own in enumerate(("row", "column")):
            costs = self.costs[number]
            if self.listed:
                side, others, pairs = *self.batches[:: 1 - 2 * number], self.lists[number]
                there = np.repeat(left, side.tiles)
                kept = np.repeat(there, np.diff(pairs.starts))
                per_tile = np.where(there, np.repeat(others.tiles, side.tiles), 0)
                starts = np.append(0, np.cumsum(per_tile))
                self.arguments[f"{own}_starts"] = work.buffer(starts, np.uint32)
                self.arguments[f"{own}_listed"] = work.buffer(pairs.tiles[kept], np.uint32)
                costs = costs[kept]
            self.arguments[f"{own}_costs"] = self.steps.buffer(costs / self.units[0])
        self.n_pairs = 2 * int(blocks.sum()) * tile**2
        count = len(slots.NUMBERS)
        self.numbers = np.zeros((len(problems), count) if self.listed else count)
        self.version, self.prepared = self.version + 1, -1

    keep = in_turn(_keep)

    def _begin(self, g: Float64) -> dict[str, Float64]:
        everyone = np.arange(len(self.batches[0].counts))
        if len(self.table) < len(everyone):
            self._keep(everyone)
        columns = self.sides[1]
        return {"start": pad(g[columns.order] / self.units[0], columns.stride, 0.0)}

    def _in_order(self, side: Cloud, values: Float64) -> Float64:
        return unsort(side, values)

    def _tell(self, control: Any, radius: Any, events: list[cl.Event]) -> dict[str, Any]:
        if not self.listed:
            return super()._tell(control, radius, events)
        table, radii = self.table, self.steps.packed(np.asarray(radius, float))
        table[:, CONTROL] = control
        table[:, CONTROL + 1 : CONTROL + 3] = radii.view(np.uint32).reshape(-1, 2)
        buffer = self.arguments["problems"]
        events.append(cl.enqueue_copy(self.loop.work.queue, buffer, table, is_blocking=False))
        return {}

    def _launches(self, prepare: bool) -> list[Launch]:
        key = prepare, self.precise, self.version
        if key not in self._sequences:
            self._sequences = {key: list(self._sequence(prepare))}
        return self._sequences[key]

    def _sequence(self, prepare: bool) -> Iterator[Launch]:
        group, kernel = (self.loop.constants.step_group,), self._softmin_kernel()
        whole = (group[0] * len(self.table),)
        if prepare:
            yield "prepare_rows", whole, group
        for own, side in zip(("row", "column"), self.sides, strict=True):
            shares = int(self.arguments[f"{own}_shares"])
            yield f"{own}s", *self.loop.launch_size(kernel, side.stride, shares)
            yield f"{own}_step", whole, group

    def _softmin_kernel(self) -> cl.Kernel:
        return self.loop.kernel(
            "log_sum_exp.cl", "log_sum_exp", self.sides[0], self.precise, self.listed
        )

    def _kernels(self) -> BoundKernels:
        dimension = min(self.sides[0].centers.shape[1], SLICED_FROM)
        programs, key = self.loop.programs, (dimension, self.precise, self.listed)
        if key not in self.steps.bound:
            kernels = programs.kernels(self.steps.variant)
            for side in ("rows", "columns"):
                kernels[side] = programs.kernels(Variant("log_sum_exp.cl", *key))["log_sum_exp"]
            self.steps.bound[key] = BoundKernels(
                kernels, _arguments(self.listed, dimension == SLICED_FROM),
                self.loop.budget(self._softmin_kernel()),
            )  # fmt: skip
        return self.steps.bound[key]

    def scalars(self) -> dict[str, Any]:
        """Return the arguments that follow from epsilon, those of softmins included."""
        high, low = split(np.asarray(LOG2_E / self.epsilon))
        planes = np.uint32(1 + self.precise)
        return super().scalars() | {"k_high": high, "k_low": low, "planes": planes}
