"""Find the fastest build-time constants for a device by trying, and remember them."""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace

import numpy as np
import pyopencl as cl

from clmorph.backends.opencl.build.constants import Knobs, apply_quirks, choose_knobs
from clmorph.backends.opencl.devices.cache import forget_cached, load_record, save_record
from clmorph.backends.opencl.devices.quirks import find_quirks
from clmorph.backends.opencl.devices.verdicts import verdict_key
from clmorph.errors import ClmorphError

#: Constants that are tried, one after the other, and their values.
CANDIDATES: dict[str, tuple[int, ...]] = {
    "width": (1, 2, 4, 8, 16),
    "exp2_builtin": (0, 1),
    "group": (1, 16, 32, 64, 128, 256),
    "tile": (32, 64, 128),  # larger ones are less exact, see `Reductions`
    "unroll": (4, 8, 16, 32),
}
#: A change must gain this share of the time, or it is noise.
LEAST_GAIN = 0.03
#: Points of each cloud in a trial, and its repetitions.
POINTS, REPEATS = 4096, 7


def is_possible(knobs: Knobs, largest_group: int) -> bool:
    """Whether the kernels can be built so: work-groups cover whole tiles, and exist."""
    return (
        knobs.group <= largest_group
        and knobs.tile in CANDIDATES["tile"]
        and knobs.tile % (knobs.width * knobs.group) == 0
        and knobs.tile % knobs.unroll == 0
    )


def variants(knobs: Knobs, name: str, largest_group: int) -> Iterator[Knobs]:
    """Yield what a constant could be instead; others follow where they must."""
    for value in CANDIDATES[name]:
        other = replace(knobs, **{name: value})
        if name in ("width", "tile") and other.tile % (other.width * other.group):
            other = replace(other, group=max(1, other.tile // other.width))
        if name == "group" and other.tile < other.width * other.group:
            other = replace(other, tile=other.width * other.group)
        if other != knobs and is_possible(other, largest_group):
            yield other


def tune(device: cl.Device, tell: Callable[[str], None]) -> tuple[Knobs, float, float]:
    """Try constants on a device and remember the best in the user's cache folder.

    Parameters
    ----------
    device : pyopencl.Device
    tell : callable
        Called with a line for every trial.

    Returns
    -------
    knobs : Knobs
    before, after : float
        Point pairs per second through the log-sum-exp.
    """
    largest = int(device.max_work_group_size)
    best = start = choose_knobs(device)
    before = after = _speed(device, best)
    tell(f"{before / 1e9:6.2f}·10⁹ pairs/s without tuning")
    for name in CANDIDATES:
        for other in list(variants(best, name, largest)):
            try:
                speed = _speed(device, other)
            except ClmorphError:
                continue  # this device cannot build it so
            changed = {
                key: value for key, value in asdict(other).items() if value != asdict(best)[key]
            }
            tell(f"{speed / 1e9:6.2f}·10⁹ pairs/s with {changed}")
            if speed > after * (1 + LEAST_GAIN):
                best, after = other, speed
    names = tuple(CANDIDATES)
    entry = {
        name: getattr(best, name) for name in names if getattr(best, name) != getattr(start, name)
    }
    save_record(_record(device), entry)
    return best, before, after


def forget_tuning(device: cl.Device) -> None:
    """Go back to the constants chosen by the kind of device."""
    forget_cached(f"{_record(device)}.json")


def tuned_knobs(device: cl.Device) -> Knobs:
    """Return the constants for a device: as tuned, else by its kind; quirks obeyed."""
    knobs = choose_knobs(device)
    entry = load_record(_record(device))
    if not entry:
        return knobs
    # True and 16.0 equal numbers among the candidates, but are other text to a compiler.
    valid = all(
        type(value) is int and value in CANDIDATES.get(name, ()) for name, value in entry.items()
    )
    tuned = replace(knobs, **entry) if valid else knobs
    tuned = apply_quirks(tuned, find_quirks(device))
    return tuned if is_possible(tuned, int(device.max_work_group_size)) else knobs


def _record(device: cl.Device) -> str:
    """Return the name of a device's record in the cache."""
    return f"tuning/{verdict_key(device)}"


def _speed(device: cl.Device, knobs: Knobs) -> float:
    """Point pairs per second: the median of a few."""
    from clmorph.backends.opencl.backend import OpenCLOperations

    operations = OpenCLOperations(device, knobs)
    rng = np.random.default_rng(0)
    cloud = operations.upload(rng.random((POINTS, 5)), np.full(POINTS, 1 / POINTS))
    potential, seconds = np.zeros(POINTS), []
    for _ in range(REPEATS + 1):
        began = time.perf_counter()
        operations.softmin(cloud, cloud, potential, 0.01)
        seconds.append(time.perf_counter() - began)
    return float(POINTS**2 / np.median(seconds[1:]))
