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
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from plain_options import COLOR_WEIGHT

from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.select import get_backend
from clmorph.measures.lift import lift
from clmorph.transport._solver.problem import Problem
from clmorph.transport.sinkhorn import sinkhorn

BLUR, REACH = 0.05, 0.3
EPSILON, RHO = BLUR**2, REACH**2
TOLERANCES = (
    10, 3, 1, 0.3, 0.1, 0.03, 0.01, 5e-3, 2e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 5e-7,
)  # fmt: skip
#: Up to so many points the truth is computed by NumPy in float64; beyond, by a device with
#: float64 exponents, to within about 2e-7.
NUMPY_POINTS = 4096


def problem(n: int):
    """Return two photographs of about n pixels as measures."""
    from skimage import data
    from skimage.transform import resize

    side = round(n**0.5)
    images = data.astronaut()[50:450, 50:450], data.chelsea()[:, 75:375]
    return [
        lift(resize(image / 255, (side, side), anti_aliasing=True), COLOR_WEIGHT)
        for image in images
    ]


# --- peers: each returns a function that solves, and gives f, g (ours: the plan is
# exp((f + g - C) / epsilon) a b) and its number of iterations ------------------------------


def geomloss(backend: str):
    """GeomLoss, at the paper's scaling."""
    import torch
    from geomloss import SamplesLoss

    loss = SamplesLoss(
        "sinkhorn", p=2, blur=BLUR, reach=REACH, scaling=0.9, debias=False, potentials=True,
        backend=backend,
    )  # fmt: skip

    def solve(source, target):
        tensors = [
            torch.tensor(array, dtype=torch.float32)[None] if backend == "tensorized"
            else torch.tensor(array, dtype=torch.float32)
            for array in (source.weights, source.points, target.weights, target.points)
        ]  # fmt: skip
        f, g = loss(*tensors)
        return f.numpy().ravel().astype(float), g.numpy().ravel().astype(float), None

    return solve


def pot(method: str):
    """POT, with the cost of ours (so with our epsilon and rho)."""
    import ot

    def solve(source, target):
        cost = 0.5 * ot.dist(source.points, target.points)
        _, log = ot.unbalanced.sinkhorn_unbalanced(
            source.weights, target.weights, cost, EPSILON, RHO, method=method, reg_type="kl",
            log=True,
        )  # fmt: skip
        return EPSILON * log["logu"], EPSILON * log["logv"], len(log["err"])

    return solve


def ott():
    """OTT-JAX on a point cloud, float32.

    Its entropy is taken against the counting measure; for uniform weights 1 / N that is KL
    against a x b once masses are scaled by N^(-epsilon / rho).
    """
    import jax
    import jax.numpy as jnp
    from ott.geometry.pointcloud import PointCloud
    from ott.problems.linear.linear_problem import LinearProblem
    from ott.solvers.linear.sinkhorn import Sinkhorn

    tau = RHO / (RHO + EPSILON)

    @jax.jit
    def run(x, y, a, b):
        geometry = PointCloud(x, y, epsilon=2 * EPSILON)
        out = Sinkhorn()(LinearProblem(geometry, a, b, tau_a=tau, tau_b=tau))
        return out.f, out.g, out.n_iters

    def solve(source, target):
        n, m = len(source), len(target)
        arguments = [jnp.asarray(part, jnp.float32) for part in (
            source.points, target.points, source.weights * n ** (-EPSILON / RHO),
            target.weights * m ** (-EPSILON / RHO),
        )]  # fmt: skip
        f, g, count = (np.asarray(part, float) for part in run(*arguments))
        return f / 2 + EPSILON * np.log(n), g / 2 + EPSILON * np.log(m), int(count)

    return solve


PEERS = {
    "GeomLoss tensorized": lambda: geomloss("tensorized"),
    "GeomLoss online": lambda: geomloss("online"),
    "OTT-JAX": ott,
    "POT translation invariant": lambda: pot("sinkhorn_translation_invariant"),
    "POT sinkhorn": lambda: pot("sinkhorn"),
}


def clmorph_solver(device: str, tol: float):
    """Return ours on a device, to a residual of `tol` epsilon."""
    operations = get_backend(device)

    def solve(source, target):
        result = sinkhorn(source, target, BLUR, REACH, tol, backend=operations)
        return result.f, result.g, result.n_iter

    return solve


# --- one solve in a process of its own ----------------------------------------------------


def resident_bytes(which: str) -> int:
    """Return the resident size of this process, now ("VmRSS") or at its largest ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(row.split()[1] for row in lines if row.startswith(which)))


def measure(name: str, tol: float, n: int, file: str) -> None:
    """Solve, print what it took, and leave the potentials in a file."""
    solve = PEERS[name]() if name in PEERS else clmorph_solver(name, tol)
    solve(*problem(256))
    pair = problem(n)
    if name == "OTT-JAX":
        solve(*pair)  # compiles for this size
    Path("/proc/self/clear_refs").write_text("5")  # the largest size so far is forgotten
    before = resident_bytes("VmRSS")
    seconds = []
    while len(seconds) < 7 and sum(seconds) < 5:
        began = time.perf_counter()
        f, g, count = solve(*pair)
        seconds.append(time.perf_counter() - began)
    np.savez(file, f=f, g=g)
    record = {"seconds": float(np.median(seconds)), "iterations": count}
    print(json.dumps(record | {"memory": resident_bytes("VmHWM") - before}))


def in_own_process(name: str, tol: float, n: int, truth, pair) -> dict:
    """Run `measure` in a process of its own and add the error."""
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "potentials.npz")
        command = [
            sys.executable,
            "-W",
            "ignore",
            __file__,
            "--measure",
            name,
            str(tol),
            str(n),
            file,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
            return {"failed": lines[-1][:80]}
        record = json.loads(done.stdout.strip().splitlines()[-1])
        potentials = np.load(file)
    f, g = potentials["f"], potentials["g"]
    solved = Problem.between(get_backend("auto"), *pair, (RHO, RHO))
    t_rows, t_columns = (
        solved.softmin_rows(g, EPSILON, True),
        solved.softmin_columns(f, EPSILON, True),
    )
    error = np.abs(solved.row_mass(f, t_rows, EPSILON) - truth).sum() / truth.sum()
    residual = solved.residual(f, g, t_rows, t_columns, EPSILON)
    return record | {"error": float(error), "residual": residual}


def true_row_masses(pair) -> np.ndarray:
    """Return the first marginal of the converged plan."""
    best = sinkhorn(*pair, BLUR, REACH, 1e-6, backend="auto")
    if len(pair[0]) <= NUMPY_POINTS:
        best = sinkhorn(*pair, BLUR, REACH, 1e-9, backend="numpy", start=best)
    return best.row_mass


def line(*cells) -> str:
    """Return one line of a Markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def compare(n: int, names: list[str], devices) -> list[tuple[str, int, float]]:
    """Print the table for one size; return (name, points, seconds) for the plot."""
    pair = problem(n)
    truth, n = true_row_masses(pair), len(pair[0])
    ours, plotted = {}, []
    for device in devices:
        key = device.index
        ours[key] = [in_own_process(key, tol, n, truth, pair) | {"tol": tol} for tol in TOLERANCES]
        plotted.append(
            (
                f"clmorph, {device.platform}",
                n,
                next(run["seconds"] for run in ours[key] if run["tol"] == 1e-3),
            )
        )
    print(f"\n{n} x {n} points\n")
    titles = [f"clmorph, {d.platform}: s (ratio)" for d in devices]
    print(
        line(
            "library",
            "s",
            "iterations",
            "10⁹ pairs/s",
            "residual, ε",
            "error",
            "peak memory, MB",
            *titles,
        )
    )
    print(line(*["---"] * (7 + len(devices))), flush=True)
    for name in names:
        theirs = in_own_process(name, 0, n, truth, pair)
        if "failed" in theirs:
            print(line(name, theirs["failed"], *[""] * (5 + len(devices))), flush=True)
            continue
        cells = []
        for runs in ours.values():
            matching = next((run for run in runs if run["error"] <= theirs["error"]), None)
            if matching is None:
                cells.append("not as exact")
                continue
            ratio = theirs["seconds"] / matching["seconds"]
            cells.append(f"{matching['seconds']:.3g} ({ratio:.1f}×)")
        count = theirs["iterations"]
        # GeomLoss does not report a number of iterations; that of its schedule is used.
        softmins = 2 * (count or geomloss_iterations(pair))
        print(
            line(
                name, f"{theirs['seconds']:.3g}", count or geomloss_iterations(pair),
                f"{softmins * n * n / theirs['seconds'] / 1e9:.2f}",
                f"{theirs['residual']:.1e}", f"{theirs['error']:.1e}",
                f"{theirs['memory'] / 1e6:.0f}", *cells,
            ),
            flush=True,
        )  # fmt: skip
        plotted.append((name, n, theirs["seconds"]))
    for device, runs in zip(devices, ours.values(), strict=True):
        run = next(run for run in runs if run["tol"] == 1e-3)
        rate = 2 * run["iterations"] * n * n / run["seconds"] / 1e9
        print(
            line(
                f"clmorph, {device.platform}, tol 10⁻³", f"{run['seconds']:.3g}",
                run["iterations"], f"{rate:.2f}", f"{run['residual']:.1e}", f"{run['error']:.1e}",
                f"{run['memory'] / 1e6:.0f}", *[""] * len(devices),
            ),
            flush=True,
        )  # fmt: skip
    return plotted


def geomloss_iterations(pair) -> int:
    """Return the number of GeomLoss's iterations, first and last steps included."""
    from clmorph.transport._solver.geomloss import blurs
    from clmorph.transport._solver.problem import largest_cost

    diameter = (2 * largest_cost(pair[0].points, pair[1].points)) ** 0.5
    return len(blurs(diameter, BLUR, 0.9)) + 2


def print_memory(devices) -> None:
    """Print the bytes of buffers that a solve holds at once, for growing clouds."""
    import pyopencl as cl

    from clmorph.backends.opencl.backend import OpenCLOperations

    class CountedBuffer(cl.Buffer):
        now = most = 0

        def __init__(self, *arguments, **options) -> None:
            super().__init__(*arguments, **options)
            CountedBuffer.now += self.size
            CountedBuffer.most = max(CountedBuffer.most, CountedBuffer.now)

        def __del__(self) -> None:
            CountedBuffer.now -= self.size

    cl.Buffer = CountedBuffer
    sizes = (4096, 16384, 65536)
    print("\nLargest sum of device buffers during a solve, in bytes a point (of both clouds)\n")
    print(line("device", *(f"{n} points" for n in sizes)))
    print(line(*["---"] * (1 + len(sizes))))
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
