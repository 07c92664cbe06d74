"""One device for each piece of hardware, however many drivers list it."""

from typing import TYPE_CHECKING, Any

from clmorph.backends.opencl.devices.device import Device
from clmorph.backends.opencl.devices.find import in_order, raw_devices, tried

if TYPE_CHECKING:
    import pyopencl as cl


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
