"""OpenCL platforms: the loader's, and those of runtimes that were installed with pip.

Intel's wheel leaves a placeholder path in its registration file, so no loader detects the runtime,
and loaders take further entries only from environment variables, which every thread and child would
see. So this module queries the runtime for its platforms as a loader does (extension cl_khr_icd).
Any loader forwards calls by a table in the objects themselves, and needs no list of them.
"""

import ctypes
import os
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from clmorph._shared.signals import undisturbed
from clmorph._shared.validation import shown
from clmorph.errors import DeviceError

if TYPE_CHECKING:
    import pyopencl as cl

#: The first entry of the table of a driver that follows cl_khr_icd 2.0. Calls to such a driver fail
#: unless a loader of the same version has initialized it.
_MANAGED_BY_LOADER = 0x4F50454E434C3331


def is_uncached() -> bool:
    """Return what ``PYOPENCL_NO_CACHE`` says; pyopencl cannot be imported with other values."""
    value = os.environ.get("PYOPENCL_NO_CACHE", "0")
    if value.lower() in ("y", "yes", "t", "true", "on", "1"):
        return True
    if value.lower() in ("n", "no", "f", "false", "off", "0"):
        return False
    raise DeviceError(
        f"PYOPENCL_NO_CACHE={shown(value)}: pyopencl expects a truth value; set it to 1 or 0, or "
        "unset it"
    )


def intel_runtime() -> Path | None:
    """Return the library of the wheel `intel-opencl-rt`; None without it or its math library."""
    try:
        files = metadata.distribution("intel-opencl-rt").files or []
    except metadata.PackageNotFoundError:
        return None
    for file in files:
        if file.name == "libintelocl.so":
            library = Path(str(file.locate())).resolve()
            # Without libsvml the runtime cannot even be loaded.
            if library.exists() and (library.parent / "libsvml.so").exists():
                return library
    return None


def list_platforms() -> list["cl.Platform"]:
    """List the loader's platforms and, without ``OCL_ICD_VENDORS``, those of pip's runtimes."""
    is_uncached()
    with undisturbed():  # an exception from a signal handler during the call aborts the process
        import pyopencl as cl

    try:
        found = list(cl.get_platforms())
    except cl.Error:  # some loaders report an error if there is no platform
        found = []
    library = intel_runtime() if sys.platform == "linux" else None
    if library is not None and "OCL_ICD_VENDORS" not in os.environ:
        known = {platform.int_ptr for platform in found}
        found += [
            cl.Platform.from_int_ptr(pointer, False)
            for pointer in _platforms_of(library)
            if pointer not in known
        ]
    return found


def _platforms_of(library: Path) -> list[int]:
    """Return pointers to the platforms of a driver; empty if it cannot be loaded."""
    try:
        driver = ctypes.CDLL(str(library))
        find = driver.clGetExtensionFunctionAddress
    except (OSError, AttributeError):
        return []
    find.restype, find.argtypes = ctypes.c_void_p, (ctypes.c_char_p,)
    address = find(b"clIcdGetPlatformIDsKHR")
    if not address:
        return []
    number = ctypes.c_uint32
    ask = ctypes.CFUNCTYPE(
        ctypes.c_int32, number, ctypes.POINTER(ctypes.c_void_p), ctypes.POINTER(number)
    )(address)
    count = number()
    if ask(0, None, ctypes.byref(count)):
        return []
    pointers = (ctypes.c_void_p * count.value)()
    if ask(count, pointers, None):
        return []
    return [pointer for pointer in pointers if pointer and not _needs_its_loader(pointer)]


def _needs_its_loader(platform: int) -> bool:
    table = ctypes.c_void_p.from_address(platform).value
    return table is None or ctypes.c_size_t.from_address(table).value == _MANAGED_BY_LOADER
