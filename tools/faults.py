"""Interrupt runs of ``clmorph`` and inspect the files they leave: ``python tools/faults.py``.

Ends runs by SIGINT, SIGTERM and SIGKILL at random moments, for every format; fills the disk;
damages, blocks and shares caches; forks; starts threads at a cold start. Prints a line for every
finding, with the command that repeats it, and a summary; ends with 1 if there was a finding.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from findings import Findings, digest, pictures

from clmorph.output.save import FORMATS

#: Signals, and the exit codes of runs that they end.
SIGNALS = {"SIGINT": 130, "SIGTERM": 143, "SIGKILL": -9}
#: What a run says that a signal reached too late.
WRITTEN = "after the files were written"
#: Seconds after which a run counts as hanging.
HANGS = 180
OLD = b"what was there before"
#: What may happen to a file of the cache.
DAMAGES: dict[str, Callable[[Path], object]] = {
    "garbage": lambda file: file.write_bytes(bytes(range(256)) * 9),
    "empty": lambda file: file.write_bytes(b""),
    "cut": lambda file: os.truncate(file, file.stat().st_size // 2),
    "types": lambda file: file.write_text('{"usable": 3, "reason": [], "pairs_per_second": "x"}'),
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
FORK = """
import os, sys
import numpy as np, clmorph
from clmorph.backends.opencl.devices.find import raw_devices
picture = np.random.default_rng(0).random((8, 8, 3))
raw_devices() if sys.argv[1] == "listed" else clmorph.get_backend(sys.argv[2])
for backend in (sys.argv[2], "numpy"):
    child = os.fork()
    if not child:
        try:
            clmorph.morph(picture, picture, n_frames=3, backend=backend).frame(0.5)
            os._exit(0)
        except clmorph.DeviceError as error:
            os._exit(3 if "spawn" in str(error) else 4)
        finally:
            os._exit(5)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code == (0 if backend == "numpy" else 3), (backend, code)
"""
THREADS = """
import sys, threading
import numpy as np
first, second = np.random.default_rng(0).random((2, 8, 8, 3))
gate, frames, errors = threading.Barrier(8), [], []
def work():
    gate.wait()
    try:
        import clmorph
        morph = clmorph.morph(first, second, n_frames=3, backend=sys.argv[1])
        frames.append(morph.frame(0.5).tobytes())
    except BaseException as error:
        errors.append(repr(error))
threads = [threading.Thread(target=work) for _ in range(8)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert not errors, errors
assert len(set(frames)) == 1, "threads differ"
"""


@dataclass
class Reference:
    """An undisturbed run: its seconds, the digest of its output, what it says."""

    seconds: float
    output: str
    lines: frozenset[str]


@dataclass
class Ended:
    """A run that has ended: its exit code, what is new on standard error, what it left."""

    code: int
    lines: list[str]
    left: list[str]
    output: str


class Runs:
    """Runs of ``clmorph morph``, each in a folder of its own.

    Parameters
    ----------
    device : str or None
    findings : Findings
    """

    def __init__(self, device: str | None, findings: Findings) -> None:
        self.device, self.findings = device, findings
        self.references: dict[str, Reference] = {}

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """Give a folder with two pictures and a place for temporary files."""
        with tempfile.TemporaryDirectory(prefix="faults-") as name:
            folder = Path(name)
            (folder / "tmp").mkdir()
            pictures(folder)
            yield folder

    def output(self, folder: Path, format: str) -> Path:
        """Return where a run writes: new folders, or files with the usual ending."""
        return folder / ("out" + (FORMATS[format].endings or ("",))[0])

    def start(
        self,
        folder: Path,
        format: str,
        changes: dict[str, str | None] | None = None,
        before: Callable[[], None] | None = None,
    ) -> "subprocess.Popen[bytes]":
        """Start a run in a separate session."""
        command = [sys.executable, "-m", "clmorph", "morph", "a.png", "b.png", "--size", "16"]
        command += ["--frames", "3", "--format", format, "-o", self.output(folder, format).name]
        if self.device:
            command += ["--device", self.device]
        changed = {"TMPDIR": str(folder / "tmp")} | (changes or {})
        variables = {**os.environ, **changed}
        with (folder / "tmp" / "errors").open("wb") as errors:
            return subprocess.Popen(
                command, cwd=folder, stdout=subprocess.DEVNULL, stderr=errors, preexec_fn=before,
                env={key: value for key, value in variables.items() if value is not None},
                stdin=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip

    def end(self, process: "subprocess.Popen[bytes]", folder: Path, format: str) -> Ended:
        """Wait for a run, and look at what is left of it."""
        try:
            code = process.wait(HANGS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            code = 124
        known = self.references[format].lines if format in self.references else ()
        told = (folder / "tmp" / "errors").read_text(errors="replace").splitlines()
        output = self.output(folder, format)
        expected = {"a.png", "b.png", "tmp", output.name, "cache"}
        left = [path.name for path in folder.iterdir() if path.name not in expected]
        mine = ("errors", f"clmorph-{os.getuid()}", ".cache")
        left += [f"tmp/{path.name}" for path in (folder / "tmp").iterdir() if path.name not in mine]
        left += [f"process {name}" for name in _session(process.pid)]
        lines = [line for line in told if not line.strip() or line not in known]
        return Ended(code, lines, left, digest(output))

    def measure(self, format: str) -> None:
        """Run undisturbed."""
        with self.folder() as folder:
            began = time.perf_counter()
            ended = self.end(self.start(folder, format), folder, format)
            seconds = time.perf_counter() - began
        if ended.code or not ended.output or ended.left:
            raise SystemExit(f"an undisturbed run of {format} fails: {ended}")
        self.references[format] = Reference(seconds, ended.output, frozenset(ended.lines))

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
        with self.folder() as folder, _small_disk(folder, kilobytes) as before:
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

    def share(self, processes: int) -> None:
        """Start several runs at once with one empty cache."""
        self.findings.trial("share")
        with self.folder() as base:
            changes = {"XDG_CACHE_HOME": str(base / "cache"), "CLMORPH_PROBE_SECONDS": "600"}
            folders = [base / str(number) for number in range(processes)]
            for folder in folders:
                (folder / "tmp").mkdir(parents=True)
                pictures(folder)
            running = [self.start(folder, "gif", changes) for folder in folders]
            for process, folder in zip(running, folders, strict=True):
                self._same("share", str(processes), self.end(process, folder, "gif"))
            parts = [path for path in (base / "cache").rglob("*") if path.suffix == ".part"]
        if parts:
            self.findings.add("share", f"parts left: {parts}", ["--share", str(processes)])

    # --- processes and threads

    def script(self, kind: str, code: str, arguments: list[str], cold: bool) -> None:
        """Run a script that ends with 0 if all is well."""
        self.findings.trial(kind)
        with tempfile.TemporaryDirectory() as folder:
            more = {"XDG_CACHE_HOME": folder} if cold else {}
            try:
                done = subprocess.run(
                    [sys.executable, "-W", "ignore", "-c", code, *arguments], text=True,
                    env={**os.environ, **more, "CLMORPH_PROBE_SECONDS": "600"}, timeout=HANGS,
                    capture_output=True, check=False,
                )  # fmt: skip
                wrong = done.stderr.strip().splitlines()[-1:] if done.returncode else []
                code_of = done.returncode
            except subprocess.TimeoutExpired:
                wrong, code_of = [f"hangs for {HANGS} s"], 124
        if code_of:
            name = arguments[0] if kind == "fork" else "cold"
            self.findings.add(kind, f"exit code {code_of}: {wrong}", [f"--{kind}", name])

    def fork(self, parent: str) -> None:
        """Use OpenCL and NumPy in forked children; parent: has "listed" or "opened" a device."""
        self.script("fork", FORK, [parent, self.device or "auto"], cold=False)

    def threads(self, _: str) -> None:
        """Morph in eight threads at once, with an empty cache."""
        self.script("threads", THREADS, [self.device or "auto"], cold=True)


def _session(leader: int) -> list[str]:
    """Return the names of processes of a session that are still there after a moment."""
    for _ in range(20):
        found = []
        for entry in Path("/proc").glob("[0-9]*/stat"):
            try:
                name, _, rest = entry.read_text().rpartition(") ")
            except OSError:
                continue
            fields = rest.split()
            if fields[3] == str(leader) and fields[0] != "Z":
                found.append(name)
        if not found:
            break
        time.sleep(0.1)
    return found


@contextmanager
def _small_disk(folder: Path, kilobytes: int) -> Iterator[Callable[[], None] | None]:
    """Make a folder a small disk where that is allowed, else give a limit for files."""
    options = f"size={kilobytes + 24}k"  # the pictures and what was there before
    mounted = (
        os.getuid() == 0
        and not subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder],
            capture_output=True,
            check=False,
        ).returncode
    )
    if mounted:
        try:
            (folder / "tmp").mkdir()
            pictures(folder)
            yield None
        finally:
            subprocess.run(["umount", "--lazy", folder], check=False)
        return
    import resource

    yield partial(resource.setrlimit, resource.RLIMIT_FSIZE, (1024 * kilobytes, 1024 * kilobytes))


def _startup() -> float:
    """Seconds that the interpreter takes before clmorph can do anything about a signal."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import clmorph"], check=True)
    return time.perf_counter() - began


def plan(runs: Runs, arguments: argparse.Namespace) -> list[Callable[[], None]]:
    """Return the trials that the command line asks for."""
    one = [
        *(partial(_kill, runs, spec) for spec in arguments.kill),
        *(partial(_fill, runs, spec) for spec in arguments.disk),
        *(partial(_cache, runs, spec) for spec in arguments.cache),
        *(partial(runs.share, int(spec)) for spec in arguments.share),
        *(partial(runs.fork, spec) for spec in arguments.fork),
        *(partial(runs.threads, spec) for spec in arguments.threads),
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
    if arguments.states:
        trials += [partial(runs.fork, "listed"), partial(runs.fork, "opened")]
        trials += [partial(runs.threads, "cold"), partial(runs.share, 4)]
    return trials


def _kill(runs: Runs, spec: str) -> None:
    format, name, seconds, old = spec.split(":")
    runs.kill(format, name, float(seconds), old == "old")


def _fill(runs: Runs, spec: str) -> None:
    format, kilobytes = spec.split(":")
    runs.fill(format, int(kilobytes))


def _cache(runs: Runs, spec: str) -> None:
    damage, _, part = spec.partition(":")
    if part:
        runs.damage(damage, part)
    else:
        runs.misplace(damage)


def main(given: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200, help="runs to be killed")
    parser.add_argument("--disks", type=int, default=11, help="runs on a full disk")
    parser.add_argument("--caches", type=int, default=9, help="runs with a bad cache")
    parser.add_argument(
        "--states", action=argparse.BooleanOptionalAction, default=True,
        help="forks, threads and shared caches",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device")
    parser.add_argument("--jobs", type=int, default=2, help="runs side by side")
    single = parser.add_argument_group("one trial, as a finding names it")
    for name, form in (
        ("kill", "FORMAT:SIGNAL:SECONDS:old|new"), ("disk", "FORMAT:KILOBYTES"),
        ("cache", "DAMAGE:devices|kernels or PLACE"), ("share", "PROCESSES"),
        ("fork", "listed|opened"), ("threads", "cold"),
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
