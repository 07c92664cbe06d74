"""The operations of `clmorph.backends.interface.Operations` on an OpenCL device."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import pyopencl as cl

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.build.constants import BuildConstants
from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.build.tuned_record import tuned_constants
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.devices.process import claim_opencl, device_lock
from clmorph.backends.opencl.devices.quirks import shares_host_memory
from clmorph.backends.opencl.devices.verdicts import probed_speed
from clmorph.backends.opencl.kernels.batches import BatchStore
from clmorph.backends.opencl.kernels.clouds import CloudStore
from clmorph.backends.opencl.kernels.color_table import ColorTable
from clmorph.backends.opencl.kernels.grid_log_sum_exp import GridLogSumExp
from clmorph.backends.opencl.kernels.half_steps import HalfSteps
from clmorph.backends.opencl.kernels.launches import Workspace
from clmorph.backends.opencl.kernels.layers import Layers
from clmorph.backends.opencl.kernels.log_sum_exp import LogSumExp
from clmorph.backends.opencl.kernels.near_field import NearField
from clmorph.backends.opencl.kernels.nearest_seeds import NearestSeeds
from clmorph.backends.opencl.kernels.plan_rows import PlanRowReductions
from clmorph.backends.opencl.kernels.plan_shares import PlanShares
from clmorph.backends.opencl.kernels.rounding_bounds import MAX_DEVICE_SPREAD
from clmorph.backends.opencl.kernels.row_loop import RowLoop
from clmorph.backends.opencl.kernels.sliced_ellpack import SlicedEllpack
from clmorph.backends.opencl.kernels.sparse_half_steps import StoredSteps
from clmorph.backends.opencl.kernels.splat import Splatting
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.backends.speed import speed_factor
from clmorph.errors import DeviceError

P = ParamSpec("P")
T = TypeVar("T")
#: The names of all operations.
OPERATIONS = frozenset(name for name in vars(Operations) if not name.startswith("_"))


class OpenCLOperations:
    """Operations on one device, in a context of its own or in a `queue`; threads take turns."""

    def __init__(
        self,
        device: cl.Device,
        constants: BuildConstants | None = None,
        verify: bool = True,
        queue: cl.CommandQueue | None = None,
        profiled: bool = False,
    ) -> None:
        claim_opencl()
        self.device = device
        self.lock = device_lock()
        self.constants = constants or tuned_constants(device)
        self.bin_size = self.constants.bin
        self.sum_roundoff = self.exponent_roundoff = 2.0**-24
        self.precise_roundoff = 2.0**-46  # inputs are pairs of float32
        self.has_float64 = bool(self.constants.float64)
        self.max_spread = MAX_DEVICE_SPREAD[self.constants.precise]
        self.memory_bytes: int | None = int(device.global_mem_size)
        self.shares_host_memory = shares_host_memory(device)
        self.on_processor = bool(device.type & cl.device_type.CPU)
        self.pairs_per_second = probed_speed(device)
        self.description = (
            f"{' '.join(device.name.split())} "
            f"({device.platform.name.strip()}, driver {device.driver_version.strip()})"
        )
        with self.lock:
            try:
                # A queue of Intel's runtime does not retain its context, so this object does.
                self.context = cl.Context([device]) if queue is None else queue.context
                # PoCL 3.1 gives a context of a sub-device a queue on the whole device by default.
                profiling = cl.command_queue_properties.PROFILING_ENABLE if profiled else 0
                self.queue = queue or cl.CommandQueue(self.context, device, profiling)
            except cl.Error as error:
                raise DeviceError(
                    f"{self.description} cannot be opened: {error}; "
                    "choose another device with --device or CLMORPH_DEVICE"
                ) from error
            self.work = Workspace(self.context, self.queue)
        check_here = functools.partial(_check_here, device, self.constants) if verify else None
        self.programs = Programs(
            self.context, device, self.constants, check_here, chosen=constants is None
        )
        self._bind()

    def _bind(self) -> None:
        """Create the parts, and make their methods the operations of this object."""
        take_turns, shared = self._take_turns, (self.work, self.constants, self.programs)
        factor = speed_factor(self.on_processor, self.pairs_per_second)
        loop = self.row_loop = RowLoop(*shared)
        log_sum_exp, plan_rows = LogSumExp(loop), PlanRowReductions(loop)
        self.plan_row_reductions, self.splatting = plan_rows, Splatting(*shared)
        self.stored_steps = StoredSteps(loop, take_turns)
        parts = (
            log_sum_exp, plan_rows, self.splatting, self.stored_steps, BatchStore(loop),
            NearField(loop, log_sum_exp), PlanShares(loop),
            SlicedEllpack(loop, plan_rows), HalfSteps(loop, take_turns, factor), Layers(*shared),
            NearestSeeds(*shared), ColorTable(self.work, self.programs), GridLogSumExp(*shared),
        )  # fmt: skip
        for part in parts:
            for name in OPERATIONS.intersection(vars(type(part))):
                setattr(self, name, take_turns(getattr(part, name)))
        # It takes turns by itself, when the points are sorted.
        self.upload = CloudStore(self.work, self.constants, take_turns).upload

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return an operation, see `_bind`."""

    def _take_turns(self, method: Callable[P, T]) -> Callable[P, T]:
        """Run one operation at a time on a device, and report failures as errors of clmorph."""
        # A kernel stores its arguments until it is launched: threads must not share it meanwhile.
        # The closure does not refer to `self`: such a cycle would have to wait for the garbage
        # collector.
        lock, description = self.lock, self.description

        @functools.wraps(method)
        def run(*arguments: P.args, **options: P.kwargs) -> T:
            claim_opencl()
            with lock:
                try:
                    return method(*arguments, **options)
                except (cl.Error, MemoryError) as error:
                    reason = " ".join(str(error).split()) or type(error).__name__
                    raise DeviceError(
                        f"{description} failed in {method.__name__} ({reason}); use "
                        "smaller images or a smaller blur if memory ran out, or another device"
                    ) from error

        return run

    def __repr__(self) -> str:
        return f"<OpenCLOperations on {self.description}>"


def _check_here(device: cl.Device, constants: BuildConstants, variant: Variant) -> str:
    """Return what is wrong with a program, checked in this process; '' if nothing is."""
    return first_failure(OpenCLOperations(device, constants, verify=False), variant)
