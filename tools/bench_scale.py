r"""Time whole morphs from thousands of points to a million.

    python tools/bench_scale.py --sides 128 256 512 1024 --odd

Two photographs, enlarged where need be, reach 0.3, residual 10^-3 epsilon; blur 0.05 at color
weights 2 and 0.5, and a blur of 2 pixels at color weight 2; `--settings` names these and blurs of
more pixels. Every morph has a process of its own, which builds its kernels in a small one before.
"Solve" is the transport alone. "Pairs" is the share of all pairs of points that each of the last
softmins summed, "work" all pairs that were summed in the whole solve, in units of N M: one
iteration without truncation takes 2. "Plan" is what frames are made of: all kept pairs if they are
few, else about 1.5 million draws, at least one a pixel (the command line's default); and the time
that this takes. A frame is that at t = 0.5, after another one; memory is the largest over all of
this.

`--drawn` times morphs of large pictures with the default options in place of all that: up to the
plan, the first frame, which divides and registers the images, and the least of two more.
"""

import argparse
import contextlib
import json
import time
import warnings
from typing import Any

import numpy as np
import pyopencl as cl
from benching import (
    CountedBuffer,
    begin_memory,
    in_own_process,
    line,
    photographs,
    print_head,
    resident_bytes,
)

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import choose_device
from clmorph.backends.opencl.kernels.launches import LaunchBudget
from clmorph.transport.plan import Plan

REACH = 0.3
#: Blur (a length, or in pixels) and color weight.
SETTINGS: dict[str, tuple[float | str, float]] = {
    "0.05": (0.05, 2.0), "0.05, photo": (0.05, 0.5),
    **{f"{pixels} px": (str(pixels), 2.0) for pixels in (2, 4, 6, 8, 10, 14)},
}  # fmt: skip
#: The settings of the table of all sizes.
USUAL = ["0.05", "0.05, photo", "2 px"]
#: As many as the command line draws at most, but for one a pixel.
PARTICLES = 1_500_000
#: Sizes that divide nothing evenly, beside the squares: 48,896 and 157,000 points.
ODD_SHAPES = ((191, 256), (314, 500))


class Counter:
    """Counts pairs, launches and bytes of one backend."""

    def __init__(self, operations: OpenCLOperations) -> None:
        self.pairs, self.most_bytes = 0, 0
        work = operations.work
        measure, launch = LaunchBudget.measure, work.launch

        @contextlib.contextmanager
        def counted(budget: LaunchBudget, pairs: int) -> Any:
            self.pairs += pairs
            with measure(budget, pairs):
                yield

        def timed(*arguments: Any, **options: Any) -> None:
            launch(*arguments, **options)
            held = CountedBuffer.now + work._pool.managed_bytes
            self.most_bytes = max(self.most_bytes, held)

        LaunchBudget.measure = counted  # type: ignore[method-assign]
        work.launch = timed  # type: ignore[method-assign]


def morph(device: str, setting: str, shape: tuple[int, int]) -> None:
    """Morph once and print what it took, as JSON."""
    cl.Buffer = CountedBuffer  # type: ignore[misc]
    operations = OpenCLOperations(choose_device(device).handle, profiled=True)
    blur, color_weight = SETTINGS[setting]
    length = float(blur) / max(shape) if isinstance(blur, str) else blur
    small = [clmorph.lift(image, color_weight) for image in photographs((40, 40))]
    for precision in ("float32", "float64"):  # kernels are built
        clmorph.sinkhorn(
            *small, 0.05, REACH, backend=operations, truncation=1e-4, precision=precision,
            multiscale=True,
        )  # fmt: skip
    images = photographs(shape)
    counter = Counter(operations)
    before = begin_memory()
    marks: dict[str, tuple[float, int, float]] = {}

    def mark(stage: str, share: float) -> None:
        now = time.perf_counter(), counter.pairs, operations.work.device_seconds
        marks.setdefault(f"{stage} {share:g}", now)

    warnings.simplefilter("ignore", clmorph.MemoryWarning)  # the table tells
    result = clmorph.morph(
        *images, n_frames=3, blur=length, reach=REACH, color_weight=color_weight, size=None,
        solve_size=None, path_space="srgb", backend=operations, progress=mark,
        max_particles=PARTICLES,
    )  # fmt: skip
    result.frame(0.4)
    frame = time.perf_counter()
    result.frame(0.5)
    frame = time.perf_counter() - frame
    found, n = result.potentials, len(result.source)
    (begun, _, before_all), (solved, pairs, in_kernels), (planned, *_) = (
        marks[name] for name in ("transport 0", "plan 0", "plan 1")
    )
    kind = kind_of(result) if isinstance(result.plan, Plan) else "means"
    record = {
        "points": n, "seconds": solved - begun,
        "iterations": found.n_iter, "residual": found.residual, "status": found.status,
        "visited": found.visited, "truncation_error": found.truncation_error,
        "work": pairs / n**2, "longest": operations.work.longest_launch,
        "kernels": in_kernels - before_all,
        "host": resident_bytes("VmHWM") - before, "device": counter.most_bytes,
        "plan": f"{len(result.plan) / 1e6:.2g} M {kind}",
        "planned": planned - solved, "frame": frame,
    }  # fmt: skip
    print(json.dumps(record))


def kind_of(result: Any) -> str:
    """Say whether particles are kept pairs of the plan or draws: only pairs have its masses."""
    plan, source, target, found = result.plan, result.source, result.target, result.potentials
    some = slice(0, 10_000)
    rows, columns = plan.rows[some], plan.indices[some]
    cost = 0.5 * ((source.points[rows] - target.points[columns]) ** 2).sum(axis=1)
    exponents = (found.f[rows] + found.g[columns] - cost) / found.epsilon
    masses = source.weights[rows] * target.weights[columns] * np.exp(exponents)
    return "pairs" if np.allclose(plan.mass[some], masses, rtol=1e-2, atol=0) else "draws"


def drawn(device: str, side: int) -> None:
    """Morph large pictures with the default options, and print what frames take, as JSON."""
    operations = clmorph.get_backend(device)
    clmorph.morph(*photographs((64, 64)), backend=operations).frame(0.5)  # kernels are built
    images = photographs((side, side))
    before = begin_memory()
    began = time.perf_counter()
    result = clmorph.morph(*images, size=None, n_frames=3, backend=operations)
    seconds = [time.perf_counter() - began]
    for t in (0.4, 0.45, 0.5):
        began = time.perf_counter()
        result.frame(t)
        seconds.append(time.perf_counter() - began)
    record = {
        "solved": seconds[0], "first": seconds[1], "frame": min(seconds[2:]),
        "host": resident_bytes("VmHWM") - before,
    }  # fmt: skip
    print(json.dumps(record))


def growth(records: list[dict[str, Any]]) -> str:
    """Return the power of N by which the time grew from the first to the last record."""
    first, last = records[0], records[-1]
    power = np.log(last["seconds"] / first["seconds"]) / np.log(last["points"] / first["points"])
    return f"from {first['points']} to {last['points']} points as N^{power:.2f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="*", default=[128, 256, 512])
    parser.add_argument("--odd", action="store_true", help="48,896 and 157,000 points too")
    parser.add_argument("--settings", nargs="*", default=USUAL, choices=SETTINGS)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--drawn", type=int, nargs="*", default=[], metavar="SIDE")
    parser.add_argument("--one", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        kind, setting, height, width = options.one
        if setting == "drawn":
            drawn(kind, int(height))
        else:
            morph(kind, setting, (int(height), int(width)))
        return 0
    shapes = [(side, side) for side in options.sides]
    shapes += ODD_SHAPES if options.odd else ()
    print(f"{clmorph.get_backend(options.device).description}\n")
    if options.drawn:
        print_head("pixels", "solve and plan, s", "first frame, s", "frame, s", "host, MB")
        for side in options.drawn:
            record = in_own_process(
                __file__, "--one", options.device, "drawn", str(side), str(side)
            )
            if "failed" in record:
                print(line(f"{side} x {side}", record["failed"]))
            else:
                cells = (f"{record[name]:.2g}" for name in ("solved", "first", "frame"))
                print(line(f"{side} x {side}", *cells, f"{record['host'] / 1e6:.0f}"), flush=True)
        return 0
    print_head(
        "blur", "points", "solve, s", "kernels, s", "iterations", "residual, eps", "pairs",
        "work, N M",
        "truncation error", "plan", "plan, s", "frame, s", "host, MB", "device, MB",
        "longest launch, ms",
    )  # fmt: skip
    for setting in options.settings:
        records: list[dict[str, Any]] = []
        for shape in sorted(shapes, key=lambda shape: shape[0] * shape[1]):
            case = ("--one", options.device, setting, str(shape[0]), str(shape[1]))
            record = in_own_process(__file__, *case)
            if "failed" in record:
                print(line(setting, shape[0] * shape[1], record["failed"]), flush=True)
                continue
            records.append(record)
            cells = [
                setting, record["points"], f"{record['seconds']:.3g}",
                f"{record['kernels']:.3g}", record["iterations"],
                f"{record['residual']:.1e}", f"{100 * record['visited']:.2g} %",
                f"{record['work']:.3g}", f"{record['truncation_error']:.0e}", record["plan"],
                f"{record['planned']:.2g}", f"{record['frame']:.2g}",
                f"{record['host'] / 1e6:.0f}", f"{record['device'] / 1e6:.0f}",
                f"{1e3 * record['longest'][0]:.0f} ({record['longest'][1]})",
            ]  # fmt: skip
            if record["status"] != "converged":
                cells[4] = f"{cells[4]} ({record['status']})"
            print(line(*cells), flush=True)
        if len(records) > 1:
            print(f"\n{setting}: {growth(records)}\n", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
