r"""Run every kernel at small sizes on one device, in every kind of build.

Meant for a simulator that watches memory, races and uninitialized reads:

    PYOPENCL_NO_CACHE=1 oclgrind --log LOG --data-races --uninitialized \
        python tools/exercise_kernels.py Oclgrind

The simulator exits 0 whatever it finds: LOG must be empty. Results are compared with NumPy.
"""

import sys
import time

import numpy as np

from clmorph.opencl.device import raw_devices
from clmorph.opencl.knobs import cpu_knobs, gpu_knobs
from clmorph.opencl.operations import OpenCLOperations
from clmorph.operations import Operations
from clmorph.reference import NumPyOperations

BUILDS = {
    "scalar, groups of 16": gpu_knobs(16),
    "scalar, groups of 64": gpu_knobs(64),
    "vectors of 4": cpu_knobs(4),
    "vectors of 16": cpu_knobs(16),
}


def exercise(operations: Operations) -> list[np.ndarray]:
    """Every operation once, at sizes that divide nothing."""
    rng = np.random.default_rng(1)
    n, m = 130, 67
    weights = rng.random(n)
    weights[::5] = 0
    rows = operations.upload(rng.random((n, 5)), weights)
    columns = operations.upload(rng.random((m, 5)), np.full(m, 1 / m))
    f, g = 0.1 * rng.random(n), 0.1 * rng.random(m)
    results = [
        operations.softmin(rows, columns, g, 0.01),
        operations.softmin(columns, rows, f, 0.01),
        operations.row_maxima(rows, columns, g, 0.01),
        operations.plan_rows(rows, columns, f, g, 0.01, np.full(n, -9.0), np.full(m, np.inf)).mass,
    ]
    moving = operations.upload_particles(
        rng.random((40, 5)), rng.integers(0, 40, (150, 2)).astype(np.uint32), rng.random((150, 2))
    )
    splats = operations.place(moving, 0.3, (20.0, 15.0), (10.0, 7.5))
    results += operations.splat(splats, (16, 21), 1.3, 5.0)
    results += operations.splat(splats, (16, 21), 0.0, 0.5)
    resting = operations.upload_splats(
        rng.uniform(-9, 30, (90, 2)).astype(np.float32),
        rng.random((90, 3)).astype(np.float32),
        rng.random(90).astype(np.float32),
    )
    results.append(operations.bin_splats(resting, (16, 21), 1).order.astype(float))
    results += operations.splat(resting, (16, 21), 0.7, 2.0)
    return results


def main(name: str) -> int:
    device = next((d for _, d in raw_devices() if name in d.platform.name), None)
    if device is None:
        print(f"no OpenCL platform is called {name!r}", file=sys.stderr)
        return 2
    wanted = exercise(NumPyOperations())
    for build, knobs in BUILDS.items():
        began = time.perf_counter()
        got = exercise(OpenCLOperations(device, knobs))
        for number, (ours, theirs) in enumerate(zip(got, wanted, strict=True)):
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5, err_msg=str(number))
        print(f"{build}: {len(got)} results agree, {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
