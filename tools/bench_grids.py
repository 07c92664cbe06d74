"""Time transport between two bells on grids of 64^3 to 256^3 cells, and its memory.

    python tools/bench_grids.py --device intel
    python tools/bench_grids.py --device intel --sides 64 128 --balanced
    python tools/bench_grids.py --device intel --barycenter

Each solve and the displacement field after it, or the barycenter, have a process of their own. Both
bells are Gaussians of 0.08 and 0.1 of the side, 0.33 apart, at blur 0.05 and reach 0.3 of the side.
"""

import argparse
import json
import time
from typing import Any

import numpy as np
from benching import OF_KERNELS, KernelClock, in_own_process, print_head, profiled, resident_bytes
from benching import line as row

import clmorph


def bell(side: int, middle: tuple[float, ...], width: float) -> clmorph.Grid:
    """Return a Gaussian of mass 1 in the unit cube."""
    x = (np.arange(side) + 0.5) / side
    masses = np.ones(())
    for m in middle:
        masses = np.multiply.outer(masses, np.exp(-0.5 * ((x - m) / width) ** 2))
    return clmorph.grid_measure(masses / masses.sum(), 1 / side)


def measure(side: int, device: str, reach: float | None) -> dict[str, Any]:
    """Solve one problem, and return what it took."""
    source = bell(side, (0.3, 0.4, 0.5), 0.08)
    target = bell(side, (0.6, 0.5, 0.6), 0.1)
    backend = profiled(device)
    clmorph.sinkhorn(bell(8, (0.5,) * 3, 0.2), bell(8, (0.5,) * 3, 0.2), 0.1, backend=backend)
    clock, began = KernelClock(backend), time.perf_counter()
    solved = clmorph.sinkhorn(source, target, 0.05, reach, backend=backend)
    ended, kernels = time.perf_counter(), clock.cells()
    moved = clmorph.displacement_field(source, target, solved, backend=backend)
    return {
        "iterations": solved.n_iter, "solve": ended - began, "gap": solved.gap,
        "field": time.perf_counter() - ended, "memory": resident_bytes("VmHWM"),
        "length": moved.mean, "kernels": kernels,
    }  # fmt: skip


def measure_barycenter(side: int, device: str, reach: float | None) -> dict[str, Any]:
    """Find the barycenter of both bells, to a residual of 1 %, and return what it took."""
    bells = [bell(side, (0.3, 0.4, 0.5), 0.08), bell(side, (0.6, 0.5, 0.6), 0.1)]
    backend = profiled(device)
    clock, began = KernelClock(backend), time.perf_counter()
    found = clmorph.barycenter(
        bells, blur=0.05, reach=reach, fixed=True, tol=0.01, max_iter=40, backend=backend
    )
    return {
        "iterations": found.n_iter, "solve": time.perf_counter() - began, "field": np.nan,
        "gap": found.residual, "memory": resident_bytes("VmHWM"), "length": found.mass,
        "kernels": clock.cells(),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--device", default="auto", help="a backend [default: auto]")
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--balanced", action="store_true", help="without a reach")
    parser.add_argument("--barycenter", action="store_true", help="its residual is the gap then")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        run = measure_barycenter if given.barycenter else measure
        print(json.dumps(run(given.sides[0], given.device, None if given.balanced else 0.3)))
        return 0
    titles = "cells", "iterations", "s an iteration", "solve, s", "field, s", "gap", "memory, GB"
    print_head(*titles, *OF_KERNELS)
    for side in given.sides:
        options = ["--balanced"] * given.balanced + ["--barycenter"] * given.barycenter
        found = in_own_process(
            __file__, "--one", "--device", given.device, "--sides", str(side), *options
        )
        if "failed" in found:
            print(row(f"{side}³", found["failed"]))
            continue
        print(row(
            f"{side}³", found["iterations"], f"{found['solve'] / found['iterations']:.2g}",
            f"{found['solve']:.3g}", f"{found['field']:.3g}", f"{found['gap']:.1g}",
            f"{found['memory'] / 1e9:.2g}", *found["kernels"],
        ), flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
