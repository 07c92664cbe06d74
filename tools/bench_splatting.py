"""Time splatting and a whole morph on every usable device: ``python tools/bench_splatting.py``.

Prints Markdown tables: one frame beside scatter splats in PyTorch (`pip install torch`; its CPU
build is enough), its time as particles grow in number, a large canvas, and a morph stage by stage.

A scatter splat adds each particle's weight and color, times exp(-d^2 / (2 sigma^2)), to the
pixels of a square window of ceil(3 sigma) around its nearest pixel. It is written in three ways,
because PyTorch's speed depends on the layout more than on the arithmetic; the goal is against
the fastest. Ours starts from uploaded particles, theirs from tensors; both end with a frame.
"""

import argparse
import itertools
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.frames.render import CUT
from clmorph.images.pixels import as_rgb
from clmorph.pipeline.presets import PRESETS

SIGMA = 1.4
PARTICLES, SIDE = 300_000, 64
MANY, LARGE_SIDE = 5_000_000, 256
COUNTS = (75_000, 150_000, 300_000, 600_000, 1_200_000)
#: Particles that the peer takes at once where it goes offset by offset: they stay in cache.
PART = 100_000
#: What the tables are to be read against.
GOAL_RATIO, GOAL_SECONDS = 50, 2

Action = Callable[[], Any]
Devices = dict[str, OpenCLOperations]


def medians(actions: dict[str, Action], repeats: int) -> dict[str, float]:
    """Return median seconds of actions that take turns."""
    seconds: dict[str, list[float]] = {name: [] for name in actions}
    for turn, (name, action) in itertools.product(range(-2, repeats), actions.items()):
        time.sleep(0.02)  # threads of the library before spin for a while when they are done
        began = time.perf_counter()
        action()
        if turn >= 0:  # warm by then
            seconds[name].append(time.perf_counter() - began)
    return {name: float(np.median(times)) for name, times in seconds.items()}


def scene(count: int, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions in pixels, all over the canvas, with colors and weights."""
    rng = np.random.default_rng(0)
    positions = rng.random((count, 2), np.float32) * np.float32(side) - np.float32(0.5)
    return positions, rng.random((count, 3), np.float32), rng.random(count, np.float32)


def gather_splats(devices: Devices, count: int, side: int) -> dict[str, Action]:
    def frame(operations: OpenCLOperations, splats: Any) -> np.ndarray:
        numerator, denominator = operations.splat(splats, (side, side), SIGMA, CUT * SIGMA)
        return numerator / np.maximum(denominator, np.finfo(float).tiny)[..., None]

    particles = scene(count, side)
    return {
        name: partial(frame, operations, operations.upload_splats(*particles))
        for name, operations in devices.items()
    }


def scatter_splats(torch: Any, count: int, side: int) -> dict[str, Action]:
    """Return three ways to write the peer; each gives a (side, side, 3) array."""
    positions, colors, weights = map(torch.from_numpy, scene(count, side))
    radius = math.ceil(3 * SIGMA)
    # With a border no window leaves the picture, which saves masks.
    border = radius + 1
    padded = side + 2 * border
    offsets = torch.arange(-radius, radius + 1)
    payload = torch.column_stack((weights, weights[:, None] * colors))
    payload_planes = payload.T.contiguous()

    def windows(positions: Any) -> tuple[Any, Any, Any]:
        """Nearest pixel of each particle, and its kernel along x and y, offset by offset."""
        nearest = positions.round()
        distances = offsets[:, None, None] + (nearest - positions).T
        kernel = torch.exp(distances**2 * (-0.5 / SIGMA**2))
        column, row = (nearest.long() + border).T
        return row * padded + column, kernel[:, 0], kernel[:, 1]

    def offset_by_offset() -> Any:
        for first in range(0, count, PART):
            part = slice(first, first + PART)
            pixels, kernel_x, kernel_y = windows(positions[part])
            for y, x in itertools.product(range(len(offsets)), repeat=2):
                there = pixels + (offsets[y] * padded + offsets[x])
                yield part, there, kernel_y[y] * kernel_x[x]

    def divided(sums: Any) -> np.ndarray:
        inside = sums.reshape(padded, padded, 4)[border:-border, border:-border]
        return (inside[..., 1:] / inside[..., :1].clamp_min(1e-30)).numpy()

    def planes() -> np.ndarray:
        sums = torch.zeros(4, padded**2)
        for part, pixels, kernel in offset_by_offset():
            sums.scatter_add_(1, pixels.expand(4, -1), kernel * payload_planes[:, part])
        return divided(sums.T)

    def rows() -> np.ndarray:
        sums = torch.zeros(padded**2, 4)
        for part, pixels, kernel in offset_by_offset():
            sums.index_add_(0, pixels, kernel[:, None] * payload[part])
        return divided(sums)

    def at_once() -> np.ndarray:
        pixels, kernel_x, kernel_y = windows(positions)
        pixels = pixels[:, None] + (offsets[:, None] * padded + offsets).ravel()
        kernel = kernel_y.T.contiguous()[:, :, None] * kernel_x.T.contiguous()[:, None]
        values = (kernel.reshape(count, -1, 1) * payload[:, None]).reshape(-1, 4)
        sums = torch.zeros(padded**2, 4)
        return divided(sums.scatter_add_(0, pixels.reshape(-1, 1).expand(-1, 4), values))

    return {
        "PyTorch, all offsets at once": at_once,
        "PyTorch, offset by offset, (K, 4)": rows,
        "PyTorch, offset by offset, (4, K)": planes,
    }


def table(title: str, *columns: str) -> None:
    print(f"\n**{title}**\n\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")


def compare(devices: Devices, torch: Any, repeats: int) -> None:
    actions = gather_splats(devices, PARTICLES, SIDE)
    if torch is not None:
        actions |= scatter_splats(torch, PARTICLES, SIDE)
    seconds = medians(actions, repeats)
    frames = {name: action() for name, action in actions.items()}
    title = f"{PARTICLES} particles, σ {SIGMA}, {SIDE}×{SIDE}; goal: {GOAL_RATIO} ×"
    table(title, "what", "ms", *(f"over {name} (largest difference)" for name in devices))
    for name in actions:
        cells = [
            f"{seconds[name] / seconds[device]:.1f} × "
            f"({np.abs(frames[name] - frames[device]).max():.0e})"
            for device in devices
        ]  # fmt: skip
        print(f"| {name} | {1e3 * seconds[name]:.1f} | {' | '.join(cells)} |")


def growth(devices: Devices, counts: tuple[int, ...], repeats: int) -> None:
    title = f"By number of particles, σ {SIGMA}, {SIDE}×{SIDE}: ms (ns a particle)"
    table(title, "particles", *devices)
    for count in counts:
        seconds = medians(gather_splats(devices, count, SIDE), repeats).values()
        print(f"| {count} |", *(f"{1e3 * s:.1f} ({1e9 * s / count:.0f}) |" for s in seconds))


def large(devices: Devices, torch: Any, repeats: int) -> None:
    actions = gather_splats(devices, MANY, LARGE_SIDE)
    if torch is not None:
        # The fastest; taking all offsets at once would not fit into memory.
        name, planes = scatter_splats(torch, MANY, LARGE_SIDE).popitem()
        actions[name] = planes
    table(f"{MANY} particles, σ {SIGMA}, {LARGE_SIDE}×{LARGE_SIDE}", "what", "ms", "ns a particle")
    for name, s in medians(actions, repeats).items():
        print(f"| {name} | {1e3 * s:.0f} | {1e9 * s / MANY:.0f} |")


def morphs(devices: Devices, repeats: int) -> None:
    from skimage.data import astronaut, chelsea

    crops = chelsea()[:, 85:385], astronaut()[50:450, 50:450]
    images = [clmorph.fit(as_rgb(crop), SIDE) for crop in crops]
    parameters: dict[str, Any] = {**PRESETS["paper"].options, "size": None}
    stages = [f"{stage}, s" for stage in ("transport", "plan", "particles", "frames", "all")]
    title = f"A morph of {SIDE}×{SIDE} photographs, preset paper; goal: {GOAL_SECONDS} s"
    table(title, "device", *stages, "particles", "frames")
    for name, operations in devices.items():
        runs = []
        for _ in range(repeats + 1):
            marks: dict[tuple[str, float], float] = {}
            began = time.perf_counter()
            result = clmorph.morph(
                *images, backend=operations, **parameters,
                progress=lambda *stage: marks.update({stage: time.perf_counter()}),  # noqa: B023
            )  # fmt: skip
            planned = time.perf_counter()
            frames = result.frames
            ended = time.perf_counter()
            marked = began, marks["plan", 0.0], marks["plan", 1.0], planned, ended
            runs.append([*np.diff(marked), ended - began])
        cells = [f"{s:.3f}" for s in np.median(runs[1:], axis=0)]  # the first builds kernels
        print(f"| {name} | {' | '.join(cells)} | {len(result.particles)} | {len(frames)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument("--device", help="part of a device's or platform's name, or an index")
    parser.add_argument("--quick", action="store_true", help="few repeats, no large tables")
    options = parser.parse_args()
    repeats = min(3, options.repeats) if options.quick else options.repeats
    found = [device for device in find_devices() if device.usable]
    found = [device for device in found if not options.device or device.matches(options.device)]
    if not found:
        parser.error("no usable OpenCL device; `clmorph devices` tells why")
    devices = {f"{each.platform} [{each.index}]": OpenCLOperations(each.handle) for each in found}
    print(*found, sep="\\\n")
    try:
        import torch
    except ImportError:
        torch = None
        print("\nPyTorch is missing (pip install torch): only clmorph is timed.")
    else:
        print(f"\nPyTorch {torch.__version__}, CPU, {torch.get_num_threads()} threads.")
    compare(devices, torch, repeats)
    growth(devices, COUNTS[:3] if options.quick else COUNTS, repeats)
    if not options.quick:
        large(devices, torch, min(3, repeats))
    morphs(devices, min(5, repeats))


if __name__ == "__main__":
    main()
