"""Every operation, and one solve, divergence and morph, at sizes for a slow device."""

from dataclasses import replace

import numpy as np
import pytest
from clouds import drawings
from exercise_kernels import exercise

from clmorph import lift, morph, sinkhorn, sinkhorn_batch, sinkhorn_divergence
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build.constants import (
    apply_quirks,
    choose_constants,
    cpu_constants,
    gpu_constants,
    lanes_constants,
)
from clmorph.backends.opencl.devices.quirks import QUIRKS, find_quirks
from clmorph.backends.opencl.verification.bench import Bench
from clmorph.backends.records import PlanTerms
from clmorph.reference import NumPyOperations

pytestmark = pytest.mark.small

#: The builds of CPUs and GPUs, and each quirk in the build that the device gets; all with the
#: device's own quirks.
BUILDS = {
    "scalar-16": gpu_constants(16),
    "scalar-64": gpu_constants(64),
    "scalar-256": replace(gpu_constants(256), group=256, tile=256),
    "lanes": lanes_constants(64),
    "vector-4": cpu_constants(4),
    "vector-8": cpu_constants(8),
    "vector-16": cpu_constants(16),
    "pairs": replace(gpu_constants(64), precise=1, float64=0),
}


def pictures(side):
    one, two = drawings(side)
    return one, two[:, : side - 2]


def test_every_operation(each_device):
    for ours, theirs in zip(exercise(each_device), exercise(NumPyOperations()), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def by_both(function, device, *given, **options):
    """What a function returns with a device, and with NumPy."""
    return (function(*given, **options, backend=backend) for backend in (device, "numpy"))


def test_a_solve(each_device):
    ours, theirs = by_both(sinkhorn, each_device, *map(lift, pictures(9)))
    assert ours.converged
    assert np.abs(ours.f - theirs.f).max() <= 0.03 * ours.epsilon


def test_solves_at_once(each_device):
    measures = [lift(picture) for side in (3, 9, 4) for picture in pictures(side)]
    ours, theirs = by_both(sinkhorn_batch, each_device, measures[::2], measures[1::2])
    assert ours.converged
    for one, other in zip(ours, theirs, strict=True):
        assert np.abs(one.f - other.f).max() <= 0.03 * one.epsilon


def test_a_divergence(each_device):
    ours, theirs = by_both(sinkhorn_divergence, each_device, *map(lift, pictures(8)))
    assert ours.value == pytest.approx(theirs.value, rel=1e-4, abs=1e-7)


def test_a_morph(each_device):
    ours, theirs = by_both(morph, each_device, *pictures(9), n_frames=3)
    for got, want in zip(ours.frames, theirs.frames, strict=True):
        assert np.abs(got - want).max() <= 1 / 255


def few_results(operations):
    """Results of some of the operations, with every kernel file among them."""
    rng = np.random.default_rng(3)
    points, masses = [rng.random((n, 3)) for n in (130, 70)], [np.full(n, 1 / n) for n in (130, 70)]
    rows, columns = map(operations.upload, points, masses)
    f, g, epsilon = 0.1 * rng.random(130), 0.1 * rng.random(70), 0.05
    softmin = NumPyOperations().softmin(*map(NumPyOperations().upload, points, masses), g, epsilon)
    limits = np.full(130, -40.0), np.full(70, np.inf)
    results = [
        operations.softmin(rows, columns, g, epsilon),
        operations.softmin(rows, columns, g, epsilon, True),
        operations.near_pairs(rows, columns, g, softmin, epsilon, 1e-6).softmin,
        operations.plan_rows(PlanTerms(rows, columns, f, g, epsilon, *limits)).mass,
        *operations.barycentric_projection(rows, columns, g, epsilon),
        *operations.plan_moments(rows, columns, g, softmin, epsilon),
    ]
    stored = operations.store_pairs(PlanTerms(rows, columns, f, g, epsilon, *limits), 10**6)
    results.append(operations.sum_stored(stored, g, False))
    splats = operations.upload_splats(
        rng.uniform(-3, 30, (200, 2)).astype(np.float32),
        rng.random((200, 3)).astype(np.float32),
        rng.random(200).astype(np.float32),
    )
    for method in ("gather", "moments"):
        with Bench(operations).forced("splatting", "method", method):
            results += operations.splat(splats, (19, 23), 2.0, 9.0)
    return results


@pytest.mark.full
@pytest.mark.parametrize("build", [*BUILDS, *QUIRKS])
def test_each_build_and_each_quirk(each_device, build):
    device = each_device.device
    quirks = find_quirks(device)
    if build in QUIRKS:
        constants = choose_constants(device, quirks | {build})
    else:
        constants = apply_quirks(BUILDS[build], quirks)
    if constants.group > device.max_work_group_size:
        pytest.skip("the device's work-groups are smaller")
    if build.startswith("vector") and device.native_vector_width_float == 1:
        pytest.skip("no device without vectors gets them")
    got = few_results(OpenCLOperations(device, constants, verify=False))
    for ours, theirs in zip(got, few_results(NumPyOperations()), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-4, atol=2e-5)
