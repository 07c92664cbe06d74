"""The build constants that `clmorph tune` found for a device, kept in the user's cache folder."""

from dataclasses import replace

import pyopencl as cl

from clmorph.backends.opencl.build.constants import BuildConstants, apply_quirks, choose_constants
from clmorph.backends.opencl.devices.cache import forget_cached, load_record, save_record
from clmorph.backends.opencl.devices.quirks import find_quirks
from clmorph.backends.opencl.devices.verdicts import device_key

#: The constants that tuning tries, one after the other, and their values.
CANDIDATES: dict[str, tuple[int, ...]] = {
    "width": (1, 2, 4, 8, 16),
    "exp2_builtin": (0, 1),
    "group": (1, 16, 32, 64, 128, 256),
    "tile": (32, 64, 128),  # larger tiles have larger rounding errors, see ``sums.cl``
    "unroll": (4, 8, 16, 32),
    "rows": (1, 2, 4, 8),
}


def is_possible(constants: BuildConstants, largest_group: int) -> bool:
    """Return whether kernels can be built: groups are within the limit and divide tiles."""
    return (
        constants.group <= largest_group
        and constants.tile in CANDIDATES["tile"]
        and constants.tile % (constants.width * constants.group) == 0
        and constants.tile % constants.unroll == 0
        and (constants.rows == 1 or constants.width < constants.rows <= constants.group_rows)
    )


def save_tuning(device: cl.Device, best: BuildConstants, start: BuildConstants) -> None:
    """Save the constants that tuning has changed since `start`."""
    entry = {
        name: getattr(best, name)
        for name in CANDIDATES
        if getattr(best, name) != getattr(start, name)
    }
    save_record(_record(device), entry)


def forget_tuning(device: cl.Device) -> None:
    """Forget tuned constants, so that those for the kind of device are used again."""
    forget_cached(f"{_record(device)}.json")


def tuned_constants(device: cl.Device) -> BuildConstants:
    """Return the constants for a device, tuned or else chosen for its kind, with its quirks."""
    constants = choose_constants(device)
    entry = load_record(_record(device))
    if not entry:
        return constants
    # True and 16.0 are equal to integer candidates, but would be different text for the compiler.
    valid = all(
        type(value) is int and value in CANDIDATES.get(name, ()) for name, value in entry.items()
    )
    tuned = replace(constants, **entry) if valid else constants
    tuned = apply_quirks(tuned, find_quirks(device))
    return tuned if is_possible(tuned, int(device.max_work_group_size)) else constants


def _record(device: cl.Device) -> str:
    """Return the name of a device's record in the cache."""
    return f"tuning/{device_key(device)}"
