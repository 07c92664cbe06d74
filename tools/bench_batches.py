"""Measure the throughput of `clmorph batch` with 1 and 2 workers, and its memory over time.

    pip install -e ".[cpu,dask]"
    python tools/bench_batches.py --pairs 200 --device numpy

Each run is a process of its own: `clmorph batch` between crops of a photograph, with new local
workers. The memory is the resident memory (PSS where the system tells it) of the command and all
its workers, read every `--interval` seconds; the table shows it at each quarter of the run, which
would rise if anything were kept for each pair. Pairs per second are counted over the whole run, and
without the start: from the first record of the journal to the last.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

JOURNAL = "clmorph-batch.jsonl"


def make_pictures(folder: Path, count: int, side: int) -> None:
    from skimage import data

    photograph = Image.fromarray(data.astronaut())
    for number in range(count):
        left, top = 37 * number % (512 - side), 53 * number % (512 - side)
        crop = photograph.crop((left, top, left + side, top + side))
        crop.save(folder / f"{number:03}.png")


def family(pid: int) -> list[int]:
    """Return a process and all its descendants."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = task.read_text().split()
        except OSError:
            continue
        for child in children:
            found += family(int(child))
    return found


def memory_of(pid: int) -> int:
    """Return the bytes of a process; memory that several share is divided among them."""
    for name, key in (("smaps_rollup", "Pss:"), ("status", "VmRSS:")):
        try:
            lines = Path(f"/proc/{pid}/{name}").read_text().splitlines()
        except OSError:
            continue
        for line in lines:
            if line.startswith(key):
                return int(line.split()[1]) * 1024
    return 0


def measure(pictures: Path, jobs: Path, workers: int, device: str, interval: float) -> dict:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch, "out")
        command = [sys.executable, "-m", "clmorph", "batch", str(jobs), "-o", str(out), "--json"]
        command += ["--workers", str(workers), "--device" if device != "numpy" else "--backend"]
        began = time.perf_counter()
        told = Path(scratch, "told.json")  # a pipe that nobody reads would fill up
        with told.open("w") as stream:
            process = subprocess.Popen([*command, device], stdout=stream)
        memory, arrivals = [], []
        while process.poll() is None:
            memory.append(sum(map(memory_of, family(process.pid))))
            journal = out / JOURNAL
            done = journal.read_bytes().count(b"\n") if journal.exists() else 0
            arrivals.append((time.perf_counter(), done))
            time.sleep(interval)
        seconds = time.perf_counter() - began
        summary = json.loads(told.read_text())
        working = [at for at, done in arrivals if done > 0]
        first = next(done for at, done in arrivals if done > 0)
        last = max(done for _, done in arrivals)
        ended = next(at for at, done in arrivals if done == last)
        steady = (last - first) / max(ended - working[0], interval)
        busy = [each for each, (_, done) in zip(memory, arrivals, strict=True) if done > 0]
        quarters = [busy[round(share * (len(busy) - 1))] for share in (0, 0.25, 0.5, 0.75, 0.95)]
        return {
            "workers": workers,
            "done": summary["done"],
            "failed": summary["failed"],
            "seconds": round(seconds, 1),
            "pairs_per_second": round(summary["done"] / seconds, 2),
            "steady": round(steady, 2),
            "memory_mb": [round(each / 1e6) for each in quarters],
            "memory_peak_mb": round(max(memory) / 1e6),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--side", type=int, default=48)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--interval", type=float, default=0.25)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        count = 2
        while count * (count - 1) < given.pairs:
            count += 1
        make_pictures(folder, count, given.side)
        names = [f"{number:03}.png" for number in range(count)]
        pairs = [(s, t) for s in names for t in names if s != t][: given.pairs]
        jobs = [
            {"source": s, "target": t, "output": f"{s[:3]}-{t[:3]}.gif", "frames": given.frames}
            for s, t in pairs
        ]
        table = folder / "jobs.json"
        table.write_text(json.dumps(jobs))
        for workers in given.workers:
            found = measure(folder, table, workers, given.device, given.interval)
            print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
