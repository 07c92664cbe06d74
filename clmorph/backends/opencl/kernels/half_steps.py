"""The host side of ``cl_kernels/half_steps.cl``: iterations whose vectors stay on the device."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyopencl as cl

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
from clmorph.backends.opencl.kernels.resident_iteration import (
    BoundKernels,
    DeviceIteration,
    Launch,
    ResidentSteps,
    Slots,
)
from clmorph.backends.opencl.kernels.row_loop import KEPT_LEVELS, LOG2_E, RowLoop
from clmorph.backends.records import Float64

#: The largest number of pairs of points on the host's processor, where a softmin of so many takes
#: some tens of milliseconds in its one launch, and on other devices: a single work-group of a
#: graphics card has a small share of its float64 arithmetic. Measured speeds decide nothing here,
#: so that a problem is always solved in the same way.
MOST_PAIRS, MOST_PAIRS_ELSEWHERE = 1 << 25, 1 << 22
#: Names of the arguments of kernels, in their order. "rows" and "columns" are softmins.
_RATES = ("epsilon", "inverse_rho_source", "inverse_rho_target", "radius")
_SIDES, _LOGITS = ("rows", "columns"), ("logits", "levels")
ARGUMENTS = {
    "prepare_rows": (
        "n", "m", "planes", "first_control", "k", "start", "columns", "row_costs", "tile_max",
        "row_level", *_LOGITS,
    ),
    "row_step": (
        "n", "m", "row_shares", "planes", "control", "k", *_RATES, "maxima", "sums", "row_level",
        *_SIDES, "column_costs", "tile_max", "column_level", *_LOGITS, "products", "numbers",
    ),
    "column_step": (
        "n", "m", "column_shares", "planes", "control", "k", *_RATES, "maxima", "sums",
        "column_level", *_SIDES, "row_costs", "tile_max", "row_level", *_LOGITS, "products",
        "numbers",
    ),
    "rows": (
        "none", "n", "m", "column_tiles", "none", "column_tiles", "k_high", "k_low", "row_shifts",
        "row_centers", "column_shifts", "column_centers", *_LOGITS, "n", "maxima", "sums",
    ),
    "columns": (
        "none", "m", "n", "row_tiles", "none", "row_tiles", "k_high", "k_low", "column_shifts",
        "column_centers", "row_shifts", "row_centers", *_LOGITS, "m", "maxima", "sums",
    ),
}  # fmt: skip
SLOTS = Slots(ROW_SLOTS, COLUMN_SLOTS, NUMBERS)


class HalfSteps(ResidentSteps):
    """Iterations over all pairs of points."""

    def __init__(self, loop: RowLoop, take_turns: Callable[[Any], Any]) -> None:
        super().__init__(loop.work, take_turns)
        self._loop = loop
        self._bound: dict[Any, BoundKernels] = {}

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
        longest = max(rows.stride, columns.stride)
        shares = loop.column_shares(rows, columns), loop.column_shares(columns, rows)
        n_bytes = {
            "maxima": 4 * max(shares) * longest, "sums": 4 * max(shares) * longest,
            "logits": 8 * longest, "levels": 8 * tiles[0] * tiles[1],
            "start": 8 * columns.stride, "row_level": 8 * tiles[0], "column_level": 8 * tiles[1],
            "tile_max": 8 * max(tiles), "products": 8 * MEMORY**2, "numbers": 8 * len(NUMBERS),
        }  # fmt: skip
        numbers = {
            "none": 0, "n": rows.stride, "m": columns.stride, "row_tiles": tiles[0],
            "column_tiles": tiles[1], "row_shares": shares[0], "column_shares": shares[1],
        }  # fmt: skip
        arguments = {
            **{name: work.empty(size) for name, size in n_bytes.items()},
            **{name: np.uint32(number) for name, number in numbers.items()},
            "rows": sides[0], "columns": sides[1],
            "row_costs": work.buffer(costs, np.float64),
            "column_costs": work.buffer(costs.T, np.float64),
            "row_shifts": rows.shifts_buffer, "row_centers": rows.centers_buffer,
            "column_shifts": columns.shifts_buffer, "column_centers": columns.centers_buffer,
            "inverse_rho_source": np.float64(inverse_rho[0]),
            "inverse_rho_target": np.float64(inverse_rho[1]),
        }  # fmt: skip
        return DeviceIteration(self, SLOTS, (rows, columns), arguments)

    def _begin(self, iteration: DeviceIteration, g: Float64) -> dict[str, Float64]:
        columns = iteration.sides[1]
        return {"start": pad(g[columns.order], columns.stride, 0.0)}

    def _in_order(self, side: Cloud, values: Float64) -> Float64:
        return unsort(side, values)

    def _measured(self, iteration: DeviceIteration) -> contextlib.AbstractContextManager[None]:
        loop, (rows, columns) = self._loop, iteration.sides
        kernel = loop.kernel("log_sum_exp.cl", "log_sum_exp", rows, iteration.precise)
        return loop.budget(kernel).measure(2 * rows.stride * columns.stride)

    def _launches(self, iteration: DeviceIteration, prepare: bool) -> Iterator[Launch]:
        constants, (rows, columns) = self._loop.constants, iteration.sides
        group = (constants.group,)
        if prepare:
            yield "prepare_rows", group, group
        for softmin, step, own, shares in (
            ("rows", "row_step", rows, "row_shares"),
            ("columns", "column_step", columns, "column_shares"),
        ):
            size = own.stride // constants.width, int(iteration.arguments[shares])
            yield softmin, size, (constants.group, 1)
            yield step, group, group

    def _kernels(self, iteration: DeviceIteration) -> BoundKernels:
        dimension, precise = iteration.sides[0].centers.shape[1], iteration.precise
        programs, key = self._loop.programs, (dimension, precise)
        if key not in self._bound:
            kernels = programs.kernels(Variant("half_steps.cl"))
            for side in ("rows", "columns"):
                own = programs.kernels(Variant("log_sum_exp.cl", dimension, precise))
                kernels[side] = own["log_sum_exp"]
            self._bound[key] = BoundKernels(kernels, ARGUMENTS)
        return self._bound[key]

    def _scalars(self, iteration: DeviceIteration) -> dict[str, Any]:
        high, low = split(np.asarray(LOG2_E / iteration.epsilon))
        planes = np.uint32(1 + iteration.precise)
        return super()._scalars(iteration) | {"k_high": high, "k_low": low, "planes": planes}
