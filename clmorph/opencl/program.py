"""Load, expand and build the kernel sources."""

import functools
import hashlib
import os
import re
import warnings
from importlib import resources
from pathlib import Path

import pyopencl as cl

from clmorph.errors import DeviceError
from clmorph.opencl.storage import cache_folder, write_atomically

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
    return program


def _from_source(context: cl.Context, name: str, options: list[str]) -> cl.Program:
    device = context.devices[0]
    try:
        program = _quietly_built(cl.Program(context, source(name)), options)
    except cl.Error as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = next((line for line in lines if "error" in line.lower()), lines[0])
        raise DeviceError(
            f"{device.name.strip()} cannot build {name}: {reason}; "
            "update its driver, or choose another device with --device or CLMORPH_DEVICE"
        ) from error
    log = program.get_build_info(device, cl.program_build_info.LOG) or ""
    complaints = [line.strip() for line in log.splitlines() if "warning:" in line]
    if complaints:
        warnings.warn(f"{device.name.strip()}, {name}: {complaints[0]}", stacklevel=3)
    return program


def _quietly_built(program: cl.Program, options: list[str]) -> cl.Program:
    """Build without pyopencl's own cache.

    That one waits a minute for the lock of a process that was killed, and a damaged entry
    of it is an error; see `_from_binary` for what is done here.
    """
    with warnings.catch_warnings():
        # Intel's compiler writes a build log on success too; `_from_source` reads it.
        warnings.filterwarnings("ignore", message="Non-empty compiler output")
        return program.build(options, cache_dir=False)


# --- binaries: one file each, a digest and what it is the digest of ---------------------

_DIGEST_BYTES = 32


def _binary_file(device: cl.Device, name: str, options: list[str]) -> Path | None:
    """Return where a build belongs; None if the user wants no caching."""
    if os.environ.get("PYOPENCL_NO_CACHE"):
        return None
    identity = (
        source(name), *options, cl.VERSION_TEXT, device.name, device.vendor, device.version,
        device.driver_version, device.platform.name, device.platform.version,
    )  # fmt: skip
    digest = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    return cache_folder() / "kernels" / f"{Path(name).stem}-{digest[:32]}.bin"


def _from_binary(context: cl.Context, file: Path | None, options: list[str]) -> cl.Program | None:
    """Load a kept build; None if there is none, or it is damaged, or the driver refuses it."""
    try:
        content = file.read_bytes() if file else b""
    except OSError:
        return None
    digest, binary = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if not binary or hashlib.sha256(binary).digest() != digest:
        return None
    try:
        return _quietly_built(cl.Program(context, context.devices, [binary]), options)
    except cl.Error:
        return None


def _keep_binary(program: cl.Program, file: Path | None) -> None:
    """Keep a build, if the driver gives its binary and the folder can be written to."""
    if file is None:
        return
    try:
        binary = program.get_info(cl.program_info.BINARIES)[0]
        file.parent.mkdir(parents=True, exist_ok=True)
        if binary:
            write_atomically(file, hashlib.sha256(binary).digest() + binary)
    except (cl.Error, OSError):
        return
