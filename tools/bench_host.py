"""Measure what a solve takes beside its kernels, and count what it asks of the device.

    python tools/bench_host.py --devices intel debian --points 256 1024 4096

Uniform points in a cube, blur 0.05, reach 0.5, a tolerance of 10^-3 epsilon. The time of the
kernels is that of their profiling events: the softmins' own, and all of them, with the arithmetic
between softmins where it is on the device. All the rest is the host's: launches, transfers and
waits, with the preparation of the points and the certificate. Times are the least of several
solves. The counts are for one softmin, as means over a solve. The main thread's time is that of a
processor's core, outside of waits for the device.
"""

import argparse
import time
from typing import Any
from unittest import mock

import numpy as np
import pyopencl as cl
from benching import line, print_head
from count_transfers import TransferCount

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations

#: The kernel of a softmin; none here takes several launches of it.
SOFTMIN = "log_sum_exp"


def kernel_seconds(
    operations: OpenCLOperations, solve: Any
) -> tuple[float, float, tuple[float, str]]:
    """Return how long the kernels of a solve run: softmins, all of them, and the longest launch."""
    profiling = cl.command_queue_properties.PROFILING_ENABLE
    queue = cl.CommandQueue(operations.context, operations.device, profiling)
    launch, events = cl.enqueue_nd_range_kernel, []

    def launched(queue: Any, kernel: cl.Kernel, *rest: Any, **options: Any) -> cl.Event:
        events.append((kernel.function_name, launch(queue, kernel, *rest, **options)))
        return events[-1][1]

    with (
        mock.patch.object(operations.work, "queue", queue),
        mock.patch.object(cl, "enqueue_nd_range_kernel", launched),
    ):
        solve()
    seconds = [(1e-9 * (event.profile.end - event.profile.start), name) for name, event in events]
    softmins = sum(each for each, name in seconds if name == SOFTMIN)
    return softmins, sum(each for each, _ in seconds), max(seconds)


def main_thread_seconds(solve: Any) -> float:
    """Return how long the main thread computes in a solve, outside of waits for the device."""
    with TransferCount() as count:
        began = time.thread_time()
        solve()
        return time.thread_time() - began - count.seconds_in_waits


def counts(solve: Any) -> tuple[int, TransferCount]:
    """Return how many softmins a solve takes, and its commands."""
    names = []
    with TransferCount() as count:
        launch = cl.enqueue_nd_range_kernel

        def launched(queue: Any, kernel: cl.Kernel, *rest: Any, **options: Any) -> cl.Event:
            names.append(kernel.function_name)
            return launch(queue, kernel, *rest, **options)

        with mock.patch.object(cl, "enqueue_nd_range_kernel", launched):
            solve()
    return names.count(SOFTMIN), count


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
    parser.add_argument("--repeats", type=int, default=12, help="the number of timed solves")
    options = parser.parse_args()
    print_head(
        "device", "points", "solve, ms", "softmins, ms", "all kernels, ms", "softmins",
        "host per softmin, ms", "main thread outside waits, ms", "launches", "waits", "bytes read",
        "bytes written", "longest launch, ms",
    )  # fmt: skip
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
            softmins, count = counts(solve)
            repeats = options.repeats
            wall = min(seconds(solve) for _ in range(repeats))
            outside = min(main_thread_seconds(solve) for _ in range(repeats))
            timed = [kernel_seconds(operations, solve) for _ in range(repeats)]
            own, kernels, (longest, kernel) = (min(each) for each in zip(*timed, strict=True))
            moved = [count.n_bytes(kind) / softmins for kind in ("read", "write")]
            print(line(
                name, n, f"{1e3 * wall:.1f}", f"{1e3 * own:.1f}", f"{1e3 * kernels:.1f}", softmins,
                f"{1e3 * (wall - kernels) / softmins:.3f}", f"{1e3 * outside:.1f}",
                f"{count.n_launches / softmins:.2f}", f"{count.n_waits / softmins:.2f}",
                f"{moved[0]:.0f}", f"{moved[1]:.0f}", f"{1e3 * longest:.1f} ({kernel})",
            ), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
