"""The operations of `clmorph.operations.Operations` on an OpenCL device."""

import functools
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.errors import DeviceError
from clmorph.opencl import program
from clmorph.opencl.knobs import SENTINEL, Knobs, choose_knobs
from clmorph.opencl.launches import LaunchBudget, launch
from clmorph.opencl.splatting import ParticleSet, Splats, Splatting
from clmorph.operations import MAX_POINTS, Bins, Float32, Float64, PlanRows
from clmorph.tiles import tile_order

P = ParamSpec("P")
T = TypeVar("T")

LOG2_E = float(np.log2(np.e))

#: Kept pairs that one launch may write (12 bytes each on the device).
FILL_PAIRS = 1 << 24


@dataclass(frozen=True)
class Cloud:
    """A cloud on the device, sorted into tiles and padded to whole ones.

    Attributes
    ----------
    order : (N,) array
        Where each sorted point stood in the caller's arrays.
    centers : (tiles, D) array
        Tile centers; exact in float32.
    log2_weights : (N,) array
        Sorted; SENTINEL for zero mass.
    half_squares : (N,) array
        Sorted; half the squared distance of each point to its tile's center.
    stride : int
        N padded to whole tiles.
    offsets_buffer : (D, stride) float32
        Points less their tile's center.
    centers_buffer : (tiles, D) float32
    """

    order: NDArray[np.intp]
    centers: Float64
    log2_weights: Float64
    half_squares: Float64
    stride: int
    offsets_buffer: cl.Buffer
    centers_buffer: cl.Buffer

    def __len__(self) -> int:
        return len(self.order)


def _operation(method: Callable[P, T]) -> Callable[P, T]:
    """Run one operation at a time on a device, and tell its failures in our words.

    Kernels keep their arguments between being set and being launched, so two threads must
    not share one.
    """

    @functools.wraps(method)
    def run(*arguments: P.args, **options: P.kwargs) -> T:
        operations = cast("OpenCLOperations", arguments[0])
        with operations.lock:
            try:
                return method(*arguments, **options)
            except (cl.Error, MemoryError) as error:
                reason = " ".join(str(error).split()) or type(error).__name__
                raise DeviceError(
                    f"{operations.description} failed in {method.__name__} ({reason}); use "
                    "smaller images or a smaller blur if memory ran out, or another device"
                ) from error

    return run


class OpenCLOperations:
    """Operations on one device; safe to share between threads, which take turns.

    Parameters
    ----------
    device : pyopencl.Device
    knobs : Knobs, optional
        Build-time constants; chosen by the kind of device if not given.
    """

    def __init__(self, device: cl.Device, knobs: Knobs | None = None) -> None:
        self.device = device
        self.lock = threading.RLock()
        self.knobs = knobs or choose_knobs(device)
        self.bin_size = self.knobs.bin
        self.unit_roundoff = 2.0**-24
        self.description = (
            f"{' '.join(device.name.split())} "
            f"({device.platform.name.strip()}, driver {device.driver_version.strip()})"
        )
        try:
            self.context = cl.Context([device])
            self.queue = cl.CommandQueue(self.context)
        except cl.Error as error:
            raise DeviceError(
                f"{self.description} cannot be opened: {error}; "
                "choose another device with --device or CLMORPH_DEVICE"
            ) from error
        self._budget = LaunchBudget()
        self._kernels: dict[int, dict[str, cl.Kernel]] = {}
        self._splatting: Splatting | None = None

    def __repr__(self) -> str:
        return f"<OpenCLOperations on {self.description}>"

    # --- clouds and row reductions -------------------------------------------------

    @_operation
    def upload(self, points: Float64, weights: Float64) -> Cloud:
        """Take a weighted cloud."""
        points = np.asarray(points, float)
        tile = self.knobs.tile
        n, dimension = points.shape
        if n > MAX_POINTS:
            raise DeviceError(f"{n} points are too many: expected at most 2^24; reduce the image")
        order = tile_order(points, tile)
        n_tiles = -(-n // tile)
        padded = np.pad(points[order], ((0, n_tiles * tile - n), (0, 0)), mode="edge")
        tiles = padded.reshape(n_tiles, tile, dimension)
        centers = 0.5 * (tiles.min(axis=1) + tiles.max(axis=1))
        # Rounded first, so that the device's copy is exact and offsets absorb the rounding.
        centers = centers.astype(np.float32).astype(float)
        offsets = (tiles - centers[:, None]).reshape(-1, dimension)
        with np.errstate(divide="ignore"):
            log2_weights = np.log2(np.asarray(weights, float)[order])
        return Cloud(
            order=order,
            centers=centers,
            log2_weights=np.maximum(log2_weights, SENTINEL),
            half_squares=0.5 * np.sum(offsets[:n] ** 2, axis=1),
            stride=n_tiles * tile,
            offsets_buffer=self._constant(np.ascontiguousarray(offsets.T)),
            centers_buffer=self._constant(centers),
        )

    @_operation
    def softmin(self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)."""
        log2_maxima, sums = self._log_sum_exp(rows, columns, potential, epsilon)
        return _unsort(rows, -epsilon / LOG2_E * (log2_maxima + np.log2(sums)))

    @_operation
    def row_maxima(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        return _unsort(rows, self._log_sum_exp(rows, columns, potential, epsilon)[0] / LOG2_E)

    @_operation
    def plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold: count, then fill."""
        kernels = self._row_kernels(rows)
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, g, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k)
        n, tile = len(rows), self.knobs.tile
        # log2 pi_ij = e_ij + bases_i; a row without mass keeps nothing.
        bases = np.repeat(tops_of_rows, tile)[:n] - k * rows.half_squares
        bases += f[rows.order] * k + rows.log2_weights
        bases[rows.log2_weights <= SENTINEL] = SENTINEL
        shared = (
            self._constant(_pad(bases, rows.stride, SENTINEL)),
            self._constant(
                _pad(_log2_threshold(row_thresholds)[rows.order], rows.stride, -SENTINEL)
            ),
            self._constant(
                _pad(_log2_threshold(column_thresholds)[columns.order], columns.stride, -SENTINEL)
            ),
        )

        counts = np.empty(rows.stride, np.int32)
        for part in self._row_parts(rows, columns):
            out = self._empty(len(part) * tile * 4)
            self._launch_rows(
                kernels["count_plan_rows"], rows, columns, heights, tops, tops_of_rows, k, part,
                *shared, out,
            )  # fmt: skip
            cl.enqueue_copy(self.queue, counts[part.start * tile : part.stop * tile], out)

        indices, mass = [], []
        for part in self._row_parts(rows, columns, counts):
            in_part = slice(part.start * tile, part.stop * tile)
            ends = np.cumsum(counts[in_part], dtype=np.int64)
            kept = int(ends[-1])
            column_buffer, exponent_buffer = self._empty(4 * kept), self._empty(4 * kept)
            self._launch_rows(
                kernels["fill_plan_rows"], rows, columns, heights, tops, tops_of_rows, k, part,
                *shared, self._constant(ends - counts[in_part], np.uint32),
                column_buffer, exponent_buffer,
            )  # fmt: skip
            found = np.empty(kept, np.int32)
            exponents = np.empty(kept, np.float32)
            if kept:
                cl.enqueue_copy(self.queue, found, column_buffer)
                cl.enqueue_copy(self.queue, exponents, exponent_buffer)
            in_cloud = slice(part.start * tile, min(n, part.stop * tile))
            base = np.repeat(bases[in_cloud], counts[in_cloud])
            indices.append(columns.order[found].astype(np.int32))
            mass.append(np.exp2(base + exponents))
        return _unsort_rows(
            rows, len(columns), counts[:n], np.concatenate(indices), np.concatenate(mass)
        )

    def _log_sum_exp(
        self, rows: Cloud, columns: Cloud, potential: Float64, epsilon: float
    ) -> tuple[Float64, Float64]:
        """Log2 maximum (all constants of the row added) and sum of every sorted row."""
        kernel = self._row_kernels(rows)["log_sum_exp"]
        k = LOG2_E / epsilon
        heights, tops = self._column_heights(columns, potential, k)
        tops_of_rows = self._row_tops(rows, columns, tops, k)
        shares = self._column_shares(rows, columns)
        per_share = -(-len(columns.centers) // shares)
        tile = self.knobs.tile
        maxima, sums = np.empty(rows.stride), np.empty(rows.stride)
        for part in self._row_parts(rows, columns):
            n_rows = len(part) * tile
            out = np.empty((2, shares, n_rows), np.float32)
            buffers = self._empty(out.nbytes // 2), self._empty(out.nbytes // 2)
            self._launch_rows(
                kernel, rows, columns, heights, tops, tops_of_rows, k, part,
                np.uint32(n_rows), np.uint32(per_share), *buffers, shares=shares,
            )  # fmt: skip
            for values, buffer in zip(out, buffers, strict=True):
                cl.enqueue_copy(self.queue, values, buffer)
            m = out[0].max(axis=0).astype(float)
            section = slice(part.start * tile, part.stop * tile)
            maxima[section] = m
            sums[section] = np.sum(out[1] * np.exp2(out[0] - m), axis=0)
        n = len(rows)
        offsets = np.repeat(tops_of_rows, tile)[:n] - k * rows.half_squares
        return maxima[:n] + offsets, sums[:n]

    def _column_heights(
        self, columns: Cloud, potential: Float64, k: float
    ) -> tuple[cl.Buffer, Float64]:
        """Split k g + log2 b into the largest of each tile (float64) and the rest (device)."""
        values = _pad(
            potential[columns.order] * k + columns.log2_weights, columns.stride, SENTINEL
        ).reshape(-1, self.knobs.tile)
        values[values < 0.5 * SENTINEL] = SENTINEL
        tops = values.max(axis=1)
        heights = np.where(values == SENTINEL, SENTINEL, values - tops[:, None])
        return self._constant(heights), tops

    def _row_tops(self, rows: Cloud, columns: Cloud, tops: Float64, k: float) -> Float64:
        """Largest level of each row tile: what its rows are measured from."""
        result = np.empty(len(rows.centers))
        step = max(1, (1 << 22) // len(tops))
        for first in range(0, len(result), step):
            block = slice(first, first + step)
            result[block] = _levels(rows.centers[block], columns.centers, tops, k).max(axis=1)
        return result

    def _column_shares(self, rows: Cloud, columns: Cloud) -> int:
        """Work-groups along the columns: more than one where the rows alone are too few."""
        if self.knobs.width > 1:
            return 1
        groups = max(1, rows.stride // self.knobs.group)
        wanted = -(-8 * self.device.max_compute_units // groups)
        return max(1, min(wanted, len(columns.centers), 64))

    def _row_parts(
        self, rows: Cloud, columns: Cloud, counts: NDArray[np.int32] | None = None
    ) -> Iterator[range]:
        """Split the row tiles so that no launch runs long, nor writes too much."""
        n_tiles = len(rows.centers)
        kept = None
        if counts is not None:
            kept = counts.reshape(n_tiles, -1).sum(axis=1, dtype=np.int64).cumsum()
        first = 0
        while first < n_tiles:
            tiles = self._budget.pairs() // (self.knobs.tile * columns.stride)
            stop = min(n_tiles, first + max(1, int(tiles)))
            if kept is not None:
                before = kept[first - 1] if first else 0
                stop = min(stop, int(np.searchsorted(kept, before + FILL_PAIRS, side="right")))
                stop = max(stop, first + 1)
            yield range(first, stop)
            first = stop

    def _launch_rows(
        self,
        kernel: cl.Kernel,
        rows: Cloud,
        columns: Cloud,
        heights: cl.Buffer,
        tops: Float64,
        tops_of_rows: Float64,
        k: float,
        part: range,
        *arguments: Any,
        shares: int = 1,
    ) -> None:
        """Run a kernel of ``rows.cl`` over some row tiles and wait for it."""
        section = slice(part.start, part.stop)
        levels = _levels(rows.centers[section], columns.centers, tops, k)
        levels -= tops_of_rows[section, None]
        n_rows = len(part) * self.knobs.tile
        with self._budget.measure(n_rows * columns.stride):
            launch(
                self.queue, kernel, (n_rows // self.knobs.width, shares), (self.knobs.group, 1),
                np.uint32(part.start * self.knobs.tile), np.uint32(rows.stride),
                np.uint32(columns.stride), np.uint32(len(columns.centers)), np.float32(k),
                rows.offsets_buffer, rows.centers_buffer, columns.offsets_buffer,
                columns.centers_buffer, heights, self._constant(np.maximum(levels, SENTINEL)),
                *arguments,
            )  # fmt: skip

    def _row_kernels(self, rows: Cloud) -> dict[str, cl.Kernel]:
        dimension = rows.centers.shape[1]
        if dimension not in self._kernels:
            built = program.build(self.context, "rows.cl", self.knobs.rows_constants(dimension))
            names = ("log_sum_exp", "count_plan_rows", "fill_plan_rows")
            self._kernels[dimension] = {name: cl.Kernel(built, name) for name in names}
        return self._kernels[dimension]

    # --- particles -----------------------------------------------------------------

    @_operation
    def upload_particles(
        self,
        table: Float64,
        links: NDArray[np.uint32],
        weights: Float64,
    ) -> ParticleSet:
        """Take moving particles."""
        return self._splats().upload_particles(table, links, weights)

    @_operation
    def place(
        self,
        particles: ParticleSet,
        t: float,
        scale: tuple[float, float],
        center: tuple[float, float],
    ) -> Splats:
        """Move particles to time t and onto a canvas."""
        return self._splats().place(particles, t, scale, center)

    @_operation
    def upload_splats(self, positions: Float32, colors: Float32, weights: Float32) -> Splats:
        """Take resting particles."""
        return self._splats().upload_splats(positions, colors, weights)

    @_operation
    def bin_splats(self, splats: Splats, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins."""
        return self._splats().bin_splats(splats, shape, margin)

    @_operation
    def splat(
        self, splats: Splats, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a Nadaraya-Watson frame."""
        return self._splats().splat(splats, shape, sigma, radius)

    def _splats(self) -> Splatting:
        if self._splatting is None:
            self._splatting = Splatting(self.context, self.queue, self.knobs)
        return self._splatting

    # --- memory --------------------------------------------------------------------

    def _constant(self, values: NDArray[Any], dtype: Any = np.float32) -> cl.Buffer:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, dtype))

    def _empty(self, n_bytes: int) -> cl.Buffer:
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, max(4, n_bytes))


def _levels(row_centers: Float64, column_centers: Float64, tops: Float64, k: float) -> Float64:
    """Log2-kernel between tile centers with the columns' largest heights: (rows, columns)."""
    result = np.empty((len(row_centers), len(column_centers)))
    result[:] = tops
    for d in range(row_centers.shape[1]):
        result -= 0.5 * k * (row_centers[:, d, None] - column_centers[:, d]) ** 2
    return result


def _pad(values: Float64, length: int, filler: float) -> Float64:
    return np.concatenate((values, np.full(length - len(values), filler)))


def _log2_threshold(values: Float64) -> Float64:
    """Convert nats to base 2, and infinities to what float32 arithmetic survives."""
    return np.clip(np.asarray(values, float) * LOG2_E, 0.25 * SENTINEL, -SENTINEL)


def _unsort(cloud: Cloud, values: Float64) -> Float64:
    result = np.empty_like(values)
    result[cloud.order] = values
    return result


def _unsort_rows(
    rows: Cloud,
    n_columns: int,
    counts: NDArray[np.int32],
    indices: NDArray[np.int32],
    mass: Float64,
) -> PlanRows:
    """Bring plan rows, and the columns inside each, back to the caller's order."""
    from scipy.sparse import csr_array

    indptr = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
    plan = csr_array((mass, indices, indptr), shape=(len(rows), n_columns))
    inverse = np.empty_like(rows.order)
    inverse[rows.order] = np.arange(len(rows))
    plan = plan[inverse]
    plan.sort_indices()
    return PlanRows(plan.indptr.astype(np.int64), plan.indices.astype(np.int32), plan.data)
