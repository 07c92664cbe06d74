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
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from importlib import import_module
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
    parser.add_argument("--work", nargs=2, type=int, metavar=("FIRST", "STEP"),
                        help=argparse.SUPPRESS)  # fmt: skip
    given = parser.parse_args(arguments)
    if given.count < 1 or given.jobs < 1 or given.seed < 0:
        parser.error("--count and --jobs: expected at least 1; --seed: at least 0")
    if given.work is not None:
        return work(given.target, given.seed, given.count, *given.work)
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


def work(target: str, seed: int, count: int, first: int, step: int) -> int:
    """Run every `step`-th case from `first` on, and say so in lines of JSON."""
    said = os.fdopen(os.dup(1), "w", encoding="utf-8")
    # What libraries print is not for the supervisor.
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)

    def say(**told: Any) -> None:
        print(json.dumps(told), file=said, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        here = Path.cwd()
        try:
            cases = make_target(target, Path(folder))
        except FileNotFoundError as error:
            say(failed=str(error))
            return 2
        limited = False
        for number in range(first, count, step):
            say(number=number)
            _, data, run = cases.case(rng_of(seed, number))
            began = time.monotonic()
            found = run()
            seconds = time.monotonic() - began
            say(done=number, seconds=seconds, found=found, data=data.hex() if found else "")
            if not limited:  # what is imported by the first case is not its own
                limit_memory()
                limited = True
        os.chdir(here)
    say(end=True)
    return 0


class Share:
    """Every `step`-th case from `first` on, in a process that is started anew when one ends.

    Parameters
    ----------
    target : str
    seed, count, first, step : int
    patience : float
        Seconds that one case may take.
    report : callable
        Called with the number of a case, its seconds, its findings and its input.
    """

    def __init__(
        self, target: str, seed: int, count: int, first: int, step: int, patience: float,
        report: Any,
    ) -> None:  # fmt: skip
        self.target, self.seed, self.count, self.step = target, seed, count, step
        self.next, self.patience, self.report, self.failed = first, patience, report, ""

    def run(self) -> None:
        """Run all."""
        while self.next < self.count and not self.failed:
            self._run_process()

    def _run_process(self) -> None:
        command = [
            sys.executable, str(Path(__file__).resolve()), self.target, "--count", str(self.count),
            "--seed", str(self.seed), "--work", str(self.next), str(self.step),
        ]  # fmt: skip
        running: int | None = None
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            lines: queue.Queue[str] = queue.Queue()
            reader = threading.Thread(target=self._read, args=(process.stdout, lines), daemon=True)
            reader.start()
            ended = ""
            while not ended:
                try:
                    line = lines.get(timeout=START if running is None else self.patience)
                except queue.Empty:
                    process.kill()
                    ended = f"no end after {self.patience:g} s"
                    break
                told = json.loads(line) if line else {"gone": True}
                if "failed" in told:
                    self.failed = told["failed"]
                    ended = "failed"
                elif "number" in told:
                    running = told["number"]
                elif "done" in told:
                    self.report(running, told["seconds"], told["found"], told["data"])
                    self.next = told["done"] + self.step
                elif "end" in told:
                    self.next = self.count
                    ended = "done"
                else:
                    ended = f"the process ended with code {process.wait()}"
        if ended not in ("done", "failed"):
            if running is None or running < self.next:
                self.failed = f"no process could be started: {ended}"
                return
            self.report(running, 0.0, [ended], "")
            self.next = running + self.step

    @staticmethod
    def _read(stream: Any, lines: "queue.Queue[str]") -> None:
        for line in stream:
            lines.put(line)
        lines.put("")


def supervise(
    target: str, seed: int, count: int, jobs: int, keep: Path | None, patience: float
) -> int:
    """Run all cases in processes, print what is found, and sum it up."""
    lock, findings, seconds, began = threading.Lock(), Counter(), [], time.monotonic()

    def report(number: int, taken: float, found: list[str], data: str) -> None:
        with lock:
            seconds.append(taken)
            for finding in found:
                findings[finding.split(":")[0][:60]] += 1
                print(f"{target} {number}: {finding}"[:600])
                print(
                    f"    python tools/fuzz.py {target} --seed {seed} --only {number}", flush=True
                )
            if data and keep is not None:
                _keep(keep, target, seed, number, bytes.fromhex(data))

    shares = [Share(target, seed, count, first, jobs, patience, report) for first in range(jobs)]
    threads = [threading.Thread(target=share.run) for share in shares]
    for thread in threads:
        thread.start()
    with contextlib.suppress(KeyboardInterrupt):
        for thread in threads:
            thread.join()
    failed = {share.failed for share in shares} - {""}
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
