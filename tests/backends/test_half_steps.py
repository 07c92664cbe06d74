"""Iterations whose vectors stay on the device agree with NumPy's.

The table of checks compares them with their definitions.
"""

import functools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import clmorph
from clmorph.backends import records
from clmorph.backends.interface import MEMORY
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.devices.verdicts import OPTIONAL
from clmorph.backends.opencl.kernels import half_steps
from clmorph.backends.opencl.verification.bench import Bench
from clmorph.backends.opencl.verification.iterations import iterate, start_stored
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.backends.records import START, control_of, next_source
from clmorph.transport._solver.problem import Problem
from clmorph.transport._solver.steps import DeviceSteps, HostSteps, new_steps


@pytest.fixture(autouse=True)
def resident(device):
    """Skip where the host does the arithmetic: with limited loops."""
    if device.constants.longest_loop:
        pytest.skip("its iterations are the host's")


@pytest.mark.parametrize(
    "rho", [(0.3, 0.5), (np.inf, 0.5), (0.3, np.inf), (np.inf, np.inf)], ids=str
)
def test_solves_agree_with_numpy(device, rng, rho):
    """With more iterates than are stored, masses of 0, offsets, and an unequal number of points."""
    found = []
    points = [rng.random((n, 3)) for n in (150, 70)]
    masses = [rng.random(n) for n in (150, 70)]
    for mass in masses:
        mass[::5] = 0
        mass /= mass.sum()
    offsets = [0.1 * rng.random(n) for n in (150, 70)]
    for backend in (device, clmorph.get_backend("numpy")):
        measures = [
            clmorph.WeightedPoints(*each) for each in zip(points, masses, offsets, strict=True)
        ]
        reach = tuple(None if np.isinf(each) else each**0.5 for each in rho)
        found.append(clmorph.sinkhorn(*measures, blur=0.05, reach=reach, tol=1e-6, backend=backend))
    ours, theirs = found
    assert ours.converged
    assert len(ours.residuals) > 18
    assert ours.n_iter <= 1.3 * theirs.n_iter + 3
    shift = 0.0 if np.isfinite(rho).any() else (ours.f - theirs.f)[1]
    for one, other, sign in ((ours.f, theirs.f, -1), (ours.g, theirs.g, 1)):
        assert np.abs(one + sign * shift - other).max() <= 1e-3 * 0.05**2


def steps_of(device, rng, sizes=(40, 30)):
    measures = [clmorph.WeightedPoints(rng.random((n, 2)), np.full(n, 1 / n)) for n in sizes]
    return new_steps(Problem.between(device, *measures, (0.3, 0.5)))


def test_one_iteration_of_two_at_a_time(device):
    """Two iterations on a device, one step each in turn, are as each alone."""

    def begun(sizes):
        steps = steps_of(device, np.random.default_rng(sizes), sizes)
        steps.begin(np.zeros(sizes[1]), 0.01, False)
        return steps

    sizes = (40, 30), (130, 64)
    alone = [[advance(steps) for _ in range(5)] for steps in map(begun, sizes)]
    both = list(map(begun, sizes))
    for number in range(5):
        assert [advance(own) for own in both] == [values[number] for values in alone]


def advance(steps):
    found = *steps.update_rows(), *steps.update_columns()
    steps.go_on(True)
    return found


@pytest.fixture
def solve(device, rng):
    measures = [clmorph.WeightedPoints(rng.random((n, 3)), np.full(n, 1 / n)) for n in (60, 50)]
    return functools.partial(clmorph.sinkhorn, *measures, blur=0.1, reach=0.5, backend=device)


def test_threads_iterate_in_turn(solve):
    wanted = solve()
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(lambda _: solve().g, range(15)))
    assert all(np.array_equal(each, wanted.g) for each in found)


def test_where_the_device_does_not_iterate_the_host_does(device, solve, rng, monkeypatch):
    """Many tiles, and softmins that could take too long for one launch."""
    assert isinstance(steps_of(device, rng), DeviceSteps)
    wanted = solve()
    with monkeypatch.context() as patch:
        patch.setattr(half_steps, "MOST_PAIRS", 0)
        assert isinstance(steps_of(device, rng), HostSteps)
        found = solve()
    assert np.abs(found.g - wanted.g).max() <= 1e-3 * 0.1**2
    monkeypatch.setattr(half_steps, "MOST_LEVELS", 0)
    assert isinstance(steps_of(device, rng), HostSteps)


def test_a_fast_card_iterates_over_more_pairs(device, rng, monkeypatch):
    monkeypatch.setattr(half_steps, "MOST_PAIRS", 0)
    clouds = [device.upload(rng.random((70, 3)), np.full(70, 1 / 70)) for _ in range(2)]
    given = *clouds, (np.full(70, 1 / 70),) * 2, (0.0, 1.0)
    started = [
        half_steps.HalfSteps(device.row_loop, device._take_turns, factor).start_iteration(*given)
        for factor in (1, 8)
    ]
    assert [each is None for each in started] == [True, False]


def test_iterations_over_stored_pairs_leave_the_same_bytes(device):
    """Work-groups of a runtime that share local memory by mistake would not."""
    case = Bench(device).clouds(3, columns=5003)[1]
    found = []
    for _ in range(4):
        iteration = start_stored(case, (np.inf, np.inf))[0]
        iteration.set_potential(np.zeros(5003), case.epsilon, False)
        source = START
        for number in range(40):
            place, count = (number - 1) % MEMORY if number else 0, min(number, MEMORY)
            control = control_of(source, number > 0, place, count)
            iteration.iterate(control, 30.0)
            source = next_source(control, number > 1)
        found.append(iteration.potentials())
    np.testing.assert_equal(found, [found[0]] * 4)


REFUSED = "refused: 1:1: error: no dominating alternative"


@pytest.mark.parametrize("kind", ["one", "many", "stored", "levels"])
def test_where_kernels_cannot_be_built_the_host_does_their_work(device, rng, monkeypatch, kind):
    """A refused program of iterations, or of levels between tiles, costs only itself, told once."""
    if kind == "levels" and not device.has_float64:
        pytest.skip("its levels are the host's")

    def fresh():
        return OpenCLOperations(device.device, device.constants, verify=False)

    clouds = [clmorph.WeightedPoints(rng.random((n, 3)), np.full(n, 1 / n)) for n in (60, 50)]

    def solve(backend):
        if kind == "stored":
            case = Bench(backend).clouds(3)[0]
            return np.array([finding.passed for finding in iterate(case, 0, True)])
        if kind == "levels":
            backend.row_loop.device_levels = 0
            cloud = backend.upload(clouds[0].points, clouds[0].weights)
            return backend.softmin(cloud, cloud, np.zeros(60), 0.1)
        if kind == "one":
            return clmorph.sinkhorn(*clouds, blur=0.1, reach=0.5, backend=backend).g
        many = [[cloud, cloud] for cloud in clouds]
        return clmorph.sinkhorn_batch(*many, blur=0.1, reach=0.5, backend=backend)[1].g

    wanted = solve(fresh())
    build, asked = program.build, []

    def refuse(context, name, *more):
        if name in (*OPTIONAL, "tile_levels.cl"):
            asked.append(name)
            raise records.ProgramError(REFUSED)
        return build(context, name, *more)

    monkeypatch.setattr(program, "build", refuse)
    monkeypatch.setattr(records, "_told", set())
    operations = fresh()
    with pytest.warns(clmorph.ClmorphWarning, match=f"on the host.*{REFUSED}") as told:
        found = solve(operations)
    assert len(told) == len(asked) == 1
    if kind == "stored":
        assert wanted.any()
        assert len(found) == 0
        return
    assert np.abs(found - wanted).max() <= 1e-3 * 0.1**2
    assert np.array_equal(solve(operations), found)  # without another warning


def test_the_probe_says_that_optional_kernels_cannot_be_built(device, monkeypatch):
    """And not that they compute wrongly."""
    operations = OpenCLOperations(device.device, device.constants, verify=False)
    monkeypatch.setattr(
        operations.programs, "kernels", lambda variant: (_ for _ in ()).throw(ValueError(REFUSED))
    )
    for file in OPTIONAL:
        with pytest.raises(ValueError, match=REFUSED):
            first_failure(operations, Variant(file))
