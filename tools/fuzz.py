"""Try damaged images, odd settings or odd calls, until something gives way.

    python tools/fuzz.py images --count 10000 --jobs 2 --keep findings
    python tools/fuzz.py configs --count 2000
    python tools/fuzz.py api --count 5000 --seed 7
    python tools/fuzz.py images --seed 0 --only 4711        the one case again, with its traceback

Each case is made from the seed and its number alone. Cases run in processes of their own, with
limits of time and memory, so that a crash or an endless loop is a finding like any other. Exit
codes: 0 nothing was found; 1 something was; 2 a mistake in the command line.
"""

import argparse
import contextlib
import multiprocessing
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

TARGETS = ("images", "configs", "api")
#: Seconds that one case may take before its process is ended.
PATIENCE = 120.0
#: Seconds in which a process must have made what it needs.
START = 180.0
#: Bytes that a process may take beyond what it has when it begins.
MEMORY = 500 << 20
#: Gets the number of a case, its seconds, its findings and its input.
Report = Callable[[int, float, list[str], bytes], None]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--count", type=int, default=1000, help="cases [default: 1000]")
    parser.add_argument("--seed", type=int, default=0, help="of all cases [default: 0]")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--keep", type=Path, help="a folder for the inputs that offend")
    parser.add_argument("--only", type=int, help="run this one case, here")
    parser.add_argument("--patience", type=float, default=PATIENCE, metavar="SECONDS",
                        help=f"of the clock for one case [default: {PATIENCE}]")  # fmt: skip
    given = parser.parse_args(arguments)
    if given.count < 1 or given.jobs < 1 or given.seed < 0:
        parser.error("--count and --jobs: expected at least 1; --seed: at least 0")
    if given.only is not None:
        return repeat(given.target, given.seed, given.only, given.keep)
    return supervise(given.target, given.seed, given.count, given.jobs, given.keep, given.patience)


def make_target(target: str, folder: Path) -> Any:
    """Return the cases of a kind."""
    return import_module(f"fuzzing.{target}").Target(folder)


def rng_of(seed: int, number: int) -> np.random.Generator:
    """Return what makes one case, whichever were tried before."""
    return np.random.default_rng([seed, number])


def repeat(target: str, seed: int, number: int, keep: Path | None) -> int:
    """Run one case in this process."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path.cwd()
        name, data, run = make_target(target, Path(folder)).case(rng_of(seed, number))
        print(f"{target} {number}: {name}, {len(data)} bytes", flush=True)
        if keep is not None:
            _keep(here / keep, target, seed, number, data)
        limit_memory()
        found = run()
        os.chdir(here)
    for finding in found:
        print(finding)
    return int(bool(found))


def _keep(folder: Path, target: str, seed: int, number: int, data: bytes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{target}-{seed}-{number}").write_bytes(data)


def limit_memory() -> None:
    """Let this process have no more than `MEMORY` beyond what it has; not on Windows."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        return
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def work(pipe: Connection, target: str, seed: int, numbers: list[int]) -> None:
    """Run cases, and tell of each through a pipe; what libraries print is let go."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    with tempfile.TemporaryDirectory() as folder:
        here = Path.cwd()
        try:
            cases = make_target(target, Path(folder))
        except FileNotFoundError as error:
            pipe.send(("failed", str(error)))
            return
        for number in numbers:
            pipe.send(("begun", number))
            _, data, run = cases.case(rng_of(seed, number))
            began = time.monotonic()
            found = run()
            pipe.send(("done", time.monotonic() - began, found, data if found else b""))
            if number == numbers[0]:  # what is imported by the first case is not its own
                limit_memory()
        os.chdir(here)


def share(target: str, seed: int, numbers: list[int], patience: float, report: Report) -> str:
    """Run cases in a process, started anew where it ends; return why it cannot be, or nothing."""
    context = multiprocessing.get_context("spawn")
    while numbers:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=work, args=(theirs, target, seed, numbers))
        process.start()
        theirs.close()
        running, ended = False, ""
        while numbers and not ended:
            try:
                if not ours.poll(patience if running else START):
                    process.kill()
                    ended = f"no end after {patience:g} s"
                    break
                kind, *told = ours.recv()
            except EOFError:
                process.join()
                ended = f"the process ended with code {process.exitcode}"
                break
            if kind == "failed":
                return str(told[0])
            running = kind == "begun"
            if kind == "done":
                report(numbers[0], *told)
                numbers = numbers[1:]
        process.join()
        if ended and not running:
            return f"no process could be started: {ended}"
        if ended:
            report(numbers[0], 0.0, [ended], b"")
            numbers = numbers[1:]
    return ""


def supervise(
    target: str, seed: int, count: int, jobs: int, keep: Path | None, patience: float
) -> int:
    """Run all cases in processes, print what is found, and sum it up."""
    lock, findings, seconds, began = threading.Lock(), Counter(), [], time.monotonic()

    def report(number: int, taken: float, found: list[str], data: bytes) -> None:
        with lock:
            seconds.append(taken)
            for finding in found:
                findings[finding.split(":")[0][:60]] += 1
                print(f"{target} {number}: {finding}"[:600])
                print(
                    f"    python tools/fuzz.py {target} --seed {seed} --only {number}", flush=True
                )
            if data and keep is not None:
                _keep(keep, target, seed, number, data)

    failed: set[str] = set()

    def run(first: int) -> None:
        numbers = list(range(first, count, jobs))
        failed.add(share(target, seed, numbers, patience, report))

    threads = [threading.Thread(target=run, args=(first,)) for first in range(jobs)]
    for thread in threads:
        thread.start()
    with contextlib.suppress(KeyboardInterrupt):
        for thread in threads:
            thread.join()
    failed.discard("")
    for line in failed:
        print(f"fuzz: error: {line}", file=sys.stderr)
    if failed:
        return 2
    print(
        f"{target}: {len(seconds)} cases, {sum(findings.values())} findings, "
        f"{time.monotonic() - began:.0f} s, the slowest case {max(seconds, default=0):.1f} s"
    )
    for kind, number in findings.most_common():
        print(f"    {number} x {kind}")
    return int(bool(findings))


if __name__ == "__main__":
    raise SystemExit(main())
