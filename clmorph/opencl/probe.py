"""Try the kernels on one device; run as ``python -m clmorph.opencl.probe INDEX``.

Prints one line of JSON: usable, reason, pairs_per_second.
"""

import json
import sys
from typing import Any

import numpy as np

from clmorph.check import throughput
from clmorph.errors import ClmorphError
from clmorph.opencl.device import raw_devices
from clmorph.opencl.operations import OpenCLOperations
from clmorph.operations import Operations
from clmorph.reference.operations import NumPyOperations

#: Points of the timed log-sum-exp; small enough for any device.
TIMED_POINTS = 2048


def _wrong_result(operations: OpenCLOperations) -> str:
    """Compare a small log-sum-exp and a small splat with NumPy: what is wrong, or ''."""
    random = np.random.default_rng(0)
    points = [random.random((n, 5)) for n in (130, 70)]
    potential = 0.1 * random.random(70)
    values, sums = [], []
    backends: tuple[Operations, ...] = (operations, NumPyOperations())
    for backend in backends:
        rows, columns = (backend.upload(cloud, np.full(len(cloud), 0.01)) for cloud in points)
        values.append(backend.softmin(rows, columns, potential, 0.01))
        splats = backend.upload_splats(
            (40 * points[0][:, :2]).astype(np.float32),
            points[0][:, 2:].astype(np.float32),
            np.ones(130, np.float32),
        )
        sums.append(backend.splat(splats, (33, 40), 1.0, 4.0)[1])
    if not np.allclose(values[0], values[1], rtol=0, atol=1e-5):
        return f"wrong log-sum-exp (off by {np.abs(values[0] - values[1]).max():.2g})"
    if not np.allclose(sums[0], sums[1], rtol=1e-4, atol=1e-4):
        return f"wrong splat (off by {np.abs(sums[0] - sums[1]).max():.2g})"
    return ""


def probe(index: str) -> dict[str, Any]:
    """Return the verdict on the device of this index."""
    device = dict(raw_devices())[index]
    try:
        operations = OpenCLOperations(device)
        reason = _wrong_result(operations)
        speed = 0.0 if reason else throughput(operations, TIMED_POINTS)
    except ClmorphError as error:
        return {"usable": False, "reason": str(error).split(";")[0], "pairs_per_second": 0.0}
    except Exception as error:  # a driver's errors come in any class; the reason is shown
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return {"usable": False, "reason": reason, "pairs_per_second": 0.0}
    return {"usable": not reason, "reason": reason, "pairs_per_second": speed}


if __name__ == "__main__":
    verdict = probe(sys.argv[1])
    print()
    print(json.dumps(verdict), flush=True)
