"""The recorded speed of a device, by which several devices share their work."""

from typing import TYPE_CHECKING

from clmorph.backends.opencl.devices.cache import forget_cached, save_record
from clmorph.backends.opencl.devices.verdicts import load_verdict, verdict_key

if TYPE_CHECKING:
    import pyopencl as cl

#: The folder of the records in the cache, and the entry of a record.
FOLDER, ENTRY = "speeds", "pairs_per_second"


def record_key(device: "cl.Device") -> str:
    """Return the name of a device's record: its verdict's, and how many compute units it has.

    A part of a device has the verdict of the whole.
    """
    return f"{verdict_key(device)}-{device.max_compute_units}"


def probed_speed(device: "cl.Device") -> float:
    """Return point pairs per second as the probe has measured them; 0 if it has not."""
    if _is_part(device):
        return 0.0
    verdict = load_verdict(verdict_key(device)) or {}
    return float(verdict.get("pairs_per_second", 0.0))


def save_speed(device: "cl.Device", pairs_per_second: float) -> None:
    """Keep the speed that tuning has reached."""
    save_record(f"{FOLDER}/{record_key(device)}", {ENTRY: pairs_per_second})


def forget_speed(device: "cl.Device") -> None:
    """Forget the record of a device's speed, so that the next use makes a new one."""
    forget_cached(f"{FOLDER}/{record_key(device)}.json")


def _is_part(device: "cl.Device") -> bool:
    """Return whether a device is a part of another one."""
    import pyopencl as cl

    try:
        return device.parent_device is not None
    except cl.Error:  # OpenCL 1.1 has no parts
        return False
