"""Arrays in the memory of a device, of a host program or for results: mapped, and not copied."""

import contextlib
import os
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
from numpy.typing import DTypeLike, NDArray

from clmorph._shared.printable import reason_of
from clmorph._shared.validation import shown
from clmorph.backends.opencl.devices.process import claim_opencl, device_lock
from clmorph.backends.opencl.devices.quirks import has_float64, shares_host_memory
from clmorph.errors import DeviceError, InputError

_OUT_OF_ORDER = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE


class _Mapping:
    """Mapped bytes of a buffer, which are unmapped when no array refers to them any more."""

    def __init__(self, queue: cl.CommandQueue, data: NDArray[np.uint8]) -> None:
        self._queue, self._data, self._process = queue, data, os.getpid()
        self.__array_interface__ = {
            "version": 3,
            "shape": data.shape,
            "typestr": data.dtype.str,
            "data": (data.ctypes.data, True),  # read-only
        }

    def __del__(self) -> None:
        if os.getpid() != self._process:
            return  # a driver may hang in a forked process
        # The buffer may be written by any queue afterwards, so the end of the unmapping is awaited.
        with contextlib.suppress(cl.Error), device_lock():
            self._data.base.release(self._queue).wait()  # type: ignore[union-attr]


def read_in_place(name: str, value: Any, expected: str) -> NDArray[Any]:
    """Map an array of a host program, read-only, when the work enqueued on it has ended."""
    if not isinstance(value, cl_array.Array):
        raise InputError(
            f"{name} is of pyopencl's type {type(value).__name__}: expected {expected}; "
            "make a pyopencl.array.Array of it"
        )
    if value.queue is None:
        raise InputError(
            f"{name} has no queue, so the work on it that must end first is unknown: give it one "
            "with .with_queue(queue)"
        )
    if value.size == 0:
        return np.empty(value.shape, value.dtype)
    if not isinstance(value.base_data, cl.MemoryObjectHolder):
        raise InputError(
            f"{name} is not in a buffer: expected {expected}, in a pyopencl.Buffer or on the host; "
            ".get() copies it to the host"
        )
    claim_opencl()
    try:
        # The fresh lock keeps the process from ending while this thread is in the driver.
        with device_lock():
            return _mapped(value)
    except (cl.Error, MemoryError) as error:
        raise _failure(f"{name} cannot be mapped", error) from error


def _mapped(array: cl_array.Array) -> NDArray[Any]:
    """Return the elements of an array in mapped memory."""
    queue = array.queue
    reach = [(side - 1) * stride for side, stride in zip(array.shape, array.strides, strict=True)]
    low, high = sum(min(step, 0) for step in reach), sum(max(step, 0) for step in reach)
    before = list(array.events)
    if queue.properties & _OUT_OF_ORDER:
        before.append(cl.enqueue_marker(queue))
    if before:
        # This function also submits what waits on other queues, as a list to wait for would not.
        cl.wait_for_events(before)
    data, event = cl.enqueue_map_buffer(
        queue, array.base_data, cl.map_flags.READ, array.offset + low,
        (high - low + array.dtype.itemsize,), np.dtype(np.uint8), is_blocking=False,
    )  # fmt: skip
    event.wait()
    elements = np.asarray(_Mapping(queue, data))
    return np.ndarray(array.shape, array.dtype, elements, -low, array.strides)


def as_queue(value: Any) -> cl.CommandQueue:
    """Return the queue on which arrays are wanted: itself, or that of operations on a device."""
    queue = value if isinstance(value, cl.CommandQueue) else getattr(value, "queue", None)
    if not isinstance(queue, cl.CommandQueue):
        raise InputError(
            f"queue={shown(value)}: expected a pyopencl.CommandQueue, or the backend of one "
            "OpenCL device (clmorph.get_backend)"
        )
    return queue


def to_device(
    queue: cl.CommandQueue, values: NDArray[Any], dtype: DTypeLike | None = None
) -> cl_array.Array:
    """Return a new array on a device, in C order; its ``events`` hold the end of the writing."""
    claim_opencl()
    dtype = np.dtype(values.dtype if dtype is None else dtype)
    try:
        with device_lock():
            if values.size == 0:
                return cl_array.empty(queue, values.shape, dtype)
            flags = cl.mem_flags.READ_WRITE
            if shares_host_memory(queue.device):
                flags |= cl.mem_flags.ALLOC_HOST_PTR
            buffer = cl.Buffer(queue.context, flags, values.size * dtype.itemsize)
            made = cl_array.Array(queue, values.shape, dtype, data=buffer)
            mapped, event = cl.enqueue_map_buffer(
                queue, buffer, cl.map_flags.WRITE_INVALIDATE_REGION, 0, values.shape, dtype,
                is_blocking=False,
            )  # fmt: skip
            event.wait()
            mapped[...] = values
            made.add_event(mapped.base.release(queue))
            return made
    except (cl.Error, MemoryError) as error:
        raise _failure("an array for a result cannot be made on the device", error) from error


def real_type(queue: cl.CommandQueue, dtype: Any) -> np.dtype[Any]:
    """Return a dtype of real numbers that the device has; None is float64, or else float32."""
    possible = has_float64(queue.device)
    if dtype is None:
        return np.dtype(np.float64 if possible else np.float32)
    try:
        chosen = np.dtype(dtype)
    except Exception:
        # NumPy raises errors of several classes for what names no dtype.
        chosen = np.dtype(object)
    if chosen not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise InputError(f"dtype={shown(dtype)}: expected 'float32', 'float64' or None")
    if chosen.itemsize == 8 and not possible:
        raise InputError("dtype='float64': the device has no double precision; expected 'float32'")
    return chosen


def _failure(what: str, error: BaseException) -> InputError | DeviceError:
    """Return the error for one of pyopencl, by who has caused it."""
    if isinstance(error, cl.LogicError):
        return InputError(
            f"{what} ({reason_of(error)}): expected an array whose memory was not released, with "
            "a queue of the same context"
        )
    return DeviceError(f"{what} ({reason_of(error)}); use smaller arrays if memory ran out")
