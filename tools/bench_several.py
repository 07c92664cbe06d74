"""Measure what it costs, and what it gains, to divide work over devices.

    python tools/bench_several.py --device pocl
    POCL_MAX_PTHREAD_COUNT=1 python tools/bench_several.py --device 0:0 --beside 1:0

The first command cuts a CPU into two parts by OpenCL's sub-devices, and runs the same work on the
whole device, on one part, and on both parts as one backend. PoCL 3.1 and Intel's runtime run a part
on all cores (the tool says how many threads worked), so both parts can at best be as fast as the
whole device, and the difference is the cost. The second command divides the work over two devices:
with one thread each, as here, they are like two devices with processors of their own. Shares are
those by the recorded speeds.

The three take turns, because other work on the machine disturbs them alike. The table has the
median (best) time, and the least processor time, which counts all threads and does not grow while
the machine does other work.
"""

import argparse
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl

import clmorph
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import choose_device
from clmorph.backends.several import SeveralDevices
from clmorph.backends.several.shares import recorded_shares
from clmorph.backends.several.threads import Workers

BLUR, REACH = 0.05, 0.3
SIZES = (1024, 4096, 16384)
#: Sides of the pictures of a morph, and its number of frames.
SIDE, FRAMES = 64, 24
#: Number of empty tasks that are timed together.
EMPTY = 1000

Action = Callable[[], Any]


class Timing(NamedTuple):
    """Milliseconds: median and best time, and the least processor time."""

    median: float
    best: float
    processor: float


def timings(actions: list[Action], repeats: int) -> list[Timing]:
    """Time actions that take turns."""
    seconds: list[list[tuple[float, float]]] = [[] for _ in actions]
    for turn, (place, action) in itertools.product(range(-1, repeats), enumerate(actions)):
        began = time.perf_counter(), time.process_time()
        action()
        if turn >= 0:
            seconds[place].append((time.perf_counter() - began[0], time.process_time() - began[1]))
    found = []
    for own in seconds:
        wall, processor = 1e3 * np.array(own).T
        found.append(Timing(float(np.median(wall)), float(wall.min()), float(processor.min())))
    return found


def picture(side: int, phase: float) -> Any:
    """Return a smooth picture."""
    y, x = np.mgrid[:side, :side] / side
    waves = [np.sin(5 * x + k * y + phase) * np.cos(3 * y - k * phase) for k in (1, 3, 6)]
    return 0.5 + 0.5 * np.stack(waves, axis=-1)


def softmin(operations: Operations, n: int) -> Action:
    """Return a log-sum-exp over all pairs of n points, without the upload."""
    rng = np.random.default_rng(0)
    cloud, potential = operations.upload(rng.random((n, 5)), np.full(n, 1 / n)), np.zeros(n)
    return lambda: operations.softmin(cloud, cloud, potential, BLUR**2)


def solve(operations: Operations, n: int) -> Action:
    """Return a solve between two pictures of n pixels, with the upload."""
    images = [clmorph.lift(picture(round(n**0.5), phase)) for phase in (0.0, 1.0)]
    return lambda: clmorph.sinkhorn(*images, blur=BLUR, reach=REACH, backend=operations)


def frames(operations: Operations) -> Action:
    """Return the rendering of all frames of a morph, after the correction of its ends."""
    images = [picture(SIDE, phase) for phase in (0.0, 1.0)]
    morph = clmorph.morph(*images, n_frames=FRAMES, backend=operations)
    return lambda: sum(1 for _ in morph.iter_frames())


def working_threads(action: Action) -> int | None:
    """Return how many threads of this process did notable work; None if the system hides it."""

    def ticks() -> dict[str, int]:
        stats = [task / "stat" for task in Path("/proc/self/task").iterdir()]
        fields = {file: file.read_text().rsplit(")", 1)[1].split() for file in stats}
        return {str(file): int(found[11]) + int(found[12]) for file, found in fields.items()}

    try:
        before = ticks()
        for _ in range(4):
            action()
        work = np.array([count - before.get(name, 0) for name, count in ticks().items()])
    except OSError:
        return None
    return int((work > 0.2 * work.max()).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto", help="the first device, or the one to cut")
    parser.add_argument("--beside", help="a second device, in place of parts of the first")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--points", type=int, nargs="+", default=SIZES)
    options = parser.parse_args()
    device = choose_device(options.device).handle
    whole = OpenCLOperations(device)
    if options.beside is None:
        equally = cl.device_partition_property.EQUALLY
        if equally not in device.partition_properties or device.max_compute_units < 2:
            parser.error("the device has no two parts: choose another one, or --beside")
        parts = device.create_sub_devices([equally, 1])[:2]
        ones = [OpenCLOperations(part) for part in parts]
        names = "whole device", "one part", "two parts"
        backends: list[Operations] = [whole, ones[0], SeveralDevices(ones)]
    else:
        other = OpenCLOperations(choose_device(options.beside).handle)
        names = "first", "second", "both"
        pair = [whole, other]
        backends = [*pair, SeveralDevices(pair, recorded_shares(pair))]
    for name, own in zip(names, backends, strict=True):
        threads = working_threads(softmin(own, max(options.points)))
        print(f"{name}: {own.description}; {threads or 'unknown number of'} threads work")
    columns = [f"{name}: ms, processor" for name in names]
    print(f"\n| work | {' | '.join(columns)} | {names[2]} / {names[0]} | processor |")
    print("|---|---|---|---|---|---|")
    kinds = [("softmin", softmin, options.repeats), ("solve", solve, -(-options.repeats // 3))]
    for (name, kind, repeats), n in itertools.product(kinds, options.points):
        show(f"{name}, {n} points", timings([kind(own, n) for own in backends], repeats))
    label = f"{FRAMES} frames, {SIDE}×{SIDE} pixels"
    show(label, timings([frames(own) for own in backends], 5))

    workers = Workers(1)
    nothing = timings([lambda: empty(workers)], options.repeats)[0]
    print(f"\nTwo threads for no work: {1e3 * nothing.median / EMPTY:.0f} µs")


def show(label: str, found: list[Timing]) -> None:
    """Print a row of the table, with the ratios of the last column to the first."""
    cells = [f"{own.median:.1f} ({own.best:.1f}), {own.processor:.1f}" for own in found]
    first, *_, last = found
    ratios = f"{last.best / first.best:.2f} | {last.processor / first.processor:.2f}"
    print(f"| {label} | {' | '.join(cells)} | {ratios} |", flush=True)


def empty(workers: Workers) -> None:
    """Let two threads do nothing, `EMPTY` times."""
    for _ in range(EMPTY):
        workers.run_at_once([int, int])


if __name__ == "__main__":
    main()
