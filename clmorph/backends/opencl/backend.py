"""The operations of `clmorph.backends.interface.Operations` on an OpenCL device."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.interface import Bins, Float32, Float64, NearPairs, PlanRows, StoredPairs
from clmorph.backends.opencl.build.constants import Knobs
from clmorph.backends.opencl.build.tuned_record import tuned_knobs
from clmorph.backends.opencl.devices.process import claim_opencl, device_lock
from clmorph.backends.opencl.kernels.clouds import Cloud
from clmorph.backends.opencl.kernels.launches import Workspace
from clmorph.backends.opencl.kernels.particles import ParticleSet, Splats
from clmorph.backends.opencl.kernels.sliced_ellpack import StoredReductions
from clmorph.backends.opencl.kernels.splat import Splatting
from clmorph.errors import DeviceError

P = ParamSpec("P")
T = TypeVar("T")


def _operation(method: Callable[P, T]) -> Callable[P, T]:
    """Run one operation at a time on a device, and tell its failures in our words.

    Kernels keep their arguments between being set and being launched, so two threads must
    not share one.
    """

    @functools.wraps(method)
    def run(*arguments: P.args, **options: P.kwargs) -> T:
        operations = cast("OpenCLOperations", arguments[0])
        claim_opencl()
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
        Build-time constants; if not given, as tuned, else by the kind of device.
    """

    def __init__(self, device: cl.Device, knobs: Knobs | None = None) -> None:
        claim_opencl()
        self.device = device
        self.lock = device_lock()
        self.knobs = knobs or tuned_knobs(device)
        self.bin_size = self.knobs.bin
        self.sum_roundoff = self.exponent_roundoff = 2.0**-24
        self.precise_roundoff = 2.0**-46  # inputs are pairs of float32
        self.has_float64 = self.knobs.precise == 2
        self.memory_bytes: int | None = int(device.global_mem_size)
        # OpenCL 2.0 deprecates the property, and a driver may lack it.
        self.shares_host_memory = bool(getattr(device, "host_unified_memory", False))
        self.description = (
            f"{' '.join(device.name.split())} "
            f"({device.platform.name.strip()}, driver {device.driver_version.strip()})"
        )
        with self.lock:
            try:
                self.context = cl.Context([device])
                self.queue = cl.CommandQueue(self.context)
            except cl.Error as error:
                raise DeviceError(
                    f"{self.description} cannot be opened: {error}; "
                    "choose another device with --device or CLMORPH_DEVICE"
                ) from error
            self.work = Workspace(self.context, self.queue)
            self.reductions = StoredReductions(self.work, self.knobs)

    @functools.cached_property
    def splatting(self) -> Splatting:
        """The splatting half; its kernels are built when first needed."""
        return Splatting(self.work, self.knobs)

    def __repr__(self) -> str:
        return f"<OpenCLOperations on {self.description}>"

    # --- clouds and row reductions

    @_operation
    def upload(self, points: Float64, weights: Float64, offsets: Float64 | None = None) -> Cloud:
        """Take a weighted cloud."""
        return self.reductions.upload(points, weights, offsets)

    @_operation
    def softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return -epsilon log sum_j b_j exp((g_j - C_ij) / epsilon)."""
        return self.reductions.softmin(rows, columns, potential, epsilon, precise, near)

    @_operation
    def bounded_softmin(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> tuple[Float64, float]:
        """Return T(g), far more exact than float32, and by how many nats it may be off."""
        return self.reductions.bounded_softmin(rows, columns, potential, epsilon, near)

    @_operation
    def near_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        softmin: Float64,
        epsilon: float,
        budget: float,
    ) -> NearPairs:
        """Find the pairs that matter for the rows' sums."""
        return self.reductions.near_pairs(rows, columns, potential, softmin, epsilon, budget)

    @_operation
    def row_maxima(
        self,
        rows: Cloud,
        columns: Cloud,
        potential: Float64,
        epsilon: float,
        near: NearPairs | None = None,
    ) -> Float64:
        """Return max_j [(g_j - C_ij) / epsilon + log b_j], in nats."""
        return self.reductions.row_maxima(rows, columns, potential, epsilon, near)

    @_operation
    def count_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        precise: bool = False,
    ) -> NDArray[np.int64]:
        """Return how many pairs of each row `plan_rows` keeps."""
        return self.reductions.count_plan_rows(
            rows, columns, f, g, epsilon, row_thresholds, column_thresholds, precise
        )

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
        precise: bool = False,
        counts: NDArray[np.int64] | None = None,
    ) -> PlanRows:
        """Return the pairs of the plan (Eq. 2) above a threshold."""
        return self.reductions.plan_rows(
            rows, columns, f, g, epsilon, row_thresholds, column_thresholds, precise, counts
        )

    @_operation
    def store_pairs(
        self,
        rows: Cloud,
        columns: Cloud,
        f: Float64,
        g: Float64,
        epsilon: float,
        row_thresholds: Float64,
        column_thresholds: Float64,
        max_pairs: int,
        near: tuple[NearPairs | None, NearPairs | None] = (None, None),
    ) -> StoredPairs | None:
        """Keep log pi_ij of pairs, for `sum_stored`."""
        return self.reductions.store_pairs(
            rows, columns, f, g, epsilon, row_thresholds, column_thresholds, max_pairs, near
        )

    @_operation
    def sum_stored(self, stored: StoredPairs, changes: Float64, by_column: bool) -> Float64:
        """Return log sum_j pi_ij exp(changes_j) over the pairs of every row, or column."""
        return self.reductions.sum_stored(stored, changes, by_column)

    @_operation
    def plan_moments(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> tuple[Float64, Float64]:
        """Return mean and covariance of each row's destinations."""
        return self.reductions.plan_moments(rows, columns, g, softmin, epsilon, precise, near)

    @_operation
    def sample_plan_rows(
        self,
        rows: Cloud,
        columns: Cloud,
        g: Float64,
        softmin: Float64,
        epsilon: float,
        thresholds: Float64,
        precise: bool = False,
        near: NearPairs | None = None,
    ) -> NDArray[np.int32]:
        """Return columns drawn from each plan row."""
        return self.reductions.sample_plan_rows(
            rows, columns, g, softmin, epsilon, thresholds, precise, near
        )

    # --- particles -----------------------------------------------------------------

    @_operation
    def upload_particles(
        self,
        table: Float64,
        links: NDArray[np.uint32],
        weights: Float64,
    ) -> ParticleSet:
        """Take moving particles."""
        return self.splatting.upload_particles(table, links, weights)

    @_operation
    def place(
        self,
        particles: ParticleSet,
        t: float,
        scale: tuple[float, float],
        center: tuple[float, float],
    ) -> Splats:
        """Move particles to time t and onto a canvas."""
        return self.splatting.place(particles, t, scale, center)

    @_operation
    def upload_splats(
        self,
        positions: Float32,
        colors: Float32,
        weights: Float32,
        spacings: Float32 | None = None,
    ) -> Splats:
        """Take resting particles."""
        return self.splatting.upload_splats(positions, colors, weights, spacings)

    @_operation
    def deposit(self, splats: Splats, shape: tuple[int, int]) -> tuple[Float64, Float64]:
        """Return what lies nearest to each pixel: sum of masses and of their squares."""
        return self.splatting.deposit(splats, shape)

    @_operation
    def adapt_widths(self, splats: Splats, distances: Float64, sigma: float) -> Splats:
        """Give every splat a width of its own."""
        return self.splatting.adapt_widths(splats, distances, sigma)

    @_operation
    def rungs(self, splats: Splats) -> NDArray[np.int64]:
        """Return on which rung each splat stands."""
        return self.splatting.rungs(splats)

    @_operation
    def bin_splats(self, splats: Splats, shape: tuple[int, int], margin: int) -> Bins:
        """Sort splats into bins."""
        return self.splatting.bin_splats(splats, shape, margin)

    @_operation
    def splat(
        self, splats: Splats, shape: tuple[int, int], sigma: float, radius: float
    ) -> tuple[Float64, Float64]:
        """Return the two sums of a Nadaraya-Watson frame."""
        return self.splatting.splat(splats, shape, sigma, radius)
