r"""Time the solver from thousands of points to a million.

    pip install -e ".[cpu,bench]"
    python tools/bench_scale.py --sides 128 256 512 1024 --plan
    python tools/bench_scale.py --sides 128 256 --geomloss

Two photographs, enlarged where need be, reach 0.3, residual 10^-3 epsilon; blur 0.05 at color
weights 2 and 0.5, and a blur of 2 pixels at color weight 2. Every solve has a process of its own,
which builds its kernels in a small solve before. "Pairs" is the share of all pairs of points that
each of the last softmins summed, "work" all pairs that were summed in the whole solve, in units
of N M: one iteration without truncation takes 2. "Draws" is the time of `clmorph.sample_plan`
with one draw a pixel. GeomLoss (online, KeOps, scaling 0.9) is timed where it has fewer points
than `--patience`, and is else extrapolated as N^2, marked "~".
"""

import argparse
import contextlib
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

import clmorph
from clmorph.opencl.operations import OpenCLOperations

REACH = 0.3
#: Blur (a length, or in pixels) and color weight.
SETTINGS = {"0.05": (0.05, 2.0), "0.05, photo": (0.05, 0.5), "2 px": ("2", 2.0)}
#: Sizes that divide nothing evenly, beside the squares: 48,896 and 157,000 points.
ODD_SHAPES = ((191, 256), (314, 500))


def photographs(shape: tuple[int, int], color_weight: float) -> list[Any]:
    """Return two photographs as measures."""
    from skimage import data
    from skimage.transform import resize

    images = data.astronaut()[50:450, 50:450], data.chelsea()[:, 75:375]
    return [
        clmorph.lift(resize(image / 255, shape, anti_aliasing=True), color_weight)
        for image in images
    ]


def resident_bytes(which: str) -> int:
    """Return the resident size of this process, now ("VmRSS") or at its largest ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(row.split()[1] for row in lines if row.startswith(which)))


class Counter:
    """Counts pairs, launches and bytes of one backend."""

    def __init__(self, operations: OpenCLOperations) -> None:
        self.pairs, self.most_bytes = 0, 0
        self.launches: list[float] = []
        work, budget = operations.work, operations.reductions._budget
        measure, launch = budget.measure, work.launch

        @contextlib.contextmanager
        def counted(pairs: int) -> Any:
            self.pairs += pairs
            with measure(pairs):
                yield

        def timed(*arguments: Any) -> None:
            began = time.perf_counter()
            launch(*arguments)
            self.launches.append(time.perf_counter() - began)
            held = CountedBuffer.now + work._pool.managed_bytes
            self.most_bytes = max(self.most_bytes, held)

        budget.measure, work.launch = counted, timed  # type: ignore[method-assign]


class CountedBuffer(cl.Buffer):
    """A buffer that tells how many bytes there are of its kind."""

    now = 0

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        CountedBuffer.now += self.size

    def __del__(self) -> None:
        CountedBuffer.now -= self.size


def solve(device: str, setting: str, shape: tuple[int, int], plan: bool) -> None:
    """Solve once and print what it took, as JSON."""
    cl.Buffer = CountedBuffer  # type: ignore[misc]
    operations = clmorph.get_backend(device)
    assert isinstance(operations, OpenCLOperations)
    blur, color_weight = SETTINGS[setting]
    length = float(blur) / max(shape) if isinstance(blur, str) else blur
    for precision in ("float32", "float64"):  # kernels are built
        clmorph.sinkhorn(
            *photographs((40, 40), color_weight), 0.05, REACH, backend=operations,
            truncation=1e-4, precision=precision,
        )  # fmt: skip
    source, target = photographs(shape, color_weight)
    counter = Counter(operations)
    Path("/proc/self/clear_refs").write_text("5")  # the largest size so far is forgotten
    before = resident_bytes("VmRSS")
    began = time.perf_counter()
    potentials = clmorph.sinkhorn(source, target, length, REACH, backend=operations)
    seconds = time.perf_counter() - began
    record = {
        "points": len(source), "seconds": seconds, "iterations": potentials.n_iter,
        "residual": potentials.residual, "status": potentials.status,
        "visited": potentials.visited, "truncation_error": potentials.truncation_error,
        "work": counter.pairs / len(source) / len(target),
        "longest": max(counter.launches), "median": float(np.median(counter.launches)),
        "host": resident_bytes("VmHWM") - before, "device": counter.most_bytes,
    }  # fmt: skip
    began = time.perf_counter()
    clmorph.sample_plan(source, target, potentials, 1, backend=operations)
    record["draws"] = time.perf_counter() - began
    if plan:
        try:
            kept = len(
                clmorph.transport_plan(source, target, potentials, max_bytes=1, backend=operations)
            )
        except clmorph.InputError as refusal:  # which tells the number of pairs
            kept = int(re.findall(r"keep (\d+) pairs", str(refusal))[0])
        record["kept"] = kept
    print(json.dumps(record))


def geomloss(setting: str, shape: tuple[int, int]) -> None:
    """Time GeomLoss once and print it, as JSON."""
    import torch
    from geomloss import SamplesLoss

    blur, color_weight = SETTINGS[setting]
    length = float(blur) / max(shape) if isinstance(blur, str) else blur
    loss = SamplesLoss(
        "sinkhorn", p=2, blur=length, reach=REACH, scaling=0.9, debias=False, potentials=True,
        backend="online",
    )  # fmt: skip
    for size in ((16, 16), shape):  # the first compiles
        arrays = [
            torch.tensor(array, dtype=torch.float32)
            for measure in photographs(size, color_weight)
            for array in (measure.weights, measure.points)
        ]
        began = time.perf_counter()
        loss(*arrays)
        seconds = time.perf_counter() - began
    print(json.dumps({"seconds": seconds}))


def in_own_process(*arguments: str) -> dict[str, Any] | None:
    """Run this tool for one case."""
    done = subprocess.run(
        [sys.executable, __file__, *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        print(done.stderr.strip().splitlines()[-1], file=sys.stderr)
        return None
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def line(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def growth(records: list[dict[str, Any]]) -> str:
    """Return the power of N by which the time grew from the first to the last record."""
    first, last = records[0], records[-1]
    power = np.log(last["seconds"] / first["seconds"]) / np.log(last["points"] / first["points"])
    return f"from {first['points']} to {last['points']} points as N^{power:.2f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="*", default=[128, 256, 512])
    parser.add_argument("--odd", action="store_true", help="48,896 and 157,000 points too")
    parser.add_argument("--settings", nargs="*", default=list(SETTINGS), choices=SETTINGS)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--plan", action="store_true", help="count the plan's pairs too")
    parser.add_argument("--geomloss", action="store_true", help="time GeomLoss beside")
    parser.add_argument("--patience", type=int, default=17_000, help="most points for GeomLoss")
    parser.add_argument("--one", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        kind, setting, height, width = options.one
        if kind == "geomloss":
            geomloss(setting, (int(height), int(width)))
        else:
            solve(kind, setting, (int(height), int(width)), options.plan)
        return 0
    shapes = [(side, side) for side in options.sides]
    shapes += ODD_SHAPES if options.odd else ()
    heads = [
        "blur", "points", "s", "iterations", "residual, eps", "pairs", "work, N M",
        "truncation error", "plan, pairs", "draws, s", "host, MB", "device, MB",
        "longest launch, ms",
    ]  # fmt: skip
    heads += ["GeomLoss online, s"] if options.geomloss else []
    print(line(*heads))
    print(line(*["---"] * len(heads)))
    for setting in options.settings:
        records: list[dict[str, Any]] = []
        peer: tuple[int, float] | None = None
        for shape in sorted(shapes, key=lambda shape: shape[0] * shape[1]):
            case = [setting, str(shape[0]), str(shape[1])]
            flags = ["--plan"] if options.plan else []
            record = in_own_process("--one", options.device, *case, *flags)
            if record is None:
                continue
            records.append(record)
            cells = [
                setting, record["points"], f"{record['seconds']:.3g}", record["iterations"],
                f"{record['residual']:.1e}", f"{100 * record['visited']:.2g} %",
                f"{record['work']:.3g}", f"{record['truncation_error']:.0e}",
                f"{record['kept']:.3g}" if "kept" in record else "", f"{record['draws']:.3g}",
                f"{record['host'] / 1e6:.0f}", f"{record['device'] / 1e6:.0f}",
                f"{1e3 * record['longest']:.0f}",
            ]  # fmt: skip
            if options.geomloss:
                if record["points"] <= options.patience:
                    timed = in_own_process("--one", "geomloss", *case)
                    if timed is not None:
                        peer = record["points"], timed["seconds"]
                        cells.append(f"{timed['seconds']:.3g}")
                elif peer is not None:
                    cells.append(f"~{peer[1] * (record['points'] / peer[0]) ** 2:.2g}")
            if record["status"] != "converged":
                cells[3] = f"{cells[3]} ({record['status']})"
            print(line(*cells), flush=True)
        if len(records) > 1:
            print(f"\n{setting}: {growth(records)}\n", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
