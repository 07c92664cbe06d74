"""Quirks: named properties of devices that need other build options (`constants.apply_quirks`)."""

import os

import pyopencl as cl

from clmorph.backends.opencl.devices.verdicts import probed
from clmorph.errors import InputError

#: The number of rounds after which llvmpipe, Mesa's driver of CPUs, ends the loops of a work-item.
#: It counts the rounds of all loops of a kernel together, also the one in which a loop ends.
LONGEST_LOOP = 65535

#: Name and description of each quirk.
QUIRKS = {
    "small_groups": "work-groups hold fewer than 64 work-items: groups of 16 at most",
    "inexact_exp2": "the built-in exp2 is off by more than a few units: a polynomial instead",
    "small_local_memory": "under 8 KiB of local memory: tiles of 16 points",
    "short_loops": f"loops end after {LONGEST_LOOP} rounds in all, in silence: shorter launches",
    "no_vectors": "the compiler of PoCL 3.0 from pip crashes or hangs on 16 lanes: scalars",
    "slow_float64": "measured to be slower in double precision than in sums of two float32: these",
    "no_float64": "no double precision: precise exponents are sums of two float32",
}

#: Parts of the names, in lower case, of devices whose built-in exp2 was found to be wrong.
INEXACT_EXP2: tuple[str, ...] = ()
#: Parts of the names, in lower case, of devices that end long loops.
SHORT_LOOPS = ("llvmpipe",)
#: Parts of the versions, in lower case, of platforms whose compiler fails on vectors where it
#: announces more lanes than this.
NO_VECTORS, VECTORS_TO = ("pocl 3.0-rc2",), 8


def find_quirks(device: cl.Device) -> frozenset[str]:
    """Return the names of a device's quirks, those forced by ``CLMORPH_QUIRKS`` included."""
    found = forced_quirks()
    if device.max_work_group_size < 64:
        found |= {"small_groups"}
    if any(part in device.name.lower() for part in INEXACT_EXP2):
        found |= {"inexact_exp2"}
    if any(part in device.name.lower() for part in SHORT_LOOPS):
        found |= {"short_loops"}
    wide = device.native_vector_width_float > VECTORS_TO
    if wide and any(part in device.platform.version.lower() for part in NO_VECTORS):
        found |= {"no_vectors"}
    if device.local_mem_size < 8192:
        found |= {"small_local_memory"}
    if not has_float64(device):
        found |= {"no_float64"}
    elif probed(device).slow_float64:
        found |= {"slow_float64"}
    return found


def forced_quirks() -> frozenset[str]:
    """Return the quirks named by ``CLMORPH_QUIRKS``."""
    names = frozenset(filter(None, os.environ.get("CLMORPH_QUIRKS", "").split(",")))
    unknown = sorted(names - set(QUIRKS))
    if unknown:
        raise InputError(
            f"CLMORPH_QUIRKS names {unknown[0]!r}: expected some of {', '.join(QUIRKS)}"
        )
    return names


def shares_host_memory(device: cl.Device) -> bool:
    """Return whether a device says that its memory is a part of the host's."""
    try:
        return bool(device.host_unified_memory)
    except (cl.Error, AttributeError):  # OpenCL 2.0 deprecates the property
        return False


def has_float64(device: cl.Device) -> bool:
    """Return whether a device computes in double precision."""
    return "cl_khr_fp64" in device.extensions.split()
