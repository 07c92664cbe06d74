"""Select the operations for the value of ``backend=`` that a user gives."""

import os
from collections.abc import Sequence
from functools import cache
from typing import Any, Protocol, cast

from clmorph._shared.validation import shown
from clmorph.backends.arrays import is_of_pyopencl
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.devices.process import Once
from clmorph.backends.opencl.devices.verdicts import refusals
from clmorph.errors import InputError


class OpenCLObject(Protocol):
    """A `pyopencl.Device`, `pyopencl.Context` or `pyopencl.CommandQueue`."""

    @property
    def int_ptr(self) -> int:
        """The address of OpenCL's object."""


#: The type of `backend`, see `get_backend`.
Single = str | Operations | OpenCLObject
Backend = Single | Sequence[Single]


def get_backend(backend: Backend = "auto") -> Operations:
    """Return the operations of the backend with a given name.

    Parameters
    ----------
    backend : str, Operations, pyopencl.Device, Context or CommandQueue, or list of them
        "auto": the device that ``CLMORPH_DEVICE`` names, else the one that ``PYOPENCL_CTX`` names,
        else the first usable OpenCL device (GPUs first). "opencl": the same without
        ``CLMORPH_DEVICE``. "numpy": no device, float64. An index such as "0:1" or part of a
        device's or platform's name ("pocl", "intel", "nvidia"). An object with the
        operations is returned as it is. A device, a context of one device, or a queue of a host
        program: all work runs in that context and queue, and the same object gives the same
        operations again. A list such as ["0:0", "0:1"] or ["intel", "numpy"], or
        such names joined by commas ("0:0,0:1", also in ``CLMORPH_DEVICE``): these devices share
        the frames of a morph and the problems of a batch in proportion to their speeds; a single
        solve uses the first.

    Raises
    ------
    InputError
        If `backend` is neither a text nor such an object, nor a list of these; if a context has
        several devices; if a list is empty, holds another list, or names a device twice.
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
    if isinstance(backend, list | tuple):
        return _several(backend)
    if is_of_pyopencl(backend):
        from clmorph.backends.opencl.host_program import operations_in

        return cast(Operations, operations_in(backend))
    if not isinstance(backend, str):
        if hasattr(backend, "softmin") and not isinstance(backend, type):
            return cast(Operations, backend)
        raise InputError(
            f"backend={shown(backend)}: expected 'auto', 'numpy', 'opencl', a device's name or "
            "index, a pyopencl Device, Context or CommandQueue, a backend object, or a list of "
            "these"
        )
    name = backend.strip() or "auto"
    if name == "auto":
        name = os.environ.get("CLMORPH_DEVICE", "").strip() or "auto"
        if "," in name:
            # The names in the variable do not refer to the variable again.
            names = [part.strip() for part in name.split(",")]
            return _several(["opencl" if part == "auto" else part for part in names])
    if "," in name:
        return _several(name.split(","))
    if name == "numpy":
        return _numpy()
    return _named_backend(name, os.environ.get("PYOPENCL_CTX", ""), refusals())


def _several(given: Sequence[Any]) -> Operations:
    """Return the operations on several devices, each of them as `get_backend` takes it."""
    from clmorph.backends.multi_device import open_several

    for one in given:
        if isinstance(one, list | tuple) or (isinstance(one, str) and "," in one):
            raise InputError(f"backend: expected one device for each entry, not {shown(one)}")
        if isinstance(one, str) and not one.strip():
            names = shown(",".join(map(str, given)))
            raise InputError(
                f"a device's name is missing in {names}: expected a name for each device, such as "
                "'0:0,0:1'"
            )
    return open_several([get_backend(one) for one in given], given)


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

    handle = choose_device(name).handle
    from clmorph.backends.opencl.host_program import opened

    return cast(Operations, opened(handle))
