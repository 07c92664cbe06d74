"""Find OpenCL devices, learn which of them work, and choose one."""

import hashlib
import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clmorph.errors import DeviceError
from clmorph.installation import advice
from clmorph.opencl.runtimes import import_pyopencl, intel_runtime, register_pip_runtimes
from clmorph.opencl.storage import load_record, save_record

if TYPE_CHECKING:
    import pyopencl as cl

#: Seconds that a device may take to build and run the probe.
PROBE_SECONDS = 30
_VERDICTS = "devices.json"


@dataclass(frozen=True)
class Device:
    """An OpenCL device and what is known of it.

    Attributes
    ----------
    index : str
        "platform:device", as counted in this process.
    name, platform, version, driver : str
    kind : {"GPU", "CPU", "accelerator"}
    compute_units : int
    memory : int
        Bytes of global memory.
    usable : bool
        Whether the project's kernels were built and run on it.
    reason : str
        Why not, if not.
    pairs_per_second : float
        Point pairs through the log-sum-exp, as measured by the probe; 0 if unknown.
    handle : pyopencl.Device
    """

    index: str
    name: str
    platform: str
    version: str
    driver: str
    kind: str
    compute_units: int
    memory: int
    usable: bool
    reason: str
    pairs_per_second: float
    handle: "cl.Device"

    def __str__(self) -> str:
        state = "" if self.usable else f", unusable: {self.reason}"
        return f"[{self.index}] {self.name} ({self.platform}, driver {self.driver}{state})"

    def record(self) -> dict[str, Any]:
        """Return what is known of the device, ready for JSON."""
        from clmorph.opencl.quirks import find_quirks, has_float64

        known = {name: value for name, value in vars(self).items() if name != "handle"}
        return known | {
            "float64": has_float64(self.handle),
            "max_work_group_size": self.handle.max_work_group_size,
            "local_memory": self.handle.local_mem_size,
            "largest_buffer": self.handle.max_mem_alloc_size,
            "quirks": sorted(find_quirks(self.handle)),
        }

    def matches(self, text: str) -> bool:
        """Whether `text` is this device's index or part of its or its platform's name."""
        if text == self.index:
            return True
        return text.lower() in f"{self.name} {self.platform} {self.version}".lower()


@cache
def raw_devices() -> tuple[tuple[str, "cl.Device"], ...]:
    """Enumerate (index, device) over all platforms; empty where OpenCL has none."""
    try:
        import_pyopencl()
    except ImportError:
        return ()
    import pyopencl as cl

    with register_pip_runtimes():
        try:
            platforms = cl.get_platforms()
        except cl.Error:
            return ()
    found = []
    for p, entry in enumerate(platforms):
        try:
            devices = entry.get_devices()
        except cl.Error:
            continue
        found += [(f"{p}:{d}", device) for d, device in enumerate(devices)]
    return tuple(found)


def _describe(index: str, device: "cl.Device", verdict: dict[str, Any]) -> Device:
    import pyopencl as cl

    kind = "accelerator"
    if device.type & cl.device_type.GPU:
        kind = "GPU"
    elif device.type & cl.device_type.CPU:
        kind = "CPU"
    return Device(
        index=index,
        name=" ".join(device.name.split()),
        platform=device.platform.name.strip(),
        version=device.platform.version.strip(),
        driver=device.driver_version.strip(),
        kind=kind,
        compute_units=device.max_compute_units,
        memory=device.global_mem_size,
        usable=bool(verdict["usable"]),
        reason=str(verdict["reason"]),
        pairs_per_second=float(verdict["pairs_per_second"]),
        handle=device,
    )


@cache
def _cpu_identity() -> str:
    """Name of the processor: CPU runtimes that build on one can fail on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    wanted = ("vendor_id", "cpu family", "model", "stepping", "flags")
    return "|".join(dict.fromkeys(line for line in lines if line.startswith(wanted)))


@cache
def _code_identity() -> str:
    """Digest of the probe and of everything that it builds and runs."""
    from importlib import resources

    digest = hashlib.sha256()
    for package, suffix in (("clmorph.cl_kernels", ".cl"), ("clmorph.opencl", ".py")):
        for entry in sorted(resources.files(package).iterdir(), key=lambda item: item.name):
            if entry.name.endswith(suffix):
                digest.update(entry.read_bytes())
    return digest.hexdigest()


def verdict_key(device: "cl.Device") -> str:
    """Digest of a device, its driver, the processor and our kernels."""
    identity = (
        device.name, device.driver_version, device.platform.name, device.platform.version,
        _cpu_identity(), _code_identity(),
    )  # fmt: skip
    return hashlib.sha256("|".join(identity).encode()).hexdigest()[:32]


def run_probe(index: str, seconds: float = PROBE_SECONDS) -> dict[str, Any]:
    """Build and run the kernels on a device, in a process of its own.

    A driver may abort or hang its process, so the trial is kept out of this one.

    Parameters
    ----------
    index : str
        The device, as counted by `raw_devices`.
    seconds : float
        Time limit.

    Returns
    -------
    dict
        usable (bool), reason (str), pairs_per_second (float).
    """
    environment = dict(os.environ)
    root = str(Path(__file__).parents[2])
    search_path = [root, environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, search_path))
    # -P: the current folder may hold another clmorph, such as a source tree.
    command = [sys.executable, "-P", "-W", "ignore", "-m", "clmorph.opencl.probe", index]
    failed = {"usable": False, "pairs_per_second": 0.0}
    try:
        done = subprocess.run(
            command, env=environment, timeout=seconds, capture_output=True, text=True,
            errors="replace", stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        reason = f"did not build and run a small kernel within {seconds:g} s"
        return failed | {"reason": reason}
    lines = done.stdout.strip().splitlines()
    if done.returncode == 0 and lines:
        try:
            return dict(json.loads(lines[-1]))
        except ValueError:
            pass
    if done.returncode < 0:
        return failed | {"reason": f"its driver crashed (signal {-done.returncode}) on a kernel"}
    noise = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    reason = noise[-1] if noise else "no output"
    return failed | {"reason": f"its probe ended with status {done.returncode}: {reason}"}


@cache
def find_devices() -> tuple[Device, ...]:
    """List every OpenCL device, usable or not.

    The verdict on each is remembered by driver, platform, processor and kernel sources;
    a device seen for the first time takes some seconds.
    """
    verdicts = load_record(_VERDICTS)
    devices = []
    for index, handle in raw_devices():
        key = verdict_key(handle)
        verdict = verdicts.get(key)
        if not isinstance(verdict, dict) or {"usable", "reason", "pairs_per_second"} - set(verdict):
            verdict = run_probe(index)
            save_record(_VERDICTS, load_record(_VERDICTS) | {key: verdict})
        devices.append(_describe(index, handle, verdict))
    return tuple(devices)


def forget_verdicts() -> None:
    """Forget which devices worked, so that the next search tries them again."""
    save_record(_VERDICTS, {})
    find_devices.cache_clear()


def preference(device: Device) -> tuple[int, float]:
    """Sort key: GPUs before others before CPUs, then the faster."""
    return {"GPU": 0, "CPU": 2}.get(device.kind, 1), -device.pairs_per_second


def choose_device(spec: str = "auto") -> Device:
    """Choose the device that a user means.

    Parameters
    ----------
    spec : str
        "auto" (or "opencl"): what ``PYOPENCL_CTX`` names, if set; else the best usable
        device. Otherwise an index such as "0:1", or part of a device's or platform's name.

    Raises
    ------
    DeviceError
        If there is no such device, or none that works; the message says what to do.
    """
    devices = find_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device was found; {_installation_hint(devices)}")
    if spec in ("auto", "opencl"):
        if os.environ.get("PYOPENCL_CTX"):
            return _from_pyopencl_ctx(devices)
        usable = [device for device in devices if device.usable]
        if not usable:
            listed = "; ".join(str(device) for device in devices)
            raise DeviceError(
                f"no OpenCL device is usable ({listed}); {_installation_hint(devices)}"
            )
        return min(usable, key=preference)
    named = [device for device in devices if device.matches(spec)]
    if not named:
        listed = ", ".join(f"[{device.index}] {device.name}" for device in devices)
        raise DeviceError(
            f"no OpenCL device matches {spec!r}: expected an index or part of a name among "
            f"{listed}; or use the backend 'numpy'"
        )
    usable = [device for device in named if device.usable]
    if not usable:
        raise DeviceError(f"{named[0]}; choose another device, or the backend 'numpy'")
    return min(usable, key=preference)


def _from_pyopencl_ctx(devices: tuple[Device, ...]) -> Device:
    """Take the device that pyopencl itself would take for ``PYOPENCL_CTX``."""
    import pyopencl as cl

    value = os.environ["PYOPENCL_CTX"]
    try:
        handle = cl.create_some_context(interactive=False).devices[0]
    except (cl.Error, RuntimeError, ValueError, IndexError) as error:
        raise DeviceError(
            f"PYOPENCL_CTX={value!r} names no device ({error}); "
            "unset it, or name a device with --device or CLMORPH_DEVICE"
        ) from error
    device = next(device for device in devices if device.handle == handle)
    if not device.usable:
        raise DeviceError(f"PYOPENCL_CTX={value!r} names {device}; choose another device")
    return device


def _installation_hint(devices: tuple[Device, ...]) -> str:
    """Say how to get a device that works, given those that were found."""
    if any("Intel" in device.platform for device in devices):
        return "update the drivers (clmorph devices --again), or use the backend 'numpy'"
    if intel_runtime() is not None:
        return (
            "Intel's CPU runtime is installed but was not found: use clmorph before other "
            "OpenCL code in the process, or unset OCL_ICD_VENDORS; or use the backend 'numpy'"
        )
    return f"{advice()[0]}; or use the backend 'numpy' (clmorph devices tells more)"
