"""Faults of drivers, each shown by a kernel of a few lines, and that our builds go around them.

A fault that is gone makes its test fail on that driver, so that its quirk is retired.
"""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest

from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import (
    apply_quirks,
    choose_constants,
    gpu_constants,
    lanes_constants,
)
from clmorph.backends.opencl.build.program import _build
from clmorph.backends.opencl.devices.quirks import LONGEST_LOOP, find_quirks
from clmorph.backends.records import PlanTerms
from clmorph.reference import NumPyOperations

REFERENCE = NumPyOperations()

#: Loops whose number of rounds is known; `out` is 0 before.
LOOPS = """
// One loop of n rounds.
__kernel void count_rounds(const uint n, __global uint* out)
{
    uint count = 0;
    for (uint i = 0; i < n; ++i)
        count += 1 + out[get_global_id(0)];
    out[get_global_id(0)] = count;
}

// A loop whose end depends on memory, and one of ten rounds after it: all steps are 1.
__kernel void count_after(const uint n, __global const uint* steps, __global uint* out)
{
    uint taken = 0;
    while (taken < n)
        taken += steps[get_global_id(0)];
    uint count = 0;
    for (uint i = 0; i < 2 * taken; ++i)
        count += 1 + out[get_global_id(0)];
    out[get_global_id(0)] = count;
}
"""


def run(operations, name, n, group, *arrays):
    """Run a kernel of LOOPS over 64 work-items in groups; return its results."""
    context, queue = operations.context, operations.queue
    program = cl._Program(context, LOOPS)
    _build(program, operations.device, ["-cl-std=CL1.2"])
    kernel = cl.Kernel(cl.Program(program), name)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    out = np.zeros(64, np.uint32)
    buffers = [cl.Buffer(context, flags, hostbuf=array) for array in (*arrays, out)]
    for number, argument in enumerate((np.uint32(n), *buffers)):
        kernel.set_arg(number, argument)
    cl.enqueue_nd_range_kernel(queue, kernel, (64,), (group,)).wait()
    cl.enqueue_copy(queue, out, buffers[-1])
    return out


def ends_loops(operations):
    return "short_loops" in find_quirks(operations.device)


@pytest.mark.small
def test_loops_of_any_length(each_device):
    """Llvmpipe ends loops after 65535 rounds; a device without the quirk must take them all."""
    assert np.all(run(each_device, "count_rounds", LONGEST_LOOP, 64) == LONGEST_LOOP)
    found = run(each_device, "count_rounds", 200_000, 64)
    if ends_loops(each_device):
        assert np.all(found == LONGEST_LOOP), "loops are no longer cut: retire short_loops here"
    else:
        assert np.all(found == 200_000), "the device cuts loops: it needs the quirk short_loops"


@pytest.mark.small
def test_loops_of_groups_that_do_not_fill_lanes(each_device):
    """Llvmpipe runs lanes without a work-item too, on zeros, until it cuts their loop.

    After that, loops of the work-items end after one round. So a loop whose end depends on memory
    must have another bound beside it, as in ``sample_plan_rows``.
    """
    steps = np.ones(64, np.uint32)
    assert np.all(run(each_device, "count_after", 10, 64, steps) == 20)
    found = run(each_device, "count_after", 10, 1, steps)
    if ends_loops(each_device):
        assert np.all(found < 20), "lanes without a work-item end their loops now: say so here"
    else:
        assert np.all(found == 20)


# --- our kernels on devices that cut loops -------------------------------------------------------

BUILDS = {
    "chosen": choose_constants,
    "lanes": lambda device: lanes_constants(device.max_work_group_size),
    "scalar-64": lambda device: gpu_constants(64),
}


def uploaded(operations, *clouds):
    return [operations.upload(cloud, np.full(len(cloud), 1 / len(cloud))) for cloud in clouds]


def clouds(operations, rng, n, m):
    return uploaded(operations, rng.random((n, 3)), rng.random((m, 3)))


def every_row_reduction(operations):
    """Results of the kernels that loop over columns, for 70 rows and 700 columns."""
    rng = np.random.default_rng(5)
    rows, columns = clouds(operations, rng, 70, 700)
    g, epsilon = 0.01 * rng.random(700), 0.02
    f = REFERENCE.softmin(*clouds(REFERENCE, np.random.default_rng(5), 70, 700), g, epsilon)
    thresholds = np.sort(rng.random((70, 40)), axis=1)
    near = operations.near_pairs(rows, columns, g, f, epsilon, 1e-4)
    plan = operations.plan_rows(
        PlanTerms(rows, columns, f, g, epsilon, np.full(70, -14.0), np.full(700, np.inf))
    )
    same = [near.pairs.tiles, plan.indptr, plan.indices, plan.mass]
    for pairs in (None, near):
        same += operations.plan_moments(rows, columns, g, f, epsilon, False, pairs)
        same.append(
            operations.sample_plan_rows(rows, columns, g, f, epsilon, thresholds, False, pairs)
        )
    nearly = [near.softmin, near.skipped]
    nearly += [
        operations.softmin(rows, columns, g, epsilon, False, pairs) for pairs in (None, near)
    ]
    for pairs in (None, near):
        nearly += operations.barycentric_projection(rows, columns, g, epsilon, False, pairs)
    nearly.append(operations.bounded_softmin(rows, columns, g, epsilon)[0])
    return same, nearly


@pytest.mark.parametrize("build", BUILDS)
def test_short_launches_over_columns_change_nothing(device, build):
    """Kernels that go on where the launch before ended give the same bits.

    Sums of the log-sum-exp are joined on the host, in float64, which changes their rounding.
    """
    constants = apply_own(device, BUILDS[build](device.device))
    short = every_row_reduction(
        OpenCLOperations(device.device, replace(constants, longest_loop=7000), verify=False)
    )
    whole = every_row_reduction(OpenCLOperations(device.device, constants, verify=False))
    np.testing.assert_equal(short[0], whole[0])
    for got, want in zip(short[1], whole[1], strict=True):
        np.testing.assert_allclose(got, want, rtol=0, atol=0.02 * 1e-5)


@pytest.mark.parametrize("build", BUILDS)
@pytest.mark.parametrize("method", ["gather", "moments"])
def test_short_launches_over_particles(device, method, build, rng):
    """Splats of many particles in one place, in launches over few, are sorted and summed alike."""
    constants = apply_own(device, BUILDS[build](device.device))
    positions = rng.normal(20, 3, (5000, 2)).astype(np.float32)
    colors = rng.random((5000, 3)).astype(np.float32)
    results = []
    for longest in (7000, constants.longest_loop):
        operations = OpenCLOperations(
            device.device, replace(constants, longest_loop=longest), verify=False
        )
        operations.splatting.method = method
        splats = operations.upload_splats(positions, colors, np.ones(5000, np.float32))
        bins = operations.bin_splats(splats, (40, 41), 1)
        results.append((bins.order, *operations.splat(splats, (40, 41), 2.0, 9.0)))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    for got, want in zip(results[0][1:], results[1][1:], strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-5, atol=1e-4)


def apply_own(device, constants):
    """Return constants with the device's own quirks."""
    return apply_quirks(constants, find_quirks(device.device))


@pytest.mark.small
def test_draws_from_very_many_columns(each_device, rng):
    """One row of 131072 columns: more rounds than llvmpipe takes in one launch."""
    m, epsilon = 1 << 17, 1.0
    points = rng.random((3, 2)), rng.random((m, 2))
    thresholds = np.tile((np.arange(50) + 0.5) / 50, (3, 1))
    found, g = [], np.zeros(m)
    for operations in (each_device, REFERENCE):
        rows, columns = uploaded(operations, *points)
        softmin = operations.softmin(rows, columns, g, epsilon)
        draws = operations.sample_plan_rows(rows, columns, g, softmin, epsilon, thresholds)
        found.append((softmin, points[1][draws].mean(axis=1)))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-5)
    # Draws at equal steps of the running sum have the mean of the plan's row, however ordered.
    np.testing.assert_allclose(found[0][1], found[1][1], atol=0.25)
    assert draws.max() > m // 2


def test_draws_stay_in_their_row_whatever_the_offsets(device, rng):
    """Sums far above 1 end the draws of a row, and do not write into the next one."""
    rows, columns = clouds(device, rng, 70, 700)
    g, epsilon = np.zeros(700), 0.1
    softmin = device.softmin(rows, columns, g, epsilon)
    softmin[::2] += 1.0
    thresholds = np.tile([0.1, 0.5, 0.9], (70, 1))
    wrong = device.sample_plan_rows(rows, columns, g, softmin, epsilon, thresholds)
    softmin[::2] -= 1.0
    right = device.sample_plan_rows(rows, columns, g, softmin, epsilon, thresholds)
    np.testing.assert_array_equal(wrong[1::2], right[1::2])
    assert wrong.min() >= 0
    assert wrong.max() < 700
