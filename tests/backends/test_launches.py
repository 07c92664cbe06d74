"""Launches stay short, and a device can be shared between threads."""

import functools
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest import mock

import numpy as np
import pyopencl as cl
import pytest
from count_transfers import TransferCount

import clmorph
from clmorph import DeviceError
from clmorph.backends.opencl.kernels import launches, splat
from clmorph.backends.opencl.kernels.launches import LAUNCH_PARTICLES, TARGET_SECONDS, LaunchBudget
from clmorph.transport._solver import steps


@pytest.fixture
def launched(device, monkeypatch):
    """Names, sizes and groups of the launches of a test."""
    found, launch = [], device.work.launch

    def noted(kernel, size, group, *rest, **options):
        found.append((kernel.function_name, size, group))
        launch(kernel, size, group, *rest, **options)

    monkeypatch.setattr(device.work, "launch", noted)
    return found


def ones_at(device, positions):
    """Upload white particles of mass 1."""
    n = len(positions)
    return device.upload_splats(positions, np.ones((n, 3), np.float32), np.ones(n, np.float32))


@pytest.fixture
def clock(monkeypatch):
    """The seconds that launches measure."""
    seconds = [0.0]
    monkeypatch.setattr(launches.time, "perf_counter", lambda: seconds[0])
    return seconds


@pytest.mark.parametrize("rate", [1e5, 1e8, 1e12])
def test_launches_approach_their_length_from_below(clock, rate):
    budget = LaunchBudget(first=1 << 10)
    for _ in range(40):
        pairs = budget.pairs()
        with budget.measure(pairs):
            clock[0] += 1e-4 + pairs / rate
        assert pairs / rate < 0.2
    assert budget.pairs() / rate == pytest.approx(TARGET_SECONDS, rel=0.01)


def test_one_slow_launch_is_survived(clock):
    budget = LaunchBudget()
    budget.learn(10, 1e6)  # the machine slept
    for _ in range(60):
        with budget.measure(budget.pairs()):
            clock[0] += budget.pairs() / 1e9
    assert budget.pairs() > 1e7


def test_no_launch_looks_at_more_than_its_share(device, launched, monkeypatch):
    """A wide kernel over one crowded spot: cut over blocks and over particles."""
    monkeypatch.setattr("clmorph.backends.opencl.kernels.launches.LAUNCH_PARTICLES", 1000)
    splatting = device.splatting
    monkeypatch.setattr(splatting, "method", "gather")
    monkeypatch.setattr(splatting, "_budget", LaunchBudget(first=1))
    monkeypatch.setattr(splatting._budget, "pairs", lambda: 1)
    count = 3500
    splats = ones_at(device, np.full((count, 2), 20.0, np.float32))
    _, cut = device.splat(splats, (40, 40), 30.0, 135.0)
    group = device.constants.tile_group
    blocks = (-(-40 // (device.constants.width * group))) ** 2
    found = [size for name, size, _ in launched if name == "splat"]
    assert found == [(group, group)] * (4 * blocks)
    monkeypatch.undo()
    assert count < LAUNCH_PARTICLES
    _, whole = device.splat(splats, (40, 40), 30.0, 135.0)
    assert np.allclose(cut, whole, rtol=1e-5)


def test_prime_numbers_of_particles_leave_work_groups_whole(device, launched):
    """Where a driver chooses work-groups, it makes them 1 for a prime number of work-items."""
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 40, (1009, 2)).astype(np.float32)
    distances = rng.uniform(0.5, 9, (40, 40))

    def levels_of(part):
        splats = device.adapt_widths(ones_at(device, positions[part]), distances, 1.0)
        return device.width_levels(splats)

    levels = levels_of(slice(None))
    assert [size for _, size, group in launched if group is None] == [(960,), (49,)]
    assert len(set(levels)) > 3
    for part in (slice(0, 960), slice(960, None)):  # the last ones are at their places
        assert np.array_equal(levels_of(part), levels[part])


def test_prime_numbers_of_slices_leave_work_groups_whole(device, launched, monkeypatch, rng):
    """Slices of the list that is sorted into bins; the order in a bin stays."""
    units, splatting = device.device.max_compute_units, device.splatting
    splats = ones_at(device, rng.uniform(0, 40, (5000, 2)).astype(np.float32))
    want = device.bin_splats(splats, (40, 40), 1)
    launched.clear()
    prime = replace(device.constants, slices_per_unit=-(-509 // units))
    monkeypatch.setattr(splatting, "_constants", prime)
    monkeypatch.setattr(splat, "COUNT_ENTRIES", 509 * len(want.starts[1:]))
    monkeypatch.setattr(launches, "LAUNCH_PARTICLES", 3600)
    found = device.bin_splats(splats, (40, 40), 1)
    sizes = [(name, *size) for name, size, _ in launched]
    assert sizes == [(name, size) for name in ("count_bins", "fill_bins") for size in (256, 192)]
    assert np.array_equal(found.order, want.order)
    assert np.array_equal(found.starts, want.starts)


def test_no_launch_sums_more_than_its_share(device, launched, monkeypatch):
    """The same by moments: cut over bins, over particles, and over rows."""
    monkeypatch.setattr("clmorph.backends.opencl.kernels.launches.LAUNCH_PARTICLES", 1000)
    splatting = device.splatting
    monkeypatch.setattr(splatting, "method", "moments")
    monkeypatch.setattr(splatting._moments, "_span", 1)  # as on cards, whose drivers choose groups
    for budget in splatting._moments._budgets.values():
        monkeypatch.setattr(budget, "pairs", lambda: 1)
    count, shape = 3500, (40, 41)
    splats = ones_at(device, np.full((count, 2), 20.0, np.float32))
    _, cut = device.splat(splats, shape, 1.4, 6.3)
    bins = (5 + 2) * (6 + 2)
    group = splatting._moments._group
    sizes = {name: [size for each, size, _ in launched if each == name] for name, *_ in launched}
    assert sizes["sum_moments"] == [(group,)] * (4 * bins)
    for name in ("sum_rows", "sum_columns"):
        assert set(sizes[name]) == {(64, 1)}  # no prime number
    monkeypatch.undo()
    monkeypatch.setattr(splatting, "method", "moments")
    _, whole = device.splat(splats, shape, 1.4, 6.3)
    assert np.allclose(cut, whole, rtol=1e-5)
    assert whole[20, 20] == pytest.approx(count, rel=1e-5)


@pytest.fixture
def uncut(monkeypatch):
    """Launches that are not made shorter, however long one before took on a busy machine."""
    monkeypatch.setattr(LaunchBudget, "pairs", lambda budget: 1 << 22)


@pytest.mark.parametrize("bounded", [False, True])
def test_a_softmin_is_one_launch_and_one_wait(device, rng, bounded, uncut):
    clouds = [device.upload(rng.random((n, 3)), np.full(n, 1 / n)) for n in (130, 200)]
    softmin = device.bounded_softmin if bounded else device.softmin
    arguments = *clouds, rng.random(200), 0.01
    softmin(*arguments)
    set_arg, changed = cl.Kernel.set_arg, []

    def setting(kernel, number, value):
        changed.append(value)
        set_arg(kernel, number, value)

    with TransferCount() as count, mock.patch.object(cl.Kernel, "set_arg", setting):
        softmin(*arguments)
    assert (count.n_launches, count.n_waits) == (1, 1)
    # Scalars are as before, so only buffers are set.
    assert changed
    assert not [value for value in changed if isinstance(value, np.generic)]
    rows, columns = clouds
    stacks = device.constants.stacks(rows.centers.shape[1], bounded)
    shares = device.plan_row_reductions._loop.column_shares(rows, columns, stacks=stacks)
    assert count.n_bytes("read") == 4 * rows.stride * shares * (3 if bounded else 2)
    planes = 2 if bounded else 1
    levels = len(rows.centers) * len(columns.centers)
    assert count.n_bytes("write") == 4 * planes * (columns.stride + levels)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("reach", [0.3, None], ids=str)
def test_an_iteration_waits_once_and_reads_a_few_numbers(device, rng, reach, precision, uncut):
    """No more launches, waits or transfers hide between the softmins of a solve."""
    if precision == "float64" and not device.has_float64:
        pytest.skip("it has no float64")
    measures = [clmorph.WeightedPoints(rng.random((n, 3)), np.full(n, 1 / n)) for n in (60, 50)]

    def solve(n_iter):
        with TransferCount() as count:
            found = clmorph.sinkhorn(
                *measures, blur=0.02, reach=reach, tol=1e-14, max_iter=n_iter, precision=precision,
                verify=False, backend=device,
            )  # fmt: skip
        assert found.n_iter == n_iter
        reads, writes = (count.n_bytes(kind) for kind in ("read", "write"))
        return np.array([count.n_launches, count.n_waits, reads, writes])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", clmorph.ConvergenceWarning)
        solve(5)
        shorter, longer = solve(5), solve(9)
    launches, waits, reads, writes = (longer - shorter) / 4
    if not device.constants.longest_loop:
        # Two softmins, and the arithmetic after each; a few numbers come back.
        assert (launches, waits, writes) == (4, 1, 0)
        assert 0 < reads <= 256
        return
    tile, planes = device.constants.tile, 1 + (precision == "float64")
    assert launches == waits == 2
    shares = 64 if device.constants.width == 1 else 1
    assert 0 < reads <= 2 * 8 * tile * shares
    assert 0 < writes <= 2 * 4 * planes * (tile + 1)


def test_an_extrapolation_that_is_taken_back_costs_one_softmin(device, rng, monkeypatch):
    """The dual of an extrapolation is made to look smaller once; the result is the same."""
    if device.constants.longest_loop:
        pytest.skip("its iterations are the host's")
    measures = [clmorph.WeightedPoints(rng.random((n, 3)), np.full(n, 1 / n)) for n in (60, 50)]
    solve = functools.partial(
        clmorph.sinkhorn, *measures, blur=0.1, reach=0.5, tol=1e-5, backend=device
    )
    wanted = solve()
    real, taken_back = steps.DeviceSteps.update_rows, []
    back = steps.DeviceSteps.take_back

    def lower(self):
        mass, dual = real(self)
        return mass, dual - (1.0 if self._guessed and not taken_back else 0.0)

    def counted(self, which):
        taken_back.append(self.ahead)
        back(self, which)

    monkeypatch.setattr(steps.DeviceSteps, "update_rows", lower)
    monkeypatch.setattr(steps.DeviceSteps, "take_back", counted)
    found = solve()
    assert taken_back == [1]
    assert found.converged
    assert np.abs(found.g - wanted.g).max() <= 4e-5 * 0.1**2


def test_ctrl_c_leaves_no_scalar_that_is_not_known(device, rng):
    """It comes right after a scalar was set; the next call has the scalars of the one before."""
    rows, columns = (device.upload(rng.random((n, 3)), np.full(n, 1 / n)) for n in (70, 150))
    wanted = device.softmin(rows, columns, np.zeros(150), 0.01)
    set_arg = cl.Kernel.set_arg

    def interrupted(kernel, number, value):
        set_arg(kernel, number, value)
        if isinstance(value, np.generic):
            raise KeyboardInterrupt

    with mock.patch.object(cl.Kernel, "set_arg", interrupted), pytest.raises(KeyboardInterrupt):
        device.softmin(rows, columns, np.zeros(150), 0.3)
    assert np.array_equal(device.softmin(rows, columns, np.zeros(150), 0.01), wanted)


def test_threads_take_turns(device, rng):
    """Kernels store scalars; two threads change them in turn, as do sizes and epsilons."""
    clouds = [device.upload(rng.random((n, 3)), np.full(n, 1 / n)) for n in (70, 150, 200)]
    cases = [
        (clouds[i], clouds[j], np.zeros(len(clouds[j])), epsilon)
        for i, j, epsilon in ((0, 1, 0.01), (1, 0, 0.01), (0, 2, 0.02), (2, 2, 0.3))
    ]
    wanted = [device.softmin(*case) for case in cases]

    def wrong(order):
        return [n for n in order * 20 if not np.array_equal(device.softmin(*cases[n]), wanted[n])]

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as threads:
            assert list(threads.map(wrong, ([0, 1, 2, 3], [3, 1, 0]))) == [[], []]
    finally:
        sys.setswitchinterval(interval)


@pytest.mark.parametrize("error", [MemoryError("too large"), cl.RuntimeError("no resources")])
def test_failures_are_told_in_our_words(device, monkeypatch, error):
    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr(device.work, "buffer", fail)
    with pytest.raises(DeviceError, match="failed in upload") as caught:
        device.upload(np.zeros((3, 5)), np.ones(3))
    assert "\n" not in str(caught.value)
