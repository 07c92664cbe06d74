"""Verdicts on devices and programs: keys, and files for those whose cause is not temporary."""

import hashlib
import math
import os
import platform
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from clmorph.backends.opencl.devices.cache import forget_cached, load_record, save_record

if TYPE_CHECKING:
    import pyopencl as cl

#: What the reason of a verdict begins with if results were wrong, and if the driver ended the
#: process of the check.
WRONG, CRASHED = "wrong result of ", "its driver crashed"
#: Files of iterations: where the driver refuses or crashes on one, the host iterates instead.
OPTIONAL = ("half_steps.cl", "sparse_half_steps.cl")
#: The folders of verdicts on devices and on programs in the cache, with which their keys begin.
DEVICES, PROGRAMS = "devices", "verified"


@dataclass(frozen=True)
class Verdict:
    """What is wrong with a device or a program, '' if nothing is; what a device's trial found."""

    reason: str = ""
    #: Whether another trial would find the same.
    lasting: bool = True
    #: Whether the trial ran out of time.
    timed_out: bool = False
    #: Point pairs per second in the log-sum-exp; 0 if unknown.
    pairs_per_second: float = 0.0
    #: Whether the device is slower in float64 than in pairs of float32.
    slow_float64: bool = False
    #: From how many eighths of a tile's columns on all are summed faster (`probe.many_eighths`),
    #: which is not measured on CPUs.
    many_eighths: int = 5


_TYPES = {each.name: type(each.default) for each in fields(Verdict)}
#: Verdicts that this process knows, by their keys.
_known: dict[str, Verdict] = {}


@cache
def cpu_identity() -> str:
    """Return the name of the processor, because builds of CPU runtimes can fail on another one."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        return platform.processor()
    wanted = ("vendor_id", "cpu family", "model", "stepping", "flags")
    return "|".join(dict.fromkeys(line for line in lines if line.startswith(wanted)))


@cache
def code_identity() -> str:
    """Return a digest of the probe and of everything that it builds, runs and compares with."""
    from importlib import resources

    digest = hashlib.sha256()
    folders = [resources.files("clmorph.cl_kernels"), resources.files("clmorph.backends")]
    while folders:
        for entry in sorted(folders.pop().iterdir(), key=lambda item: item.name):
            if entry.is_dir():
                folders.append(entry)
            elif entry.name.endswith((".cl", ".py")):
                digest.update(entry.read_bytes())
    return digest.hexdigest()


def device_key(device: "cl.Device") -> str:
    """Return a digest of a device, its driver, the processor and the package's kernels."""
    return _digest(*driver_identity(device), cpu_identity(), code_identity())


def verdict_key(device: "cl.Device") -> str:
    """Return the key of the verdict on a device, which differs if quirks are forced."""
    forced = sorted(filter(None, os.environ.get("CLMORPH_QUIRKS", "").split(",")))
    key = device_key(device)
    return f"{DEVICES}/{_digest(key, *forced) if forced else key}"


def driver_identity(device: "cl.Device") -> tuple[str, str, str, str]:
    """Return what a device and its parts have in common: names and versions of the driver."""
    return (
        device.name, device.driver_version, device.platform.name, device.platform.version,
    )  # fmt: skip


def _digest(*identity: str) -> str:
    return hashlib.sha256("|".join(identity).encode()).hexdigest()[:32]


def load(key: str) -> Verdict | None:
    """Return the verdict of a `verdict_key` or a `program_key`; None if missing or damaged."""
    if key not in _known:
        record = load_record(key)
        if {name: type(value) for name, value in record.items()} != _TYPES:
            return None
        verdict = Verdict(**record)
        if not (0 <= verdict.pairs_per_second < math.inf and 0 < verdict.many_eighths <= 8):
            return None
        _known[key] = verdict
    return _known[key]


def save(key: str, verdict: Verdict) -> Verdict:
    """Remember a verdict; only in this process if its cause is temporary."""
    if verdict.lasting:
        save_record(key, asdict(verdict))
    _known[key] = verdict
    return verdict


def probed(device: "cl.Device") -> Verdict:
    """Return the verdict on a device, or an empty one."""
    return load(verdict_key(device)) or Verdict()


def probed_speed(device: "cl.Device") -> float:
    """Return the probe's point pairs per second; 0 if unknown, as for a part of a device."""
    import pyopencl as cl

    try:
        part = device.parent_device is not None
    except cl.Error:  # OpenCL 1.1 has no parts
        part = False
    return 0.0 if part else probed(device).pairs_per_second


def refusals() -> int:
    """Return how many devices this process knows to be unusable."""
    known = list(_known.items())  # at once: other threads add to it
    return sum(bool(each.reason) for key, each in known if key.startswith(DEVICES))


def forget(key: str | None = None) -> None:
    """Forget the verdict on a device, by default on all devices, and those on all programs."""
    for each in list(_known):
        if key in (None, each) or each.startswith(PROGRAMS):
            del _known[each]
    forget_cached(DEVICES if key is None else f"{key}.json")
    forget_cached(PROGRAMS)


def condemns(reason: str, optional: bool = False) -> bool:
    """Return whether a refused program's device does not work at all: wrong results, crashes."""
    return reason.startswith((WRONG,) if optional else (WRONG, CRASHED))
