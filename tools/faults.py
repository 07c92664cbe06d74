"""Interrupt runs of ``clmorph`` and inspect the files they leave: ``python tools/faults.py``.

Ends runs by SIGINT, SIGTERM and SIGKILL at random moments, for every format; fills the disk;
damages and blocks caches. Prints a line for every finding, with the command that repeats it, and a
summary; ends with 1 if there was a finding.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from disturbed_runs import Ended, FoldersOfRuns, small_disk
from findings import Findings, digest

from clmorph.output.save import FORMATS

#: Signals, and the exit codes of runs that they end.
SIGNALS = {"SIGINT": 130, "SIGTERM": 143, "SIGKILL": -9}
#: What a run says that a signal reached too late.
WRITTEN = "after the files were written"
OLD = b"what was there before"
#: What may happen to a file of the cache.
DAMAGES: dict[str, Callable[[Path], object]] = {
    "garbage": lambda file: file.write_bytes(bytes(range(256)) * 9),
    "empty": lambda file: file.write_bytes(b""),
    "cut": lambda file: os.truncate(file, file.stat().st_size // 2),
    "types": lambda file: file.write_text('{"reason": [], "pairs_per_second": "x"}'),
    "nested": lambda file: file.write_text("[" * 100_000),
    "folder": lambda file: (file.unlink(), file.mkdir()),
    "loop": lambda file: (file.unlink(), file.symlink_to(file.name)),
}
#: What may be wrong with the folder of the cache: variables, given a folder that is there.
PLACES: dict[str, Callable[[Path], dict[str, str | None]]] = {
    "a file": lambda folder: {"XDG_CACHE_HOME": str(folder / "a.png")},
    "relative": lambda folder: {"XDG_CACHE_HOME": "cache", "HOME": str(folder / "tmp")},
    "no home": lambda folder: {"XDG_CACHE_HOME": None, "HOME": None},
    "nowhere": lambda folder: {"XDG_CACHE_HOME": None, "HOME": "/dev/null"},
}


class Runs(FoldersOfRuns):
    """Runs that are disturbed."""

    # --- kills

    def kill(self, format: str, name: str, seconds: float, old: bool) -> None:
        """End a run by a signal after some seconds."""
        self.findings.trial("kill")
        with self.folder() as folder:
            output = self.output(folder, format)
            before = ""
            if old and not FORMATS[format].folder:
                output.write_bytes(OLD)
                before = digest(output)
            process = self.start(folder, format)
            time.sleep(seconds)
            process.send_signal(getattr(signal, name))
            ended = self.end(process, folder, format)
            whole = ended.output == self.references[format].output
            faults = []
            told = [line for line in ended.lines if line.startswith("clmorph: ")]
            # Before and after our `main` the interpreter ends by the signal itself, and before it
            # prints where Ctrl-C found it.
            begun = any(line.endswith(" in main") for line in ended.lines)
            python = ended.code == -getattr(signal, name) and (
                whole or (not begun and ended.output == before)
            )
            if not python and ended.code not in (SIGNALS[name], 0):
                faults.append(f"exit code {ended.code}")
            if not python and any("Traceback" in line for line in ended.lines):
                faults.append(f"a traceback ({ended.lines[0]} … {ended.lines[-1]})")
            elif ended.code > 0 and (len(told) != 1 or len(ended.lines) != 1):
                faults.append(f"not one line: {ended.lines}")
            if ended.code == 0 and not whole:
                faults.append("done, but not whole")
            if ended.code != 0 and ended.output != before and not whole:
                faults.append("half an output")
            if ended.code > 0 and whole != any(WRITTEN in line for line in told):
                faults.append(f"whole: {whole}, but it says: {told}")
            if name == "SIGKILL" and ended.left:
                if not whole and output.is_dir():
                    shutil.rmtree(output)  # only files are replaced
                again = self.end(self.start(folder, format), folder, format)
                if again.code:
                    faults.append(f"the next run ends with {again.code}: {again.lines[-1:]}")
                ended.left = again.left
            if ended.left:
                faults.append(f"left behind: {', '.join(sorted(ended.left))}")
        if faults:
            spec = f"{format}:{name}:{seconds:.3f}:{'old' if old else 'new'}"
            self.findings.add("kill", f"{spec}: {'; '.join(faults)}", ["--kill", spec])

    # --- a full disk

    def fill(self, format: str, kilobytes: int) -> None:
        """Run where no more than so much can be written: a small disk, or small files."""
        self.findings.trial("disk")
        with self.folder() as folder, small_disk(folder, kilobytes) as before:
            output = self.output(folder, format)
            if not FORMATS[format].folder:
                output.write_bytes(OLD)
            was = digest(output)
            ended = self.end(self.start(folder, format, before=before), folder, format)
        faults = []
        if ended.code == 0 and ended.output != self.references[format].output:
            faults.append("done, but not whole")
        if ended.code not in (0, 2):
            faults.append(f"exit code {ended.code}")
        if ended.code and (len(ended.lines) != 1 or "Traceback" in ended.lines[0]):
            faults.append(f"not one line: {ended.lines[-3:]}")
        if ended.code and ended.output != was:
            faults.append("the old content is gone")
        if ended.left:
            faults.append(f"left behind: {', '.join(sorted(ended.left))}")
        if faults:
            spec = f"{format}:{kilobytes}"
            self.findings.add("disk", f"{spec}: {'; '.join(faults)}", ["--disk", spec])

    # --- caches

    def damage(self, damage: str, part: str) -> None:
        """Run with a cache whose files are damaged; part: "devices" or "kernels"."""

        def prepare(folder: Path) -> dict[str, str | None]:
            from clmorph.backends.opencl.devices.cache import cache_folder

            known = cache_folder()
            place = folder / "cache" / "clmorph"
            for name in ("devices", "kernels"):
                if known and (known / name).is_dir():
                    shutil.copytree(known / name, place / name)
                    for file in sorted((place / name).iterdir()) if name == part else []:
                        DAMAGES[damage](file)
            return {"XDG_CACHE_HOME": str(folder / "cache")}

        self._cached_run(f"{damage}:{part}", prepare)

    def misplace(self, place: str) -> None:
        """Run with a cache folder that cannot be used."""
        self._cached_run(place, PLACES[place])

    def _cached_run(self, spec: str, prepare: Callable[[Path], dict[str, str | None]]) -> None:
        self.findings.trial("cache")
        with self.folder() as folder:
            # PoCL itself cannot do without a cache, which is not ours to mend.
            changes = prepare(folder) | {"POCL_CACHE_DIR": str(folder / "cache")}
            ended = self.end(self.start(folder, "gif", changes), folder, "gif")
        self._same("cache", spec, ended)

    def _same(self, kind: str, spec: str, ended: Ended) -> None:
        """Add a finding unless a run ended as if nothing had happened."""
        lines = [line for line in ended.lines if "made in" not in line]
        whole = ended.output == self.references["gif"].output
        if ended.code or lines or ended.left or not whole:
            what = "whole" if whole else "not as it should be"
            self.findings.add(
                kind,
                f"{spec}: exit code {ended.code}, {lines[-2:]}, left {ended.left}, output {what}",
                [f"--{kind}", spec],
            )


def _startup() -> float:
    """Seconds that the interpreter takes before clmorph can do anything about a signal."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import clmorph"], check=True)
    return time.perf_counter() - began


def plan(runs: Runs, arguments: argparse.Namespace) -> list[Callable[[], None]]:
    """Return the trials that the command line asks for."""
    one = [
        *(
            partial(runs.kill, format, name, float(seconds), old == "old")
            for format, name, seconds, old in (spec.split(":") for spec in arguments.kill)
        ),
        *(
            partial(runs.fill, format, int(kilobytes))
            for format, kilobytes in (spec.split(":") for spec in arguments.disk)
        ),
        *(partial(_cache, runs, spec) for spec in arguments.cache),
    ]
    needed = {spec.split(":")[0] for spec in [*arguments.kill, *arguments.disk]}
    formats = [name for name in FORMATS if name in needed or not one]
    # Times are those of runs that stand side by side, as the runs to be killed do.
    with ThreadPoolExecutor(arguments.jobs) as pool:
        list(pool.map(runs.measure, dict.fromkeys(["gif", *formats])))
    if one:
        return one
    rng = random.Random(arguments.seed)
    first = 1.5 * _startup()
    trials: list[Callable[[], None]] = []
    for number in range(arguments.kills):
        format = formats[number % len(formats)]
        name = rng.choice(list(SIGNALS))
        seconds = rng.uniform(first, max(2 * first, 1.05 * runs.references[format].seconds))
        trials.append(partial(runs.kill, format, name, seconds, rng.random() < 0.5))
    for number in range(arguments.disks):
        format = formats[(number * 7) % len(formats)]
        trials.append(partial(runs.fill, format, rng.choice([0, 4, 8, 16, 32])))
    for number in range(arguments.caches):
        if number % 3 == 2:
            trials.append(partial(runs.misplace, rng.choice(list(PLACES))))
        else:
            part = rng.choice(["devices", "kernels"])
            trials.append(partial(runs.damage, rng.choice(list(DAMAGES)), part))
    return trials


def _cache(runs: Runs, spec: str) -> None:
    damage, _, part = spec.partition(":")
    runs.damage(damage, part) if part else runs.misplace(damage)


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200, help="runs to be killed")
    parser.add_argument("--disks", type=int, default=11, help="runs on a full disk")
    parser.add_argument("--caches", type=int, default=9, help="runs with a bad cache")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device")
    parser.add_argument("--jobs", type=int, default=2, help="runs side by side")
    single = parser.add_argument_group("one trial, as a finding names it")
    for name, form in (
        ("kill", "FORMAT:SIGNAL:SECONDS:old|new"), ("disk", "FORMAT:KILOBYTES"),
        ("cache", "DAMAGE:devices|kernels or PLACE"),
    ):  # fmt: skip
        single.add_argument(f"--{name}", action="append", default=[], metavar=form)
    arguments = parser.parse_args(given)
    findings = Findings(["--device", arguments.device] if arguments.device else [])
    runs = Runs(arguments.device, findings)
    trials = plan(runs, arguments)
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for running in [pool.submit(trial) for trial in trials]:
            running.result()
    return findings.end()


if __name__ == "__main__":
    raise SystemExit(main())
