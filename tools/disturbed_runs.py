"""Runs of ``clmorph`` that `faults.py` disturbs, and what they leave."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from findings import Findings, digest, pictures

from clmorph.output.save import FORMATS

#: Seconds after which a run counts as hanging.
HANGS = 180


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


class FoldersOfRuns:
    """Runs of ``clmorph morph``, each in a folder of its own."""

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
        # Figures of memory and time are another run's own.
        lines = [line for line in told if not line.strip() or _without_numbers(line) not in known]
        return Ended(code, lines, left, digest(output))

    def measure(self, format: str) -> None:
        """Run undisturbed."""
        with self.folder() as folder:
            began = time.perf_counter()
            ended = self.end(self.start(folder, format), folder, format)
            seconds = time.perf_counter() - began
        if ended.code or not ended.output or ended.left:
            raise SystemExit(f"an undisturbed run of {format} fails: {ended}")
        self.references[format] = Reference(
            seconds, ended.output, frozenset(map(_without_numbers, ended.lines))
        )


def _without_numbers(line: str) -> str:
    return re.sub(r"[0-9.]+", "0", line)


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
def small_disk(folder: Path, kilobytes: int) -> Iterator[Callable[[], None] | None]:
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
