"""Time the two operations that matter on every usable device: ``python tools/bench_operations.py``.

Prints a Markdown table: point pairs per second through the log-sum-exp, as a share of
the device's measured multiply-add peak; how many times as long it takes with more than float32, in
the exponents alone (precise) and in powers and sums too (with a bound), by float64 and by pairs
of float32; and splats per second. One pair costs about 18 multiply-add slots: 5 for the dot
product, 1 for the maximum, 11 for the exponential, 1 sum.
"""

import argparse
import warnings
from dataclasses import replace

import numpy as np
import pyopencl as cl

from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.opencl.devices.throughput import seconds_of

SLOTS_PER_PAIR = 18

PEAK_SOURCE = """
typedef float{width} vreal;
__kernel void peak(const int n, __global float* out)
{{
    vreal x[16];
    for (int i = 0; i < 16; ++i)
        x[i] = (vreal)(get_global_id(0) * 1e-6f + i);
    for (int k = 0; k < n; ++k)
        #pragma unroll
        for (int i = 0; i < 16; ++i)
            x[i] = x[i] * 0.999f + 0.001f;
    vreal s = x[0];
    for (int i = 1; i < 16; ++i)
        s += x[i];
    vstore{width}(s, get_global_id(0), out);
}}
"""


def best_and_median(action, repeats: int, operations=None) -> tuple[float, float]:
    """Seconds of kernels by the device's own clock, or all of them if no operations are given."""
    seconds = [seconds_of(operations, action) for _ in range(repeats)]
    return min(seconds), float(np.median(seconds))


def multiply_add_peak(operations: OpenCLOperations) -> float:
    """Scalar multiply-adds per second that the device reaches on registers."""
    width = 16 if operations.constants.width > 1 else 2
    program = cl.Program(operations.context, PEAK_SOURCE.format(width=width))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Non-empty compiler output")
        program.build(["-cl-std=CL1.2"])
    kernel = cl.Kernel(program, "peak")
    items = 64 * operations.device.max_compute_units * (1 if width == 16 else 64)
    out = cl.Buffer(operations.context, cl.mem_flags.WRITE_ONLY, 4 * width * items)
    n = 20_000 if width == 16 else 2_000

    def run() -> None:
        kernel(operations.queue, (items,), None, np.int32(n), out).wait()

    run()
    return items * n * 16 * width / best_and_median(run, 7)[0]


def slowdowns(operations: OpenCLOperations, n: int, repeats: int) -> str:
    """How many times as long precise and bounded log-sum-exps take, by float64 and by pairs."""
    told = []
    for precise in (2, 1) if operations.has_float64 else (1,):
        constants = replace(operations.constants, precise=precise)
        wider = OpenCLOperations(operations.device, constants, profiled=True)
        cloud = wider.upload(np.random.default_rng(0).random((n, 5)), np.full(n, 1 / n))
        arguments = cloud, cloud, np.zeros(n), 0.0025
        kinds = (
            lambda: wider.softmin(*arguments),  # noqa: B023
            lambda: wider.softmin(*arguments, True),  # noqa: B023
            lambda: wider.bounded_softmin(*arguments),  # noqa: B023
        )
        for kind in kinds:
            kind()
        plain, *others = (best_and_median(kind, repeats, wider)[0] for kind in kinds)
        told.append(" / ".join(f"{other / plain:.1f}" for other in others))
    return "; ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--particles", type=int, default=300_000)
    parser.add_argument("--repeats", type=int, default=21)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    n, k = options.points, options.particles
    print(
        f"| device | log-sum-exp {n}², 10⁹ pairs/s: median (best) | share of peak | "
        f"times as long, precise / with a bound: float64; pairs | {k} splats, σ 1.4, 64×64: ms | "
        "host beside a log-sum-exp, ms | longest launch, ms |"
    )
    print("|---|---|---|---|---|---|---|")
    for device in find_devices():
        if not device.usable:
            continue
        operations = OpenCLOperations(device.handle, profiled=True)
        cloud = operations.upload(rng.random((n, 5)), np.full(n, 1 / n))
        potential = 0.01 * rng.random(n)
        splats = operations.upload_splats(
            rng.uniform(-0.5, 63.5, (k, 2)).astype(np.float32),
            rng.random((k, 3)).astype(np.float32),
            np.ones(k, np.float32),
        )

        def reduce() -> None:
            operations.softmin(cloud, cloud, potential, 0.0025)  # noqa: B023

        def gather() -> None:
            operations.splat(splats, (64, 64), 1.4, 6.3)  # noqa: B023

        for warm_up in (reduce, gather):
            warm_up()
            warm_up()
        best, median = best_and_median(reduce, options.repeats, operations)
        _, splatting = best_and_median(gather, options.repeats, operations)
        _, whole = best_and_median(reduce, options.repeats)
        longest, name = operations.work.longest_launch
        share = n * n * SLOTS_PER_PAIR / best / multiply_add_peak(operations)
        print(
            f"| {device.name}, {device.platform} {device.driver} | {n * n / median / 1e9:.1f} "
            f"({n * n / best / 1e9:.1f}) | {100 * share:.0f} % | "
            f"{slowdowns(operations, n, options.repeats)} | {1e3 * splatting:.0f} | "
            f"{1e3 * (whole - median):.1f} | {name}, {1e3 * longest:.1f} |"
        )


if __name__ == "__main__":
    main()
