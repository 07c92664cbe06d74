"""Find OpenCL devices, determine which of them work, and choose one."""

import itertools
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clmorph.backends.opencl.devices.install_hints import advice
from clmorph.backends.opencl.devices.process import Once
from clmorph.backends.opencl.devices.runtimes import list_platforms
from clmorph.backends.opencl.devices.trial import FURTHER, probe_seconds, run_probe
from clmorph.backends.opencl.devices.verdicts import (
    WRONG,
    Verdict,
    driver_identity,
    forget,
    load,
    save,
    verdict_key,
)
from clmorph.errors import DeviceError

if TYPE_CHECKING:
    import pyopencl as cl

#: The least ratio of recorded speeds that changes the order of devices.
LEAST_RATIO = 1.2
#: Parts of the names of platforms whose CPU devices come before and after all others, by the
#: measured speed of morphs: first to last.
_FAST_CPU_PLATFORMS = "intel", "portable computing language"
_SLOW_CPU_PLATFORMS = "rusticl", "pocl 3.0-rc2"


@dataclass(frozen=True)
class Device:
    """An OpenCL device, its properties, and whether it works."""

    #: Index "platform:device", as counted in this process.
    index: str
    name: str
    platform: str
    version: str
    driver: str
    #: "GPU", "CPU" or "accelerator".
    kind: str
    compute_units: int
    #: Bytes of global memory.
    memory: int
    #: Whether the project's kernels were built on it and computed what NumPy does.
    usable: bool
    #: The reason why the device is not usable; empty if it is.
    reason: str
    #: Point pairs per second in the log-sum-exp, as measured by the probe; 0 if unknown.
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
        return is_meant(text, self.index, f"{self.name} {self.platform} {self.version}")

    @property
    def computes_wrongly(self) -> bool:
        """Whether the device is unusable because of a wrong result, and not for a crash."""
        return self.reason.startswith(WRONG)


def is_meant(text: str, index: str, names: str) -> bool:
    """Return whether a text is an index, or part of names."""
    return text == index or text.lower() in names.lower()


def describe(index: str, device: "cl.Device", verdict: Verdict) -> Device:
    """Return a device with its properties and its verdict."""
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
        usable=not verdict.reason,
        reason=verdict.reason,
        pairs_per_second=verdict.pairs_per_second,
        handle=device,
    )


def preference(handle: "cl.Device") -> tuple[int, int, int, int]:
    """Return a key for the choice: GPUs, others, CPUs; own memory, fast runtimes, lanes * clock."""
    import pyopencl as cl

    from clmorph.backends.opencl.devices.quirks import shares_host_memory

    lanes = handle.max_compute_units * max(1, handle.native_vector_width_float)
    power = -lanes * handle.max_clock_frequency
    if handle.type & cl.device_type.GPU:
        return 0, int(shares_host_memory(handle)), 0, power
    if not handle.type & cl.device_type.CPU:
        return 1, 0, 0, power
    platform = f"{handle.platform.name} {handle.platform.version}".lower()
    fast, slow = _FAST_CPU_PLATFORMS, _SLOW_CPU_PLATFORMS
    rank = next((rank for rank, name in enumerate(fast) if name in platform), len(fast))
    if any(name in platform for name in slow):
        rank += 1
    return 2, 0, rank, power


def names_of(handle: "cl.Device") -> str:
    """Return the names by parts of which a device is chosen."""
    name = " ".join(handle.name.split())
    return f"{name} {handle.platform.name.strip()} {handle.platform.version.strip()}"


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


@Once
def tried(index: str) -> Device:
    """Return a device of `raw_devices` with its verdict, for which it is tried if that is new."""
    handle = dict(raw_devices())[index]
    key = verdict_key(handle)
    verdict = load(key)
    if verdict is None:
        # Two processes, because compilers of OpenCL use one core.
        with ThreadPoolExecutor(1) as pool:
            further = pool.submit(run_probe, index, request=FURTHER)
            verdict = run_probe(index)
            beside = further.result()
        if not verdict.reason and beside.reason.startswith(WRONG):
            verdict = beside
        if verdict.lasting:
            save(key, verdict)
    return describe(index, handle, verdict)


@Once
def find_devices() -> tuple[Device, ...]:
    """List every OpenCL device, usable or not; all whose verdicts are unknown are tried."""
    _check_variables()
    return tuple(tried(index) for index, _ in raw_devices())


def _check_variables() -> None:
    """Report invalid values always, not only when a device is new, and as no device's fault."""
    probe_seconds()
    if raw_devices():
        # The module imports pyopencl.
        from clmorph.backends.opencl.devices.quirks import forced_quirks

        forced_quirks()


def in_order(entries: "Iterable[tuple[str, cl.Device]]") -> "list[tuple[str, cl.Device]]":
    """Return indices and devices in the order of choice, GPUs of several models by their speeds."""
    found: list[tuple[str, cl.Device]] = []
    ordered = sorted(entries, key=lambda entry: preference(entry[1]))
    for rank, group in itertools.groupby(ordered, key=lambda entry: preference(entry[1])[:-1]):
        same = list(group)
        if rank[0] == 0 and len({names_of(handle) for _, handle in same}) > 1:
            speeds = {index: tried(index).pairs_per_second for index, _ in same}
            while same:
                fast = max(speeds[index] for index, _ in same) / LEAST_RATIO
                found.append(next(entry for entry in same if speeds[entry[0]] >= fast))
                same.remove(found[-1])
        found += same
    return found


def _forget_found() -> None:
    tried.cache_clear()
    find_devices.cache_clear()


def forget_verdicts(handle: "cl.Device | None" = None) -> None:
    """Forget the verdict on a device, or all, and those on all programs: they are tried again."""
    forget(None if handle is None else verdict_key(handle))
    _forget_found()


def mark_unusable(handle: "cl.Device", reason: str) -> None:
    """Remember that a device, or a part of one, is unusable, which was found after its trial."""
    save(verdict_key(handle), Verdict(reason))
    _forget_found()


def index_of(handle: "cl.Device") -> str | None:
    """Return the index of a device, or of its whole; None if none has its name and driver."""
    identity = driver_identity(handle)
    same = [index for index, device in raw_devices() if driver_identity(device) == identity]
    return next(iter(same), None)


def choose_device(spec: str = "auto", even_wrong: bool = False) -> Device:
    """Choose the first usable device that a user means by "auto", an index or part of a name."""
    listed = raw_devices()
    if not listed:
        raise DeviceError(f"no OpenCL device was found; {_installation_hint(())}")
    _check_variables()
    meant = _meant(spec)
    refused = []
    for index, _ in in_order(meant):
        device = tried(index)
        if device.usable:
            return device
        refused.append(device)
    wrong = [device for device in refused if device.computes_wrongly]
    if even_wrong and wrong:
        return wrong[0]
    if spec not in ("auto", "opencl"):
        raise DeviceError(f"{refused[0]}; choose another device, or the backend 'numpy'")
    if value := os.environ.get("PYOPENCL_CTX"):
        raise DeviceError(f"PYOPENCL_CTX={value!r} names {refused[0]}; choose another device")
    all_refused = "; ".join(map(str, refused))
    hint = _installation_hint(tuple(refused))
    raise DeviceError(f"no OpenCL device is usable ({all_refused}); {hint}")


def _meant(spec: str) -> list[tuple[str, "cl.Device"]]:
    """Return index and handle of the devices that a specification means, at least one."""
    listed = list(raw_devices())
    if spec in ("auto", "opencl"):
        value = os.environ.get("PYOPENCL_CTX")
        named = _named_by_pyopencl_ctx(value) if value else listed
        if not named:
            raise DeviceError(
                f"PYOPENCL_CTX={value!r} names no device: expected an index or part of a name, as "
                f"of {_listing()}; unset it, or name a device with --device or CLMORPH_DEVICE"
            )
        return named
    named = [(index, handle) for index, handle in listed if is_meant(spec, index, names_of(handle))]
    if not named:
        raise DeviceError(
            f"no OpenCL device matches {spec!r}: expected an index or part of a name among "
            f"{_listing()}; or use the backend 'numpy'"
        )
    return named


def _listing() -> str:
    found = raw_devices()
    return ", ".join(f"[{index}] {' '.join(handle.name.split())}" for index, handle in found)


def _named_by_pyopencl_ctx(value: str) -> list[tuple[str, "cl.Device"]]:
    """Return the devices that a value of ``PYOPENCL_CTX`` names, perhaps none."""
    # As in pyopencl: "platform:devices", by index or part of a name, devices with commas between,
    # an empty platform for the first one; and here also a device alone.
    platform, _, devices = value.partition(":")
    platform = platform.strip() or "0"
    wanted = [part for part in devices.split(",") if part.strip()]
    found = []
    for index, handle in raw_devices():
        of_platform, _, of_device = index.partition(":")
        of_names = handle.platform.name if wanted else names_of(handle)
        if _is_named(platform, of_platform, of_names) and (
            not wanted or any(_is_named(part, of_device, handle.name) for part in wanted)
        ):
            found.append((index, handle))
    return found


def _is_named(text: str, index: str, names: str) -> bool:
    """Return whether a text is an index or, if it is no number, a part of names."""
    text = text.strip()
    return text == index if text.isdigit() else text.lower() in names.lower()


def _installation_hint(devices: tuple[Device, ...]) -> str:
    """Return advice on how to get a usable device, given the devices that were found."""
    if any("Intel" in device.platform for device in devices):
        return "update the drivers (clmorph devices --again), or use the backend 'numpy'"
    return f"{advice()[0]}; or use the backend 'numpy' (clmorph devices tells more)"


def physical_devices() -> tuple[Device, ...]:
    """Return one usable device for each piece of hardware, in the order of "auto"."""
    found: dict[Any, Device] = {}
    numbers: dict[tuple[str, str], int] = {}
    for index, handle in in_order(raw_devices()):
        name = " ".join(handle.name.split())
        same = handle.platform.name, name
        numbers[same] = numbers.get(same, -1) + 1
        hardware = hardware_of(handle, name, numbers[same])
        if hardware in found:
            continue
        device = tried(index)
        if device.usable:
            found[hardware] = device
    return tuple(found.values())


def hardware_of(handle: "cl.Device", name: str, number: int) -> tuple[Any, ...]:
    """Return a key of the hardware; `number` counts its platform's devices of this name."""
    import pyopencl as cl

    if handle.type & cl.device_type.CPU:
        return ("CPU",)
    bus = _ask(handle, "pci_bus_info_khr")
    if bus is not None:
        places = (bus.pci_domain, bus.pci_bus, bus.pci_device, bus.pci_function)
        return ("bus", *map(int, places))
    on_bus = [_ask(handle, f"pci_{part}_id_nv") for part in ("domain", "bus", "slot")]
    if on_bus[1] is not None:
        slot = int(on_bus[2] or 0)  # eight functions a device
        return ("bus", int(on_bus[0] or 0), int(on_bus[1]), slot >> 3, slot & 7)
    uuid = _ask(handle, "uuid_khr")
    if uuid is not None:
        return ("uuid", bytes(uuid))
    return ("name", name, number)


def _ask(handle: "cl.Device", what: str) -> Any:
    """Return a property of a device; None if its driver does not know it."""
    try:
        return getattr(handle, what)
    except Exception:  # drivers raise errors of several classes
        return None
