"""Search for the fastest build constants of a device by timing, and keep them."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace

import pyopencl as cl

from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import BuildConstants, choose_constants
from clmorph.backends.opencl.build.tuned_record import CANDIDATES, is_possible, save_tuning
from clmorph.backends.opencl.build.variants import usual_variants
from clmorph.backends.opencl.devices.throughput import throughput
from clmorph.errors import ClmorphError

#: The least gain in speed for which a constant is changed; smaller ones may be noise.
LEAST_GAIN = 0.03
#: The least number of points of each cloud in a trial.
POINTS = 4096


def variants(constants: BuildConstants, name: str, largest_group: int) -> Iterator[BuildConstants]:
    """Yield constants with another value of one of them, and adapt others that depend on it."""
    for value in CANDIDATES[name]:
        other = replace(constants, **{name: value})
        if name == "group":
            other = replace(other, tile=max(other.tile, other.width * other.group))
        elif other.tile % (other.width * other.group):
            other = replace(other, group=max(1, other.tile // other.width))
        if not is_possible(other, largest_group):
            other = replace(other, rows=1)
        if other != constants and is_possible(other, largest_group):
            yield other


def tune(device: cl.Device, tell: Callable[[str], None]) -> tuple[BuildConstants, float, float]:
    """Time constants, tell each trial, keep the best; return them, and pairs/s before and after."""
    largest = int(device.max_work_group_size)
    best = start = choose_constants(device)
    before = after = _speed(device, best)
    slower: list[tuple[BuildConstants, float]] = []
    tell(f"{before / 1e9:6.2f}·10⁹ pairs/s without tuning")
    tried, settled = {best}, None
    # A change may make one of an earlier constant worth while.
    while settled != best:
        settled = best
        for name in CANDIDATES:
            for other in list(variants(best, name, largest)):
                if other in tried:
                    continue
                tried.add(other)
                try:
                    speed = _speed(device, other)
                except ClmorphError:
                    continue  # this device cannot build the kernels with these constants
                changed = {
                    key: value for key, value in asdict(other).items() if value != asdict(best)[key]
                }
                tell(f"{speed / 1e9:6.2f}·10⁹ pairs/s with {changed}")
                if speed > after * (1 + LEAST_GAIN):
                    slower.append((best, after))
                    best, after = other, speed
    while best != start and not _is_right(device, best, tell):
        best, after = slower.pop()
    save_tuning(device, best, start)
    return best, before, after


def _is_right(device: cl.Device, constants: BuildConstants, tell: Callable[[str], None]) -> bool:
    """Return whether the programs that most morphs use pass their checks with these constants."""
    programs = OpenCLOperations(device, constants).programs
    try:
        for variant in usual_variants():
            if variant.suits(constants):
                programs.verify(variant)
    except ClmorphError as error:
        tell(f"  not used: {error}")
        return False
    return True


def _speed(device: cl.Device, constants: BuildConstants) -> float:
    """Return the point pairs per second by the device's own clock."""
    return throughput(OpenCLOperations(device, constants, verify=False, profiled=True), POINTS)
