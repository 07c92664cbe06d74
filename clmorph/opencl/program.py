"""Load, expand and build the kernel sources."""

import functools
import re
import warnings
from importlib import resources

import pyopencl as cl

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
    try:
        with warnings.catch_warnings():
            # Intel's compiler writes a build log on success too; what it says is read below.
            warnings.filterwarnings("ignore", message="Non-empty compiler output")
            program = cl.Program(context, source(name)).build(options)
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
        warnings.warn(f"{device.name.strip()}, {name}: {complaints[0]}", stacklevel=2)
    return program
