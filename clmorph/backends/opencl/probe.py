"""Test the kernels on one device; run as ``python -m clmorph.backends.opencl.probe INDEX``.

Prints one line of JSON: usable, reason, pairs_per_second, lasting.
"""

import contextlib
import json
import os
import sys
import threading
from typing import Any

import numpy as np
import pyopencl as cl

from clmorph.backends.comparison import LARGEST_BOUND
from clmorph.backends.interface import Operations
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import raw_devices
from clmorph.backends.opencl.devices.throughput import throughput
from clmorph.backends.opencl.devices.verdicts import LOADED
from clmorph.errors import ClmorphError

#: The number of points of the timed log-sum-exp, small enough for any device.
TIMED_POINTS = 2048
#: Error codes of a driver whose resources are in use by this process or another one.
PASSING = (
    cl.status_code.DEVICE_NOT_AVAILABLE,
    cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE,
    cl.status_code.OUT_OF_HOST_MEMORY,
    cl.status_code.OUT_OF_RESOURCES,
)


def _wrong_result(operations: OpenCLOperations) -> str:
    """Compare a small log-sum-exp and a small splat with NumPy; return the fault found, or ''."""
    random = np.random.default_rng(0)
    points = [random.random((n, 5)) for n in (130, 70)]
    potential = 0.1 * random.random(70)
    values, sums, bounded = [], [], []
    backends: tuple[Operations, ...] = (operations, NumPyOperations())
    for backend in backends:
        rows, columns = (backend.upload(cloud, np.full(len(cloud), 0.01)) for cloud in points)
        values.append(backend.softmin(rows, columns, potential, 0.01))
        bounded.append(backend.bounded_softmin(rows, columns, potential, 0.01))
        splats = backend.upload_splats(
            (40 * points[0][:, :2]).astype(np.float32),
            points[0][:, 2:].astype(np.float32),
            np.ones(130, np.float32),
        )
        sums.append(backend.splat(splats, (33, 40), 1.0, 4.0)[1])
    if not np.allclose(values[0], values[1], rtol=0, atol=1e-5):
        return f"wrong log-sum-exp (off by {np.abs(values[0] - values[1]).max():.2g})"
    off, bound = np.abs(bounded[0][0] - bounded[1][0]).max(), bounded[0][1] + bounded[1][1]
    if not off <= 0.01 * bound <= 0.01 * LARGEST_BOUND:
        return f"wrong log-sum-exp with a bound (off by {off / 0.01:.2g}, bound {bound:.2g})"
    if not np.allclose(sums[0], sums[1], rtol=1e-4, atol=1e-4):
        return f"wrong splat (off by {np.abs(sums[0] - sums[1]).max():.2g})"
    return ""


def probe(index: str) -> dict[str, Any]:
    """Return the verdict on the device with this index: see `opencl.devices.verdicts.run_probe`."""
    found = dict(raw_devices())
    if index not in found:
        return _failure("its probe did not find it", lasting=False)
    try:
        operations = OpenCLOperations(found[index])
        reason = _wrong_result(operations)
        speed = 0.0 if reason else throughput(operations, TIMED_POINTS)
    except Exception as error:  # a driver's errors come in any class; the reason is shown
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        if isinstance(error, ClmorphError):
            reason = str(error).split(";")[0]
        return _failure(reason, lasting=not _is_passing(error))
    if reason:
        return _failure(reason, lasting=True)
    return {"usable": True, "reason": "", "pairs_per_second": speed, "lasting": True}


def _failure(reason: str, lasting: bool) -> dict[str, Any]:
    return {"usable": False, "reason": reason, "pairs_per_second": 0.0, "lasting": lasting}


def _is_passing(error: BaseException | None) -> bool:
    """Return whether an error, or its cause, is temporary and not a fault of the driver."""
    if error is None:
        return False
    if isinstance(error, MemoryError | OSError):
        return True
    code = error.code if isinstance(error, cl.Error) else cl.status_code.SUCCESS
    return code in PASSING or _is_passing(error.__cause__)


def end_with_parent() -> None:
    """End this process when its standard input is closed, whose other end its parent holds.

    So a probe of a driver that hangs ends with its parent, even if the parent is killed.
    """

    def wait() -> None:
        # The thread does not read `sys.stdin`, because it would hold its lock at exit.
        with contextlib.suppress(OSError):
            while os.read(0, 1):
                pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


if __name__ == "__main__":
    end_with_parent()
    # The driver may crash from here on, so this line is printed first.
    print(LOADED, flush=True)
    verdict = probe(sys.argv[1])
    print()
    print(json.dumps(verdict), flush=True)
