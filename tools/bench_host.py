"""Measure what a solve takes beside its kernels, and count what it asks of the device.

    python tools/bench_host.py --devices intel debian --points 256 1024 4096

Uniform points in a cube, blur 0.05, reach 0.5, a tolerance of 10^-3 epsilon. The time of the
kernels is that of their profiling events; all the rest is the host's: the solver's arithmetic,
launches, transfers and waits, with the preparation of the points and the certificate. Times are the
least of several solves. The counts are for one softmin, as means over a solve.
"""

import argparse
import time
from typing import Any
from unittest import mock

import numpy as np
import pyopencl as cl
from count_transfers import TransferCount

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations

#: Number of timed solves.
REPEATS = 12


def kernel_seconds(operations: OpenCLOperations, solve: Any) -> float:
    """Return how long the kernels of a solve run on the device."""
    profiling = cl.command_queue_properties.PROFILING_ENABLE
    queue = cl.CommandQueue(operations.context, operations.device, profiling)
    launch, events = cl.enqueue_nd_range_kernel, []

    def launched(*arguments: Any) -> cl.Event:
        events.append(launch(*arguments))
        return events[-1]

    with (
        mock.patch.object(operations.work, "queue", queue),
        mock.patch.object(cl, "enqueue_nd_range_kernel", launched),
    ):
        solve()
    return sum(1e-9 * (event.profile.end - event.profile.start) for event in events)


def counts(operations: OpenCLOperations, solve: Any) -> tuple[int, TransferCount]:
    """Return how many softmins a solve takes, and its commands."""
    with (
        mock.patch.object(operations, "softmin", wraps=operations.softmin) as softmin,
        mock.patch.object(operations, "bounded_softmin", wraps=operations.bounded_softmin) as last,
        TransferCount() as count,
    ):
        solve()
    return softmin.call_count + last.call_count, count


def seconds(solve: Any) -> float:
    """Return how long a solve takes."""
    began = time.perf_counter()
    solve()
    return time.perf_counter() - began


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--devices", nargs="+", default=["auto"], help="names of OpenCL devices")
    parser.add_argument("--points", nargs="+", type=int, default=[256, 1024, 4096])
    options = parser.parse_args()
    print("| device | points | solve, ms | kernels, ms | softmins | host per softmin, ms", end="")
    print(" | launches | waits | bytes read | bytes written |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in options.devices:
        operations = clmorph.get_backend(name)
        assert isinstance(operations, OpenCLOperations), f"{name} is no OpenCL device"
        for n in options.points:
            rng = np.random.default_rng(0)
            source, target = (
                clmorph.WeightedPoints(rng.random((n, 3)) * side, np.full(n, 1 / n))
                for side in (1.0, 0.8)
            )

            def solve(source: Any = source, target: Any = target, ours: Any = operations) -> None:
                clmorph.sinkhorn(source, target, blur=0.05, reach=0.5, tol=1e-3, backend=ours)

            solve()
            softmins, count = counts(operations, solve)
            wall = min(seconds(solve) for _ in range(REPEATS))
            kernels = min(kernel_seconds(operations, solve) for _ in range(REPEATS))
            moved = [count.n_bytes(kind) / softmins for kind in ("read", "write")]
            print(
                f"| {name} | {n} | {1e3 * wall:.1f} | {1e3 * kernels:.1f} | {softmins} | "
                f"{1e3 * (wall - kernels) / softmins:.3f} | {count.n_launches / softmins:.2f} | "
                f"{count.n_waits / softmins:.2f} | {moved[0]:.0f} | {moved[1]:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
