"""Verdicts on devices and programs: keys, and files for those whose cause is not temporary."""

import hashlib
import math
import os
import platform
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from clmorph.backends.opencl.devices.cache import forget_cached, load_record, save_record

if TYPE_CHECKING:
    import pyopencl as cl

#: What the reason of a verdict begins with if results were wrong: no crash, no refusal.
WRONG = "wrong result of "
#: Files of iterations: where the driver refuses or crashes on one, the host iterates instead.
OPTIONAL = ("half_steps.cl", "sparse_half_steps.cl")
#: The entry of a verdict on a device that is slower in float64 than in pairs of float32.
SLOW_FLOAT64 = "slow_float64"
#: The entry with the result of `probe.many_eighths`, and its value on CPUs, where it is not
#: measured.
MANY_EIGHTHS, USUAL_EIGHTHS = "many_eighths", 5
#: What the reason of a verdict begins with if the driver ended the process of the check.
CRASHED = "its driver crashed"
#: The folders of verdicts on devices and on programs in the cache, with one file for each verdict.
_DEVICES, _PROGRAMS = "devices", "verified"


class ProgramVerdict(NamedTuple):
    """What is wrong with a program, '' if nothing is, and whether another check would find it."""

    reason: str
    lasting: bool = True


#: Verdicts on devices that this process has refused, and on programs, by their keys.
_refused: dict[str, dict[str, Any]] = {}
_programs: dict[str, ProgramVerdict] = {}


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
    return _digest(device_key(device), *forced) if forced else device_key(device)


def driver_identity(device: "cl.Device") -> tuple[str, str, str, str]:
    """Return what a device and its parts have in common: names and versions of the driver."""
    return (
        device.name, device.driver_version, device.platform.name, device.platform.version,
    )  # fmt: skip


def _digest(*identity: str) -> str:
    return hashlib.sha256("|".join(identity).encode()).hexdigest()[:32]


# --- devices ------------------------------------------------------------------------------


def load_verdict(key: str) -> dict[str, Any] | None:
    """Return the verdict of a `verdict_key` (`trial.run_probe`); None if missing or damaged."""
    if key in _refused:
        return _refused[key]
    verdict = load_record(f"{_DEVICES}/{key}")
    usable, reason = verdict.get("usable"), verdict.get("reason")
    speed = verdict.get("pairs_per_second")
    whole = isinstance(usable, bool) and isinstance(reason, str) and usable != bool(reason)
    whole = whole and isinstance(speed, float) and math.isfinite(speed) and speed >= 0
    return verdict if whole else None


def probed_speed(device: "cl.Device") -> float:
    """Return the probe's point pairs per second; 0 if unknown, as for a part of a device."""
    import pyopencl as cl

    try:
        part = device.parent_device is not None
    except cl.Error:  # OpenCL 1.1 has no parts
        part = False
    verdict = None if part else load_verdict(verdict_key(device))
    return float((verdict or {}).get("pairs_per_second", 0.0))


def probed_eighths(device: "cl.Device") -> int:
    """Return of how many eighths of a tile's columns on the device is faster with all of them."""
    found = (load_verdict(verdict_key(device)) or {}).get(MANY_EIGHTHS)
    return found if type(found) is int and 0 < found <= 8 else USUAL_EIGHTHS


def save_verdict(key: str, verdict: dict[str, Any]) -> None:
    """Store a verdict, unless its cause is temporary."""
    if verdict.get("lasting", True):
        save_record(f"{_DEVICES}/{key}", verdict)


def failed(reason: str, lasting: bool = False) -> dict[str, Any]:
    """Return the verdict on a device that is unusable for a reason."""
    return {"usable": False, "reason": reason, "pairs_per_second": 0.0, "lasting": lasting}


def refuse(key: str, reason: str) -> None:
    """Remember that a device is unusable, in this process even if nothing can be stored."""
    _refused[key] = failed(reason, lasting=True)
    save_verdict(key, _refused[key])


def refusals() -> int:
    """Return how many devices this process has found unusable after their trial."""
    return len(_refused)


def forget(key: str | None = None) -> None:
    """Forget the verdict on a device, by default on all devices, and those on all programs."""
    if key is None:
        _refused.clear()
    else:
        _refused.pop(key, None)
    forget_cached(_DEVICES if key is None else f"{_DEVICES}/{key}.json")
    _programs.clear()
    forget_cached(_PROGRAMS)


# --- programs -----------------------------------------------------------------------------


def load_program_verdict(key: str) -> ProgramVerdict | None:
    """Return the verdict on a program; None if it must be verified."""
    if key not in _programs:
        record = load_record(f"{_PROGRAMS}/{key}")
        passed, reason = record.get("passed"), record.get("reason")
        if not (isinstance(passed, bool) and isinstance(reason, str) and passed != bool(reason)):
            return None
        _programs[key] = ProgramVerdict(reason)
    return _programs[key]


def save_program_verdict(key: str, reason: str, lasting: bool = True) -> ProgramVerdict:
    """Remember what is wrong with a program; only in this process if not `lasting`."""
    if lasting:
        save_record(f"{_PROGRAMS}/{key}", {"passed": not reason, "reason": reason})
    _programs[key] = ProgramVerdict(reason, lasting)
    return _programs[key]


def condemns(reason: str, optional: bool = False) -> bool:
    """Return whether a refused program's device does not work at all: wrong results, crashes."""
    return reason.startswith((WRONG,) if optional else (WRONG, CRASHED))
