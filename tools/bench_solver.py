r"""Compare the solver with other libraries on the same points, in one run.

    pip install -e ".[cpu,bench]"
    python tools/bench_solver.py --points 1024 4096 16384 --plot solver.png

Two photographs, color weight 2, blur 0.05, reach 0.3. Every solve has a process of its own, is
run once to warm up (compilation is not counted) and then timed; each library stops by its own
rule, with its defaults. Error: |pi 1 - r|_1 / |r|_1 against the row masses r of the converged
float64 solution, which no choice of conventions can hide. For every peer, clmorph is timed at
the loosest tolerance that is at least as exact. Peak memory is what the solve adds to the
process.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import pyopencl as cl
from benching import (
    OF_KERNELS,
    CountedBuffer,
    KernelClock,
    begin_memory,
    in_own_process,
    line,
    photographs,
    print_head,
    profiled,
    resident_bytes,
)
from plain_options import COLOR_WEIGHT
from solver_peers import BLUR, EPSILON, PEERS, REACH, RHO

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.select import get_backend
from clmorph.measures.lift import lift
from clmorph.transport._solver.problem import Problem
from clmorph.transport.sinkhorn import sinkhorn

TOLERANCES = (
    10, 3, 1, 0.3, 0.1, 0.03, 0.01, 5e-3, 2e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 5e-7,
)  # fmt: skip
#: Up to so many points the truth is computed by NumPy in float64; beyond, by a device with
#: float64 exponents, to within about 2e-7.
NUMPY_POINTS = 4096


def problem(n: int):
    """Return two photographs of about n pixels as measures."""
    side = round(n**0.5)
    return [lift(image, COLOR_WEIGHT) for image in photographs((side, side))]


def clmorph_solver(operations: Operations, tol: float):
    """Return ours on a device, to a residual of `tol` epsilon."""

    def solve(source, target):
        result = sinkhorn(source, target, BLUR, REACH, tol, backend=operations)
        return result.f, result.g, result.n_iter

    return solve


# --- one solve in a process of its own ----------------------------------------------------


def measure(name: str, tol: float, n: int, file: str) -> None:
    """Solve, print what it took, and leave the potentials in a file."""
    backend = None if name in PEERS else profiled(name)
    solve = PEERS[name]() if backend is None else clmorph_solver(backend, tol)
    solve(*problem(256))
    pair = problem(n)
    if name == "OTT-JAX":
        solve(*pair)  # compiles for this size
    before = begin_memory()
    seconds = []
    while len(seconds) < 7 and sum(seconds) < 5:
        clock, began = KernelClock(backend), time.perf_counter()
        f, g, count = solve(*pair)
        seconds.append(time.perf_counter() - began)
    np.savez(file, f=f, g=g)
    record = {"seconds": float(np.median(seconds)), "iterations": count, "kernels": clock.cells()}
    print(json.dumps(record | {"memory": resident_bytes("VmHWM") - before}))


def judged(name: str, tol: float, n: int, truth, pair) -> dict:
    """Run `measure` in a process of its own and add the error."""
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "potentials.npz")
        record = in_own_process(__file__, "--measure", name, str(tol), str(n), file)
        if "failed" in record:
            return record
        potentials = np.load(file)
    f, g = potentials["f"], potentials["g"]
    solved = Problem.between(get_backend("auto"), *pair, (RHO, RHO))
    t_rows = solved.softmin(0, g, EPSILON, True)
    t_columns = solved.softmin(1, f, EPSILON, True)
    error = np.abs(solved.marginal(0, f, t_rows, EPSILON) - truth).sum() / truth.sum()
    residual = solved.residual(f, g, t_rows, t_columns, EPSILON)
    return record | {"error": float(error), "residual": residual}


def true_row_masses(pair) -> np.ndarray:
    """Return the first marginal of the converged plan."""
    best = sinkhorn(*pair, BLUR, REACH, 1e-6, backend="auto")
    if len(pair[0]) <= NUMPY_POINTS:
        best = sinkhorn(*pair, BLUR, REACH, 1e-9, backend="numpy", start=best)
    return best.row_mass


def compare(n: int, names: list[str], devices) -> list[tuple[str, int, float]]:
    """Print the table for one size; return (name, points, seconds) for the plot."""
    pair = problem(n)
    truth, n = true_row_masses(pair), len(pair[0])
    ours, plotted = {}, []
    for device in devices:
        key = device.index
        ours[key] = [judged(key, tol, n, truth, pair) | {"tol": tol} for tol in TOLERANCES]
        usual = next(run["seconds"] for run in ours[key] if run["tol"] == 1e-3)
        plotted.append((f"clmorph, {device.platform}", n, usual))
    print(f"\n{n} x {n} points\n")
    print_head(
        "library", "s", "iterations", "10⁹ pairs/s", "residual, ε", "error", "peak memory, MB",
        *OF_KERNELS, *(f"clmorph, {device.platform}: s (ratio)" for device in devices),
    )  # fmt: skip
    for name in names:
        theirs = judged(name, 0, n, truth, pair)
        if "failed" in theirs:
            print(line(name, theirs["failed"], *[""] * (7 + len(devices))), flush=True)
            continue
        cells = []
        for runs in ours.values():
            matching = next((run for run in runs if run["error"] <= theirs["error"]), None)
            if matching is None:
                cells.append("not as exact")
                continue
            ratio = theirs["seconds"] / matching["seconds"]
            cells.append(f"{matching['seconds']:.3g} ({ratio:.1f}×)")
        # GeomLoss does not report a number of iterations; that of its schedule is used.
        count = theirs["iterations"] or geomloss_iterations(pair)
        print(row(name, n, theirs | {"iterations": count}, cells), flush=True)
        plotted.append((name, n, theirs["seconds"]))
    for device, runs in zip(devices, ours.values(), strict=True):
        run = next(run for run in runs if run["tol"] == 1e-3)
        label = f"clmorph, {device.platform}, tol 10⁻³"
        print(row(label, n, run, [""] * len(devices)), flush=True)
    return plotted


def row(name: str, n: int, run: dict, more: list[str]) -> str:
    """Return the table row of a solve; each iteration is two sums over all pairs."""
    rate = 2 * run["iterations"] * n * n / run["seconds"] / 1e9
    return line(
        name, f"{run['seconds']:.3g}", run["iterations"], f"{rate:.2f}", f"{run['residual']:.1e}",
        f"{run['error']:.1e}", f"{run['memory'] / 1e6:.0f}", *run["kernels"], *more,
    )  # fmt: skip


def geomloss_iterations(pair) -> int:
    """Return the number of GeomLoss's iterations, first and last steps included."""
    from clmorph.transport._solver.problem import largest_cost
    from clmorph.transport.sinkhorn import geomloss_blurs

    diameter = (2 * largest_cost(pair[0].points, pair[1].points)) ** 0.5
    return len(geomloss_blurs(diameter, BLUR, 0.9)) + 2


def print_memory(devices) -> None:
    """Print the bytes of buffers that a solve holds at once, for growing clouds."""
    cl.Buffer = CountedBuffer
    sizes = (4096, 16384, 65536)
    print("\nLargest sum of device buffers during a solve, in bytes a point (of both clouds)\n")
    print_head("device", *(f"{n} points" for n in sizes))
    for device in devices:
        cells = []
        for n in sizes:
            CountedBuffer.most = CountedBuffer.now
            before = CountedBuffer.now
            sinkhorn(*problem(n), BLUR, REACH, 100, backend=OpenCLOperations(device.handle))
            cells.append(f"{(CountedBuffer.most - before) / (2 * n):.0f}")
        print(line(f"{device.platform} {device.driver}", *cells), flush=True)


def plot(points: list[tuple[str, int, float]], path: Path) -> None:
    """Draw seconds over points, a line for each library."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
    for name in dict.fromkeys(name for name, _, _ in points):
        own = [(n, seconds) for other, n, seconds in points if other == name]
        style = "o-" if name.startswith("clmorph") else "s--"
        axes.loglog(*zip(*own, strict=True), style, label=name, linewidth=1.5, markersize=4)
    axes.set(xlabel="points of each cloud", ylabel="seconds for one solve, each by its own rule")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[1024, 4096, 16384])
    parser.add_argument("--peers", nargs="*", default=list(PEERS), choices=list(PEERS))
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--memory", action="store_true", help="only print device memory")
    parser.add_argument("--measure", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        name, tol, n, file = options.measure
        measure(name, float(tol), int(n), file)
        return
    devices = [device for device in find_devices() if device.usable]
    if not options.memory:
        points = []
        for n in options.points:
            points += compare(n, options.peers, devices)
        if options.plot:
            plot(points, options.plot)
    print_memory(devices)


if __name__ == "__main__":
    main()
