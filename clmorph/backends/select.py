"""Select the operations for the value of ``backend=`` that a user gives."""

import os
from functools import cache
from typing import Protocol, cast

from clmorph._shared.validation import shown
from clmorph.backends.arrays import is_of_pyopencl
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.devices.process import Once
from clmorph.errors import InputError


class OpenCLObject(Protocol):
    """A `pyopencl.Device`, `pyopencl.Context` or `pyopencl.CommandQueue`."""

    @property
    def int_ptr(self) -> int:
        """The address of OpenCL's object."""


#: The type of `backend`, see `get_backend`.
Backend = str | Operations | OpenCLObject


def get_backend(backend: Backend = "auto") -> Operations:
    """Return the operations of the backend with a given name.

    Parameters
    ----------
    backend : str, Operations, pyopencl.Device, pyopencl.Context or pyopencl.CommandQueue
        "auto": the device that ``CLMORPH_DEVICE`` names, else the one that ``PYOPENCL_CTX`` names,
        else the best usable OpenCL device (GPUs first, then by speed). "opencl": the same without
        ``CLMORPH_DEVICE``. "numpy": no device, float64. An index such as "0:1" or part of a
        device's or platform's name ("pocl", "intel", "nvidia"). An object with the
        operations is returned as it is. A device, a context of one device, or a queue of a host
        program: all work runs in that context and queue, and the same object gives the same
        operations again.

    Raises
    ------
    InputError
        If `backend` is neither a text nor such an object, or a context of several devices.
    DeviceError
        If there is no such device, if it does not work, or if this process was forked from a
        process that had used OpenCL.

    Examples
    --------
    >>> import clmorph
    >>> operations = clmorph.get_backend("numpy")
    >>> clmorph.get_backend(operations) is operations
    True
    """
    if is_of_pyopencl(backend):
        from clmorph.backends.opencl.host_program import operations_in

        return operations_in(backend)
    if not isinstance(backend, str):
        if hasattr(backend, "softmin") and not isinstance(backend, type):
            return cast(Operations, backend)
        raise InputError(
            f"backend={shown(backend)}: expected 'auto', 'numpy', 'opencl', a device's name or "
            "index, a pyopencl Device, Context or CommandQueue, or a backend object"
        )
    name = backend.strip() or "auto"
    if name == "auto":
        name = os.environ.get("CLMORPH_DEVICE", "").strip() or "auto"
    if name == "numpy":
        return _numpy()
    return _named_backend(name, os.environ.get("PYOPENCL_CTX", ""))


# Backends are imported where they are used, so that the package needs no driver.


@cache
def _numpy() -> Operations:
    from clmorph.backends.numpy import NumPyOperations

    return NumPyOperations()


@Once
def _named_backend(name: str, pyopencl_ctx: str) -> Operations:
    # pyopencl_ctx is part of the cache's key: choose_device reads it for "auto".
    from clmorph.backends.opencl.devices.find import choose_device

    handle = choose_device(name).handle
    from clmorph.backends.opencl.host_program import opened

    return opened(handle)
