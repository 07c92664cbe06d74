"""Verdicts on devices: each device is tested in a separate process, and the result is stored.

A driver may abort or hang its process, so the test (`opencl.probe`) does not run in this process. A
verdict that depends on the device and its driver is stored; a verdict with a temporary cause (a
timeout, a lack of memory, a kill by the user) is not.
"""

import hashlib
import json
import math
import os
import platform
import re
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clmorph._shared.validation import check_number
from clmorph.backends.opencl.devices.cache import forget_cached, load_record, save_record

if TYPE_CHECKING:
    import pyopencl as cl

#: Time limit in seconds to build and run the probe, and the variable that changes it.
PROBE_SECONDS = 60.0
PROBE_SECONDS_VARIABLE = "CLMORPH_PROBE_SECONDS"
#: The line that the probe prints before it opens the device.
LOADED = "clmorph.backends.opencl.probe: loaded"
#: The folder of verdicts in the cache, with one file for each verdict.
_FOLDER = "devices"
#: Signals that end a process for a reason outside the driver: a user, or a lack of memory.
_FROM_OUTSIDE = ("SIGHUP", "SIGINT", "SIGKILL", "SIGQUIT", "SIGTERM")
#: Variables that would change how the probe's interpreter ends, warns or prints.
_UNWANTED = ("PYTHONINSPECT", "PYTHONIOENCODING", "PYTHONWARNINGS")


@cache
def cpu_identity() -> str:
    """Return the name of the processor, because builds of CPU runtimes can fail on another one."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    wanted = ("vendor_id", "cpu family", "model", "stepping", "flags")
    return "|".join(dict.fromkeys(line for line in lines if line.startswith(wanted)))


@cache
def _code_identity() -> str:
    """Return a digest of the probe and of everything that it builds and runs."""
    from importlib import resources

    digest = hashlib.sha256()
    folders = [resources.files("clmorph.cl_kernels"), resources.files("clmorph.backends.opencl")]
    while folders:
        for entry in sorted(folders.pop().iterdir(), key=lambda item: item.name):
            if entry.is_dir():
                folders.append(entry)
            elif entry.name.endswith((".cl", ".py")):
                digest.update(entry.read_bytes())
    return digest.hexdigest()


def verdict_key(device: "cl.Device") -> str:
    """Return a digest of a device, its driver, the processor and the package's kernels."""
    identity = (
        device.name, device.driver_version, device.platform.name, device.platform.version,
        cpu_identity(), _code_identity(),
    )  # fmt: skip
    return hashlib.sha256("|".join(identity).encode()).hexdigest()[:32]


def load_verdict(key: str) -> dict[str, Any] | None:
    """Return the stored verdict on a device; None if it is missing or damaged.

    Parameters
    ----------
    key : str
        See `verdict_key`.

    Returns
    -------
    dict
        The entries usable (bool), reason (str, empty if usable), pairs_per_second (float).
    """
    verdict = load_record(f"{_FOLDER}/{key}")
    usable, reason = verdict.get("usable"), verdict.get("reason")
    speed = verdict.get("pairs_per_second")
    whole = (
        isinstance(usable, bool)
        and isinstance(reason, str)
        and usable != bool(reason)
        and isinstance(speed, float)
        and math.isfinite(speed)
        and speed >= 0
    )
    return verdict if whole else None


def save_verdict(key: str, verdict: dict[str, Any]) -> None:
    """Store a verdict, unless its cause is temporary."""
    if verdict.get("lasting", True):
        save_record(f"{_FOLDER}/{key}", verdict)


def forget_all() -> None:
    """Forget every verdict."""
    forget_cached(_FOLDER)


def probe_seconds() -> float:
    """Return the time limit of a probe, in seconds.

    Raises
    ------
    InputError
        If ``CLMORPH_PROBE_SECONDS`` is not a number from 1 to 3600.
    """
    text = os.environ.get(PROBE_SECONDS_VARIABLE, "").strip()
    if not text:
        return PROBE_SECONDS
    try:
        value: Any = float(text)
    except ValueError:
        value = text
    return check_number(PROBE_SECONDS_VARIABLE, value, 1, 3600)


def run_probe(index: str, seconds: float | None = None) -> dict[str, Any]:
    """Build and run the kernels on a device, in a separate process.

    Parameters
    ----------
    index : str
        The device, as counted by `clmorph.backends.opencl.devices.find.raw_devices`.
    seconds : float, optional
        Time limit; if not given, `probe_seconds`.

    Returns
    -------
    dict
        The entries usable (bool), reason (str), pairs_per_second (float), and lasting (bool), which
        states whether another probe would return the same verdict.
    """
    seconds = probe_seconds() if seconds is None else seconds
    python = _interpreter()
    if python is None:
        return _untried(
            f"cannot be tried, because {sys.executable or 'an empty sys.executable'!r} is no "
            "Python interpreter: name one with multiprocessing.set_executable"
        )
    # -P: the current folder may hold another clmorph, such as a source tree.
    command = [python, "-P", "-W", "ignore", "-m", "clmorph.backends.opencl.probe", index]
    # The probe ends when this pipe is closed, which happens however this process ends.
    reading, writing = os.pipe()
    try:
        done = subprocess.run(
            command, env=_environment(), timeout=seconds, capture_output=True, text=True,
            errors="replace", stdin=reading, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return _untried(
            f"did not build and run a small kernel within {seconds:g} s; it is tried again next "
            f"time, and {PROBE_SECONDS_VARIABLE} sets how many seconds it may take"
        )
    except OSError as error:
        return _untried(f"cannot be tried ({python}: {error.strerror})")
    finally:
        os.close(reading)
        os.close(writing)
    return _judge(done)


def _untried(reason: str) -> dict[str, Any]:
    return {"usable": False, "reason": reason, "pairs_per_second": 0.0, "lasting": False}


def _judge(done: "subprocess.CompletedProcess[str]") -> dict[str, Any]:
    """Return the verdict of a probe that has ended."""
    lines = done.stdout.strip().splitlines()
    if done.returncode == 0 and lines:
        try:
            return dict(json.loads(lines[-1]))
        except (ValueError, TypeError):
            pass
    noise = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    reason = noise[-1] if noise else "no output"
    reason = f"its probe ended with status {done.returncode}: {reason}"
    # If the probe has not opened the device yet, the driver is not the cause of the failure.
    lasting = LOADED in lines
    if done.returncode < 0:
        lasting, reason = True, f"its driver crashed (signal {-done.returncode}) on a kernel"
        outside = [getattr(signal, name, None) for name in _FROM_OUTSIDE]
        if -done.returncode in outside:
            lasting, reason = False, f"its probe was killed (signal {-done.returncode})"
    return _untried(reason) | {"lasting": lasting}


def _interpreter() -> str | None:
    """Return the path of the Python interpreter; None if an embedding program does not set it.

    The path may then be that of the application itself, which must not be started as the probe.
    """
    from multiprocessing.spawn import get_executable

    python = os.fsdecode(get_executable() or "")
    named = re.match(r"(python|pypy|graalpy)", Path(python).name, re.IGNORECASE)
    return python if named else None


def _environment() -> dict[str, str]:
    """Return the variables with which the probe finds the same modules as this process."""
    known = {name: value for name, value in os.environ.items() if name not in _UNWANTED}
    if sys.flags.ignore_environment:
        known = {name: value for name, value in known.items() if not name.startswith("PYTHON")}
    # Relative entries refer to the current folder, whose modules may shadow others.
    places = [place for place in sys.path if Path(place).is_absolute()]
    root = str(Path(__file__).parents[4])
    known["PYTHONPATH"] = os.pathsep.join(dict.fromkeys([*places, root]))
    return known
