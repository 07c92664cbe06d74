"""Iterations of devices without float64, whose numbers are pairs of float32.

With the quirk `no_float64` the table of checks compares them with their definitions.
"""

import numpy as np
import pyopencl as cl
import pytest

import clmorph
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import apply_quirks
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.resident_iteration import as_pairs, of_pairs
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.steps import DeviceSteps, new_steps


@pytest.fixture
def without_float64(device):
    """A device, as if it had no float64."""
    constants = apply_quirks(device.constants, frozenset({"no_float64"}))
    if constants.longest_loop:
        pytest.skip("its iterations are the host's")
    return OpenCLOperations(device.device, constants, verify=False)


@pytest.mark.filterwarnings("ignore::pyopencl.CompilerWarning")  # Intel's log of success
def test_functions_of_pairs(without_float64, rng):
    """EXP and others are within a few 2^-46 of the result or of the argument."""
    n = 20_000
    x = rng.uniform(-60, 60, n)
    x[: n // 3] = 10.0 ** rng.uniform(-12, 1, n // 3) * rng.choice([-1, 1], n // 3)
    y = 10.0 ** rng.uniform(-15, 15, n)
    y[: n // 4] = 1 + 10.0 ** rng.uniform(-9, 0, n // 4)
    given = [as_pairs(values) for values in (x, y)]
    x, y = (values.sum(axis=-1, dtype=float) for values in given)
    wanted = {
        "EXP(x[i])": (np.exp(x), np.exp(x) * (1 + np.abs(x))),
        "EXPM1(x[i])": (np.expm1(x), np.abs(np.expm1(x)) * (1 + np.abs(x))),
        "EXP2(x[i])": (np.exp2(x), np.exp2(x) * (1 + np.abs(x))),
        "LOG(y[i])": (np.log(y), 1 + np.abs(np.log(y))),
        "LOG2(y[i])": (np.log2(y), 1 + np.abs(np.log2(y))),
        "ROOT(y[i])": (np.sqrt(y), np.sqrt(y)),
        "PLUS(x[i], y[i])": (x + y, np.abs(x) + y),
        "MINUS(x[i], y[i])": (x - y, np.abs(x) + y),
        "TIMES(x[i], y[i])": (x * y, np.abs(x * y)),
        "OVER(x[i], y[i])": (x / y, np.abs(x / y)),
        "LARGER(x[i], y[i])": (np.maximum(x, y), np.abs(x)),
        "SMALLER(x[i], y[i])": (np.minimum(x, y), np.abs(x)),
        "SIZE(x[i])": (np.abs(x), np.abs(x)),
    }
    lines = [f"found[{at} * n + i] = {call};" for at, call in enumerate(wanted)]
    source = (
        f"{program.source('vector_steps.cl')}\n__kernel void compute(__global const real* x, "
        "__global const real* y, __global real* found, const uint n) "
        f"{{ const uint i = get_global_id(0); {' '.join(lines)} }}"
    )
    options = program.build_options(Variant("half_steps.cl").macros(without_float64.constants))
    context, queue = without_float64.context, without_float64.queue
    built = cl.Program(context, source).build(options, cache_dir=False)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(context, flags, hostbuf=values) for values in given]
    found = np.zeros((len(wanted), n))
    result = cl.Buffer(context, flags, hostbuf=found)
    cl.Kernel(built, "compute")(queue, (n,), None, *buffers, result, np.uint32(n))
    cl.enqueue_copy(queue, found, result)
    for ours, (call, (exact, size)) in zip(of_pairs(found), wanted.items(), strict=True):
        assert np.abs((ours - exact) / size).max() <= 2.0**-44, call


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
@pytest.mark.parametrize("reach", [(0.3, 0.3), (None, None), (None, 0.5)], ids=str)
def test_solves_in_pairs(without_float64, rng, reach, scale):
    """At any scale of points and masses, with masses over 12 decades and of 0, and offsets."""
    measures = []
    for n in (150, 70):
        mass = 10.0 ** rng.uniform(-12, 0, n)
        mass[::5] = 0
        offsets = scale**2 * 0.1 * rng.random(n)
        points = scale * rng.random((n, 3))
        measures.append(clmorph.WeightedPoints(points, scale * mass / mass.sum(), offsets))
    scaled = tuple(None if each is None else scale * each for each in reach)
    ours, theirs = (
        clmorph.sinkhorn(*measures, blur=0.02 * scale, reach=scaled, tol=1e-5, backend=backend)
        for backend in (without_float64, "numpy")
    )
    steps = new_steps(Problem.between(without_float64, *measures, (0.3, 0.5)))
    assert isinstance(steps, DeviceSteps)
    assert ours.converged
    assert ours.n_iter <= 4 * theirs.n_iter  # that of float64 is up to four times, too
    balanced = reach == (None, None)
    moved = (ours.f - theirs.f)[measures[0].weights > 0]
    moved -= moved[0] if balanced else 0.0
    assert np.abs(moved).max() <= 1e-2 * (0.02 * scale) ** 2
    if not balanced:
        size = abs(theirs.certificate.dual) + abs(theirs.certificate.primal)
        low, high = ours.certificate.dual, ours.certificate.primal
        assert low <= theirs.certificate.primal + 1e-9 * size
        assert theirs.certificate.dual <= high + 1e-9 * size


def test_what_no_kernel_has_written_is_read_without_a_warning():
    """After one iteration one of both images of g may be any bits; the other one is exact."""
    bits = np.array([[[np.inf, -np.inf], [np.nan, 1.0]], [[1.0, 2.0**-30], [3.0, 0.0]]], np.float32)
    images = bits.view(np.float64)[..., 0]
    np.testing.assert_array_equal(of_pairs(images[:, :1])[1], [1.0 + 2.0**-30])
    np.testing.assert_array_equal(of_pairs(images)[1], [1.0 + 2.0**-30, 3.0])


def test_batches_in_pairs(without_float64, rng, monkeypatch):
    made, start = [], without_float64.start_iteration
    monkeypatch.setattr(
        without_float64, "start_iteration", lambda *a: made.append(start(*a)) or made[-1]
    )
    pairs = []
    for sizes in ((60, 1), (1, 40), (70, 130), (150, 26)):
        pairs.append([
            clmorph.WeightedPoints(rng.random((n, 2)), rng.uniform(0.5, 2, n) / n) for n in sizes
        ])  # fmt: skip
    solve = {"blur": 0.05, "reach": 0.4, "tol": 1e-5, "backend": without_float64}
    found = clmorph.sinkhorn_batch(*zip(*pairs, strict=True), **solve)
    assert made
    assert None not in made
    for together, pair in zip(found, pairs, strict=True):
        alone = clmorph.sinkhorn(*pair, **solve)
        assert together.converged
        assert abs(together.n_iter - alone.n_iter) <= 1
        assert np.abs(together.g - alone.g).max() <= 2e-3 * 0.05**2
