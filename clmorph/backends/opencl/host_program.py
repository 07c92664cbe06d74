"""Operations for the devices, contexts and queues of a host program, made once for each of them."""

import sys
import threading
import weakref
from dataclasses import dataclass
from typing import Any

import pyopencl as cl

from clmorph._shared.validation import shown
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import raw_devices, tried
from clmorph.backends.opencl.devices.process import Once, claim_opencl
from clmorph.errors import DeviceError, InputError


@Once
def opened(device: cl.Device) -> OpenCLOperations:
    """Return the operations on a device, in a context of their own, always the same."""
    return OpenCLOperations(device)


def operations_in(given: Any) -> OpenCLOperations:
    """Return the operations in an object of a host program, the same as long as it is kept."""
    claim_opencl()
    if not isinstance(given, cl.Device | cl.Context | cl.CommandQueue):
        raise InputError(
            f"backend={shown(given)}: expected a pyopencl.Device, Context or CommandQueue"
        )
    try:
        return _operations_in(given)
    except cl.Error as error:
        raise InputError(f"backend={shown(given)} cannot be used ({error})") from error


def _operations_in(given: Any) -> OpenCLOperations:
    if isinstance(given, cl.Device) and _parent(given) is None:
        _check_device(given)
        return opened(given)
    key = type(given).__name__, given.int_ptr
    with _lock:
        # Those to which the host program refers no more; new ones may have their addresses.
        _kept[:] = [each for each in _kept if each.references() > _ALONE]
        found = _alive.get(key)
        if found is None:
            found = _alive[key] = _made(given)
            _keep(given, found)
        return found


def _made(given: Any) -> OpenCLOperations:
    """Return new operations, which refer to OpenCL's objects but not to pyopencl's."""
    if isinstance(given, cl.Device):
        _check_device(given)
        # Another object for the same device, so that the operations do not keep the given one.
        return OpenCLOperations(cl.Device.from_int_ptr(given.int_ptr, retain=True))
    if isinstance(given, cl.Context):
        if len(given.devices) != 1:
            raise InputError(
                f"backend is a pyopencl.Context of {len(given.devices)} devices: expected one "
                "device; give a pyopencl.CommandQueue on one of them"
            )
        queue = cl.CommandQueue(given)
    else:
        if given.properties & cl.command_queue_properties.ON_DEVICE:
            raise InputError("backend is a queue on the device itself: expected one on the host")
        queue = cl.CommandQueue.from_int_ptr(given.int_ptr, retain=True)
    _check_device(queue.device)
    return OpenCLOperations(queue.device, queue=queue)


# --- operations live as long as the object that they were made for ----------------------------


@dataclass(frozen=True)
class _Kept:
    """An object that cannot be weakly referenced, such as pyopencl's queues, and its operations."""

    given: Any
    operations: OpenCLOperations | None

    def references(self) -> int:
        return sys.getrefcount(self.given)


#: The references that are counted if a `_Kept` alone refers to its object.
_ALONE = _Kept(object(), None).references()
_kept: list[_Kept] = []
#: Operations by class and address of OpenCL's object, which they retain: no other one can have the
#: address while they live.
_alive: "weakref.WeakValueDictionary[tuple[str, int], OpenCLOperations]" = (
    weakref.WeakValueDictionary()
)
_lock = threading.RLock()


def _keep(given: Any, operations: OpenCLOperations) -> None:
    """Keep operations until the object that they were made for is gone."""
    try:
        # The call has no effect, but its argument lives until then.
        weakref.finalize(given, id, operations).atexit = False
    except TypeError:
        _kept.append(_Kept(given, operations))


# --- only devices that work ---------------------------------------------------------------------


def _parent(device: cl.Device) -> cl.Device | None:
    """Return the device that a sub-device is a part of; None for a device of a platform."""
    try:
        return device.parent_device or None
    except (cl.Error, AttributeError):  # OpenCL 1.1 has no sub-devices
        return None


def _check_device(device: cl.Device) -> None:
    """Raise a DeviceError if the kernels do not work on a device; the first test takes seconds."""
    while (parent := _parent(device)) is not None:
        device = parent
    for index, handle in raw_devices():
        if handle == device and not (known := tried(index)).usable:
            raise DeviceError(f"{known}; choose another device, or the backend 'numpy'")
