"""Load, expand and build the kernel sources."""

import functools
import hashlib
import os
import pickle
import re
import sqlite3
import warnings
from importlib import resources
from pathlib import Path

import platformdirs
import pyopencl as cl

from clmorph.backends.opencl.devices.cache import read_cached, write_cached
from clmorph.backends.opencl.devices.verdicts import cpu_identity
from clmorph.errors import DeviceError

_INCLUDE = re.compile(r'^#include "([a-z_]+\.cl)"$', re.MULTILINE)


@functools.cache
def source(name: str) -> str:
    """Return a kernel file with its includes expanded.

    Drivers cache by the text they are given and miss changes of included files, so the
    text that they see is complete; ``#line`` keeps their messages pointing at the files.

    Parameters
    ----------
    name : str
        File name inside ``cl_kernels/``.
    """
    text = (resources.files("clmorph.cl_kernels") / name).read_text(encoding="utf-8")

    def expand(match: re.Match[str]) -> str:
        line = text.count("\n", 0, match.start()) + 2
        return f'#line 1 "{match[1]}"\n{source(match[1])}\n#line {line} "{name}"'

    return f'#line 1 "{name}"\n' + _INCLUDE.sub(expand, text)


def build(context: cl.Context, name: str, constants: dict[str, int | float]) -> cl.Program:
    """Build a kernel file for the only device of a context.

    The binary is kept in the user's cache folder, by source, options, device and driver.

    Parameters
    ----------
    context : pyopencl.Context
    name : str
        File name inside ``cl_kernels/``.
    constants : dict
        Macros given with ``-D``; a float becomes a float32 literal.

    Raises
    ------
    DeviceError
        If the device's compiler refuses the source; the message holds its first error.
    """
    options = ["-cl-std=CL1.2"]
    for key, value in sorted(constants.items()):
        text = f"{value:.9g}f" if isinstance(value, float) else str(value)
        options.append(f"-D{key}={text}")
    device = context.devices[0]
    file = _binary_file(device, name, options)
    program = _from_binary(context, file, options)
    if program is None:
        program = _from_source(context, name, options)
        _keep_binary(program, file)
    return cl.Program(program)


def kernel(program: cl.Program, name: str) -> cl.Kernel:
    """Return a kernel of a program, whatever the state of pyopencl's cache.

    pyopencl generates some Python for each kernel and keeps it in a database of its own. It
    fails where that cannot be written or is damaged, and there it has to do without.

    Parameters
    ----------
    program : pyopencl.Program
        Built.
    name : str
    """
    _check_pyopencl_cache()
    try:
        return cl.Kernel(program, name)
    except (OSError, ValueError, TypeError, EOFError, sqlite3.Error, pickle.UnpicklingError):
        if cl._PYOPENCL_NO_CACHE:
            raise
        cl._PYOPENCL_NO_CACHE = True
        return cl.Kernel(program, name)


@functools.cache
def _check_pyopencl_cache() -> None:
    """Turn pyopencl's cache off if there is no folder for it: it fails with some noise."""
    folder = Path(platformdirs.user_cache_dir("pytools", "pytools"))
    try:
        if folder.is_absolute():  # or it would be made wherever we happen to be
            folder.mkdir(parents=True, exist_ok=True)
            return
    except OSError:
        pass
    cl._PYOPENCL_NO_CACHE = True


def _from_source(context: cl.Context, name: str, options: list[str]) -> "cl._Program":
    device = context.devices[0]
    program = cl._Program(context, source(name))
    try:
        _build(program, options)
    except cl.Error as error:
        lines = [line.strip() for line in f"{_log(program, device)}\n{error}".splitlines()]
        lines = [line for line in lines if line]
        reason = next((line for line in lines if "error" in line.lower()), lines[0])
        raise DeviceError(
            f"{device.name.strip()} cannot build {name}: {reason}; "
            "update its driver, or choose another device with --device or CLMORPH_DEVICE"
        ) from error
    complaints = [line.strip() for line in _log(program, device).splitlines() if "warning:" in line]
    if complaints:
        warnings.warn(f"{device.name.strip()}, {name}: {complaints[0]}", stacklevel=3)
    return program


def _build(program: "cl._Program", options: list[str]) -> None:
    """Build as the driver does, without what `pyopencl.Program.build` adds.

    It warns of every build log, which Intel's compiler writes on success too, and a filter
    of warnings is everybody's; its cache waits a minute for the lock of a process that was
    killed, and a damaged entry of it is an error (see `_from_binary` for ours).
    """
    # What `build` calls, and at worst that itself: the name is pyopencl's own.
    build = getattr(program, "_build", None) or program.build
    build(" ".join(options).encode(), None)


def _log(program: "cl._Program", device: cl.Device) -> str:
    """Return what the compiler said."""
    try:
        return program.get_build_info(device, cl.program_build_info.LOG) or ""
    except cl.Error:
        return ""


# --- binaries: one file each, a digest and what it is the digest of ---------------------

_DIGEST_BYTES = 32


def _binary_file(device: cl.Device, name: str, options: list[str]) -> str | None:
    """Return the name of a build in the cache; None if the user wants no caching."""
    if os.environ.get("PYOPENCL_NO_CACHE"):
        return None
    identity = (
        source(name), *options, cl.VERSION_TEXT, device.name, device.vendor, device.version,
        device.driver_version, device.platform.name, device.platform.version, cpu_identity(),
    )  # fmt: skip
    digest = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    return f"kernels/{Path(name).stem}-{digest[:32]}.bin"


def _digest(file: str, binary: bytes) -> bytes:
    """Return what a kept build begins with: a file under another's name is damaged too."""
    return hashlib.sha256(file.encode() + binary).digest()


def _from_binary(context: cl.Context, file: str | None, options: list[str]) -> "cl._Program | None":
    """Load a kept build; None if there is none, or it is damaged, or the driver refuses it."""
    content = read_cached(file) if file else b""
    digest, binary = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if file is None or not binary or _digest(file, binary) != digest:
        return None
    try:
        program = cl._Program(context, context.devices, [binary])
        _build(program, options)
    except cl.Error:
        return None
    return program


def _keep_binary(program: "cl._Program", file: str | None) -> None:
    """Keep a build, if the driver gives its binary and the folder can be written to."""
    if file is None:
        return
    try:
        binary = program.get_info(cl.program_info.BINARIES)[0]
    except cl.Error:
        return
    if binary:
        write_cached(file, _digest(file, binary) + binary)
