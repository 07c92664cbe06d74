"""Common parts of the tools that search for faults: pictures, findings, digests."""

import hashlib
import shlex
import sys
import threading
from pathlib import Path

import numpy as np
from PIL import Image


class Findings:
    """Faults, printed one a line as they are found, each with the command that repeats it.

    Every such command has the options `common`, such as the device's.
    """

    def __init__(self, common: list[str]) -> None:
        self._common = common
        self._lock = threading.Lock()
        self.tried: dict[str, int] = {}
        self.found: dict[str, int] = {}

    def trial(self, kind: str) -> None:
        """Count a trial."""
        with self._lock:
            self.tried[kind] = self.tried.get(kind, 0) + 1

    def add(self, kind: str, what: str, repeat: list[str]) -> None:
        """Print a fault; repeat: the options that repeat it."""
        command = ["python", f"tools/{Path(sys.argv[0]).name}", *repeat, *self._common]
        with self._lock:
            self.found[kind] = self.found.get(kind, 0) + 1
            print(f"FINDING {kind}: {what} -- repeat: {shlex.join(command)}", flush=True)

    def end(self) -> int:
        """Print the summary and return the exit code."""
        counts = ", ".join(
            f"{kind} {self.tried.get(kind, 0)} tried, {self.found.get(kind, 0)} found"
            for kind in {**self.tried, **self.found}
        )
        print(f"{sum(self.found.values())} findings ({counts or 'nothing tried'})", flush=True)
        return min(1, sum(self.found.values()))


def pictures(folder: Path, side: int = 16) -> list[Path]:
    """Write two small pictures and return their paths."""
    rng = np.random.default_rng(0)
    paths = []
    for name in ("a.png", "b.png"):
        coarse = rng.integers(0, 256, (4, 4, 3), np.uint8)
        paths.append(folder / name)
        Image.fromarray(coarse).resize((side, side), Image.Resampling.BICUBIC).save(paths[-1])
    return paths


def digest(place: Path) -> str:
    """Return a digest of a file, or of a folder's files and their names; '' if there is none."""
    if not place.exists():
        return ""
    files = [place] if place.is_file() else sorted(place.rglob("*"))
    whole = hashlib.sha256()
    for file in files:
        whole.update(b"" if file is place else str(file.relative_to(place)).encode() + b"\0")
        whole.update(file.read_bytes() if file.is_file() else b"")
    return whole.hexdigest()
