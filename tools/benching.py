"""Shared by benches: pictures, tables, kernels, memory, and cases with a process of their own."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.interface import Operations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.select import get_backend

#: Titles of `KernelClock.cells`.
OF_KERNELS = "kernels, s", "longest launch, ms"


def photographs(shape: tuple[int, int]) -> list[np.ndarray]:
    """Return two photographs of a shape."""
    from skimage import data
    from skimage.transform import resize

    images = data.astronaut()[50:450, 50:450], data.chelsea()[:, 75:375]
    return [resize(image / 255, shape, anti_aliasing=True) for image in images]


def line(*cells: object) -> str:
    """Return one line of a Markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def print_head(*cells: object) -> None:
    """Print the head of a Markdown table."""
    print(line(*cells))
    print(line(*["---"] * len(cells)), flush=True)


def profiled(device: str) -> Operations:
    """Return a backend whose kernels its own clock measures, if it is an OpenCL device."""
    found = get_backend(device)
    return OpenCLOperations(found.device, profiled=True) if hasattr(found, "device") else found


class KernelClock:
    """Seconds of a profiled device's kernels, and its longest launch, from now on."""

    def __init__(self, operations: Operations | None) -> None:
        self._work: Any = getattr(operations, "work", None)
        if self._work is not None:
            self._work.device_seconds, self._work.longest_launch = 0.0, (0.0, "")

    def cells(self) -> tuple[str, str]:
        """Return both for a table; nothing of a backend without kernels."""
        if self._work is None:
            return "", ""
        longest, name = self._work.longest_launch
        return f"{self._work.device_seconds:.3g}", f"{1e3 * longest:.1f} ({name})"


def resident_bytes(which: str) -> int:
    """Return the resident size of this process, now ("VmRSS") or at its largest ("VmHWM")."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(row.split()[1] for row in lines if row.startswith(which)))


def begin_memory() -> int:
    """Forget the largest resident size so far, and return the present one."""
    Path("/proc/self/clear_refs").write_text("5")
    return resident_bytes("VmRSS")


def in_own_process(file: str, *arguments: str) -> dict[str, Any]:
    """Run a tool for one case, which prints JSON; "failed" is the reason why there is none."""
    command = [sys.executable, "-W", "ignore", file, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
        return {"failed": lines[-1][:80]}
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


class CountedBuffer(cl.Buffer):
    """A buffer that counts the bytes of all buffers; `cl.Buffer` is replaced by it."""

    now = most = 0

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        CountedBuffer.now += self.size
        CountedBuffer.most = max(CountedBuffer.most, CountedBuffer.now)

    def __del__(self) -> None:
        CountedBuffer.now -= self.size
