"""Load, expand and build the kernel sources."""

import functools
import hashlib
import pickle
import re
import sqlite3
import warnings
from importlib import resources
from pathlib import Path

import platformdirs
import pyopencl as cl

from clmorph.backends.opencl.devices.cache import read_cached, write_cached
from clmorph.backends.opencl.devices.runtimes import is_uncached
from clmorph.backends.opencl.devices.verdicts import cpu_identity
from clmorph.backends.records import ProgramError

_INCLUDE = re.compile(r'^#include "([a-z_]+\.cl)"$', re.MULTILINE)


@functools.cache
def source(name: str) -> str:
    """Return a file of ``cl_kernels/`` with its includes, because drivers cache by the text."""
    text = (resources.files("clmorph.cl_kernels") / name).read_text(encoding="utf-8")

    def expand(match: re.Match[str]) -> str:
        line = text.count("\n", 0, match.start()) + 2
        return f'#line 1 "{match[1]}"\n{source(match[1])}\n#line {line} "{name}"'

    return f'#line 1 "{name}"\n' + _INCLUDE.sub(expand, text)


def build(
    context: cl.Context,
    name: str,
    constants: dict[str, int | float],
    device: cl.Device | None = None,
) -> cl.Program:
    """Build a kernel file for a device of a context, or raise a ProgramError; binaries are kept."""
    options = build_options(constants)
    device = device or context.devices[0]
    if is_uncached():
        return cl.Program(_from_source(context, device, name, options))
    file = f"kernels/{build_key(device, name, constants)}.bin"
    program = _from_binary(context, device, file, options)
    if program is None:
        program = _from_source(context, device, name, options)
        _keep_binary(program, file)
    return cl.Program(program)


def build_key(device: cl.Device, name: str, constants: dict[str, int | float]) -> str:
    """Return the key of a build: a digest of source, options, device, driver and processor."""
    identity = (
        source(name), *build_options(constants), cl.VERSION_TEXT, device.name, device.vendor,
        device.version, device.driver_version, device.platform.name, device.platform.version,
        cpu_identity(),
    )  # fmt: skip
    digest = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    return f"{Path(name).stem}-{digest[:32]}"


def build_options(constants: dict[str, int | float]) -> list[str]:
    """Return the compiler's options for these macros."""
    options = ["-cl-std=CL1.2"]
    for key, value in sorted(constants.items()):
        text = f"{value:.9g}f" if isinstance(value, float) else str(value)
        options.append(f"-D{key}={text}")
    if constants.get("EXP2_BUILTIN"):
        # Sums hold a term near 1, so that results of exp2 below 2^-126, which cards handle by
        # several instructions, need not be exact. The polynomial has none.
        options.append("-cl-denorms-are-zero")
    return options


def kernel(program: cl.Program, name: str) -> cl.Kernel:
    """Return a kernel of a program, even if pyopencl's database of its own is unusable."""
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
    """Turn pyopencl's cache off if there is no folder for it, because pyopencl would then warn."""
    folder = Path(platformdirs.user_cache_dir("pytools", "pytools"))
    try:
        if folder.is_absolute():  # a relative one would be made in the current folder
            folder.mkdir(parents=True, exist_ok=True)
            return
    except OSError:
        pass
    cl._PYOPENCL_NO_CACHE = True


def _from_source(
    context: cl.Context, device: cl.Device, name: str, options: list[str]
) -> "cl._Program":
    program = cl._Program(context, source(name))
    try:
        _build(program, device, options)
    except cl.Error as error:
        lines = [line.strip() for line in f"{_log(program, device)}\n{error}".splitlines()]
        lines = [line for line in lines if line]
        reason = next((line for line in lines if "error" in line.lower()), lines[0])
        raise ProgramError(
            f"{device.name.strip()} cannot build {name}: {reason}; "
            "update its driver, or choose another device with --device or CLMORPH_DEVICE"
        ) from error
    complaints = [line.strip() for line in _log(program, device).splitlines() if "warning:" in line]
    if complaints:
        warnings.warn(f"{device.name.strip()}, {name}: {complaints[0]}", stacklevel=3)
    return program


def _build(program: "cl._Program", device: cl.Device, options: list[str]) -> None:
    """Build a program by the driver alone, without pyopencl's warnings, locks and cache."""
    # pyopencl's `build` waits a minute for a killed process's lock, and fails if its cache is
    # damaged. It calls the private `_build`; if that is missing, `build` is called.
    build = getattr(program, "_build", None) or program.build
    build(" ".join(options).encode(), [device])


def _log(program: "cl._Program", device: cl.Device) -> str:
    """Return the compiler's log."""
    try:
        return program.get_build_info(device, cl.program_build_info.LOG) or ""
    except cl.Error:
        return ""


# --- binaries: each file holds a digest, and the binary that it belongs to --------------

_DIGEST_BYTES = 32


def _digest(file: str, binary: bytes) -> bytes:
    """Return the digest of a file's name and content, with which a file in the cache begins."""
    return hashlib.sha256(file.encode() + binary).digest()


def _from_binary(
    context: cl.Context, device: cl.Device, file: str, options: list[str]
) -> "cl._Program | None":
    """Load a cached build; return None if it is missing, damaged, or rejected by the driver."""
    content = read_cached(file)
    digest, binary = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if not binary or _digest(file, binary) != digest:
        return None
    try:
        program = cl._Program(context, [device], [binary])
        _build(program, device, options)
    except cl.Error:
        return None
    return program


def _keep_binary(program: "cl._Program", file: str) -> None:
    """Store a build in the cache, if the driver returns its binary and the folder is writable."""
    try:
        # In a context of several devices, those that the program was not built for have none.
        binary = next(filter(None, program.get_info(cl.program_info.BINARIES)), b"")
    except cl.Error:
        return
    if binary:
        write_cached(file, _digest(file, binary) + binary)
