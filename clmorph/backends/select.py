"""Select the operations for the value of ``backend=`` that a user gives."""

import os
from functools import cache
from typing import Any

from clmorph._shared.validation import shown
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.devices.process import Once
from clmorph.backends.opencl.devices.verdicts import refusals
from clmorph.errors import InputError

#: The type of `backend`, see `get_backend`.
Backend = str | Operations


def get_backend(backend: Backend = "auto") -> Operations:
    """Return the operations of the backend with a given name.

    Parameters
    ----------
    backend : str or Operations
        "auto": the device that ``CLMORPH_DEVICE`` names, else the one that ``PYOPENCL_CTX`` names,
        else the first usable OpenCL device (GPUs first). "opencl": the same without
        ``CLMORPH_DEVICE``. "numpy": no device, float64. An index such as "0:1" or part of a
        device's or platform's name ("pocl", "intel", "nvidia"). An object with the
        operations is returned as it is.

    Raises
    ------
    InputError
        If `backend` is neither a text nor such an object.
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
    if not isinstance(backend, str):
        if hasattr(backend, "softmin") and not isinstance(backend, type):
            return backend
        raise InputError(
            f"backend={shown(backend)}: expected 'auto', 'numpy', 'opencl', a device's name or "
            "index, or a backend object"
        )
    name = backend.strip() or "auto"
    if name == "auto":
        name = os.environ.get("CLMORPH_DEVICE", "").strip() or "auto"
    if name == "numpy":
        return _numpy()
    return _named_backend(name, os.environ.get("PYOPENCL_CTX", ""), refusals())


# Backends are imported where they are used, so that the package needs no driver.


@cache
def _numpy() -> Operations:
    from clmorph.backends.numpy import NumPyOperations

    return NumPyOperations()


@Once
def _named_backend(name: str, pyopencl_ctx: str, refusals: int) -> Operations:
    # The last two are part of the cache's key: choose_device reads pyopencl_ctx for "auto", and
    # chooses anew after a device was refused.
    from clmorph.backends.opencl.devices.find import choose_device

    return _opened(choose_device(name).handle)


@Once
def _opened(handle: Any) -> Operations:
    """Return the operations on a `pyopencl.Device`, the same object for each name of the device."""
    from clmorph.backends.opencl.backend import OpenCLOperations

    return OpenCLOperations(handle)
