"""Time softmins and solves of points with many coordinates, such as principal components of cells.

    python tools/bench_dimensions.py --device intel
    python tools/bench_dimensions.py --device intel --solve 50000
    python tools/bench_dimensions.py --device intel --points 4096 8192 --geomloss

Two Gaussian clouds whose squared distances are about 1 in any dimension, uniform weights, blur 0.3,
reach 1. "Pairs a second" are those of one softmin in float32 by the device's own clock, the best of
five; the ratio is to the first dimension. `--solve` solves with so many points of 30 coordinates,
to a residual of 10^-3 epsilon, and tells the memory that this adds. `--geomloss` solves with that
library as well (PyTorch on the CPU, its scaling 0.9, tensorized), which has no convergence test.
"""

import argparse
import time

import numpy as np
from benching import (
    OF_KERNELS,
    KernelClock,
    begin_memory,
    line,
    print_head,
    profiled,
    resident_bytes,
)

import clmorph
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.devices.throughput import seconds_of

BLUR, REACH = 0.3, 1.0


def clouds(count: int, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points of two clouds."""
    rng = np.random.default_rng(dimension)
    x, y = rng.normal(size=(2, count, dimension)) / (2 * dimension) ** 0.5
    return x, y + 0.2 / dimension**0.5


def pairs_a_second(backend: Operations, count: int, dimension: int) -> float:
    """Return the speed of a softmin."""
    weights = np.full(count, 1 / count)
    rows, columns = (backend.upload(points, weights) for points in clouds(count, dimension))

    def run() -> None:
        backend.softmin(rows, columns, np.zeros(count), BLUR**2)

    run()
    return count**2 / min(seconds_of(backend, run) for _ in range(5))


def geomloss(x: np.ndarray, y: np.ndarray) -> float:
    """Return the seconds of GeomLoss."""
    import torch
    from geomloss import SamplesLoss

    loss = SamplesLoss(
        "sinkhorn", p=2, blur=BLUR, reach=REACH, scaling=0.9, debias=False, potentials=True,
        backend="tensorized",
    )  # fmt: skip
    tensors = [torch.tensor(points, dtype=torch.float32) for points in (x, y)]
    began = time.perf_counter()
    loss(*tensors)
    return time.perf_counter() - began


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto", help="a backend [default: auto]")
    parser.add_argument("--points", type=int, nargs="+", default=[4096])
    parser.add_argument("--dimensions", type=int, nargs="+", default=[5, 12, 30, 64, 128, 1024])
    parser.add_argument("--solve", type=int, nargs="*", default=[])
    parser.add_argument("--geomloss", action="store_true")
    given = parser.parse_args()
    backend = profiled(given.device)
    print(f"{backend.description}\n")
    if not (given.geomloss or given.solve):
        print_head("points", "coordinates", "pairs a second", "ratio")
        for count in given.points:
            first = 0.0
            for dimension in given.dimensions:
                speed = pairs_a_second(backend, count, dimension)
                first = first or speed
                print(line(count, dimension, f"{speed:.2g}", f"{speed / first:.2f}"), flush=True)
        return 0
    dimension = 30
    clmorph.sinkhorn(*clouds(100, dimension), BLUR, REACH, backend=backend)  # kernels are built
    print_head(
        "points",
        "coordinates",
        "solve, s",
        "iterations",
        "residual",
        "gap",
        "MB",
        "GeomLoss, s",
        *OF_KERNELS,
    )
    for count in given.solve or given.points:
        x, y = clouds(count, dimension)
        before = begin_memory()
        clock, began = KernelClock(backend), time.perf_counter()
        found = clmorph.sinkhorn(x, y, BLUR, REACH, backend=backend)
        seconds = time.perf_counter() - began
        memory = (resident_bytes("VmHWM") - before) / 1e6
        theirs = f"{geomloss(x, y):.3g}" if given.geomloss else ""
        cells = f"{seconds:.3g}", found.n_iter, f"{found.residual:.1e}", f"{found.gap:.1e}"
        print(line(count, dimension, *cells, f"{memory:.0f}", theirs, *clock.cells()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
