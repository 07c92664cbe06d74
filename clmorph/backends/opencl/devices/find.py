"""Find OpenCL devices, determine which of them work, and choose one."""

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clmorph.backends.opencl.devices.install_hints import advice
from clmorph.backends.opencl.devices.process import Once
from clmorph.backends.opencl.devices.runtimes import intel_runtime, list_platforms
from clmorph.backends.opencl.devices.verdicts import (
    forget_all,
    load_verdict,
    probe_seconds,
    run_probe,
    save_verdict,
    verdict_key,
)
from clmorph.errors import DeviceError

if TYPE_CHECKING:
    import pyopencl as cl


@dataclass(frozen=True)
class Device:
    """An OpenCL device, its properties, and whether it works.

    Attributes
    ----------
    index : str
        Index "platform:device", as counted in this process.
    name, platform, version, driver : str
    kind : {"GPU", "CPU", "accelerator"}
    compute_units : int
    memory : int
        Bytes of global memory.
    usable : bool
        Whether the project's kernels were built and run on it.
    reason : str
        The reason why the device is not usable; empty if it is.
    pairs_per_second : float
        Point pairs per second in the log-sum-exp, as measured by the probe; 0 if unknown.
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
        """Return the properties of the device as values that JSON can represent."""
        from clmorph.backends.opencl.devices.quirks import find_quirks, has_float64

        known = {name: value for name, value in vars(self).items() if name != "handle"}
        return known | {
            "float64": has_float64(self.handle),
            "max_work_group_size": self.handle.max_work_group_size,
            "local_memory": self.handle.local_mem_size,
            "largest_buffer": self.handle.max_mem_alloc_size,
            "quirks": sorted(find_quirks(self.handle)),
        }

    def matches(self, text: str) -> bool:
        """Return whether `text` is this device's index or part of its or its platform's name."""
        if text == self.index:
            return True
        return text.lower() in f"{self.name} {self.platform} {self.version}".lower()


@Once
def raw_devices() -> tuple[tuple[str, "cl.Device"], ...]:
    """Return (index, device) of the devices of all platforms; empty if there are none."""
    try:
        platforms = list_platforms()
    except ImportError:
        return ()
    import pyopencl as cl

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


@Once
def find_devices() -> tuple[Device, ...]:
    """List every OpenCL device, usable or not.

    The verdict on each device is stored under a key of driver, platform, processor and kernel
    sources; the first test of a device takes some seconds. A test that ran out of time or memory is
    no evidence about the device, and the next process repeats it.

    Raises
    ------
    InputError
        If ``CLMORPH_PROBE_SECONDS`` is not a number from 1 to 3600.
    """
    probe_seconds()  # an invalid value is always reported, not only when a device is new
    devices = []
    for index, handle in raw_devices():
        key = verdict_key(handle)
        verdict = load_verdict(key)
        if verdict is None:
            verdict = run_probe(index)
            save_verdict(key, verdict)
        devices.append(_describe(index, handle, verdict))
    return tuple(devices)


def forget_verdicts() -> None:
    """Forget all verdicts on devices, so that the next search tests them again."""
    forget_all()
    find_devices.cache_clear()


def preference(device: Device) -> tuple[int, float]:
    """Return a sort key: GPUs before other devices before CPUs, then by speed."""
    return {"GPU": 0, "CPU": 2}.get(device.kind, 1), -device.pairs_per_second


def choose_device(spec: str = "auto") -> Device:
    """Choose the device that a user specifies.

    Parameters
    ----------
    spec : str
        "auto" (or "opencl") chooses the device that ``PYOPENCL_CTX`` names, if it is set, and else
        the best usable device. Another text is an index such as "0:1", or part of a device's or
        platform's name.

    Raises
    ------
    DeviceError
        If there is no such device, or none that works; the message contains advice.
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
    """Return the device that pyopencl itself would choose for ``PYOPENCL_CTX``."""
    import pyopencl as cl

    value = os.environ["PYOPENCL_CTX"]
    try:
        handle = cl.create_some_context(interactive=False).devices[0]
        named = [device for device in devices if device.handle == handle]
    except (cl.Error, RuntimeError, ValueError, IndexError) as error:
        # Runtimes from pip are not in pyopencl's own list; clmorph's indices and names apply.
        named = [
            device for device in devices
            if device.index in (value, f"{value}:0")
            or (not value[:1].isdigit() and device.matches(value))
        ]  # fmt: skip
        if not named:
            raise DeviceError(
                f"PYOPENCL_CTX={value!r} names no device ({error}); "
                "unset it, or name a device with --device or CLMORPH_DEVICE"
            ) from error
    if not named:
        raise DeviceError(
            f"PYOPENCL_CTX={value!r} names a device that cannot be listed; unset it, or name a "
            "device with --device or CLMORPH_DEVICE"
        )
    if not named[0].usable:
        raise DeviceError(f"PYOPENCL_CTX={value!r} names {named[0]}; choose another device")
    return named[0]


def _installation_hint(devices: tuple[Device, ...]) -> str:
    """Return advice on how to get a usable device, given the devices that were found."""
    if any("Intel" in device.platform for device in devices):
        return "update the drivers (clmorph devices --again), or use the backend 'numpy'"
    if intel_runtime() is not None:
        return (
            "Intel's CPU runtime is installed but was not found: unset OCL_ICD_VENDORS, if it is "
            "set, or install the runtime again; or use the backend 'numpy'"
        )
    return f"{advice()[0]}; or use the backend 'numpy' (clmorph devices tells more)"
