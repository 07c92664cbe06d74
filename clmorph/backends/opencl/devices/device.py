"""A device as its driver announces it, its verdict, and its place in the order of choice."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clmorph.backends.opencl.devices.verdicts import WRONG

if TYPE_CHECKING:
    import pyopencl as cl

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


def describe(index: str, device: "cl.Device", verdict: dict[str, Any]) -> Device:
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
        usable=bool(verdict["usable"]),
        reason=str(verdict["reason"]),
        pairs_per_second=float(verdict["pairs_per_second"]),
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
