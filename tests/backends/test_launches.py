"""Launches stay short, and a device can be shared between threads."""

import sys
import threading

import numpy as np
import pyopencl as cl
import pytest

from clmorph import DeviceError
from clmorph.backends.opencl.kernels import launches
from clmorph.backends.opencl.kernels.launches import LAUNCH_PARTICLES, TARGET_SECONDS, LaunchBudget


@pytest.mark.parametrize("rate", [1e5, 1e8, 1e12])
def test_launches_approach_their_length_from_below(monkeypatch, rate):
    clock = [0.0]
    monkeypatch.setattr(launches.time, "perf_counter", lambda: clock[0])
    budget = LaunchBudget(first=1 << 10)
    for _ in range(40):
        pairs = budget.pairs()
        with budget.measure(pairs):
            clock[0] += 1e-4 + pairs / rate
        assert pairs / rate < 0.2
    assert budget.pairs() / rate == pytest.approx(TARGET_SECONDS, rel=0.01)


def test_one_slow_launch_is_survived(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(launches.time, "perf_counter", lambda: clock[0])
    budget = LaunchBudget()
    with budget.measure(10):
        clock[0] += 1e6  # the machine slept
    for _ in range(60):
        with budget.measure(budget.pairs()):
            clock[0] += budget.pairs() / 1e9
    assert budget.pairs() > 1e7


def test_no_launch_looks_at_more_than_its_share(device, monkeypatch):
    """A wide kernel over one crowded spot: cut over blocks and over particles."""
    monkeypatch.setattr("clmorph.backends.opencl.kernels.launches.LAUNCH_PARTICLES", 1000)
    splatting = device.splatting
    monkeypatch.setattr(splatting, "method", "gather")
    monkeypatch.setattr(splatting, "_budget", LaunchBudget(first=1))
    monkeypatch.setattr(splatting._budget, "pairs", lambda: 1)
    sizes = []
    run = splatting._run
    monkeypatch.setattr(
        splatting,
        "_run",
        lambda name, size, *rest: (sizes.append((name, size)), run(name, size, *rest)),
    )
    rng = np.random.default_rng(0)
    count = 3500
    splats = device.upload_splats(
        np.full((count, 2), 20.0, np.float32), rng.random((count, 3)).astype(np.float32),
        np.ones(count, np.float32),
    )  # fmt: skip
    _, cut = device.splat(splats, (40, 40), 30.0, 135.0)
    group = device.constants.tile_group
    blocks = (-(-40 // (device.constants.width * group))) ** 2
    assert [size for name, size in sizes if name == "splat"] == [(group, group)] * (4 * blocks)
    monkeypatch.undo()
    assert count < LAUNCH_PARTICLES
    _, whole = device.splat(splats, (40, 40), 30.0, 135.0)
    assert np.allclose(cut, whole, rtol=1e-5)


def test_no_launch_sums_more_than_its_share(device, monkeypatch):
    """The same by moments: cut over bins, over particles, and over rows."""
    monkeypatch.setattr("clmorph.backends.opencl.kernels.launches.LAUNCH_PARTICLES", 1000)
    splatting, sizes, launch = device.splatting, [], device.work.launch
    monkeypatch.setattr(splatting, "method", "moments")
    for budget in splatting._moments._budgets.values():
        monkeypatch.setattr(budget, "pairs", lambda: 1)
    monkeypatch.setattr(
        device.work,
        "launch",
        lambda kernel, *rest: (
            sizes.append((kernel.function_name, rest[0])),
            launch(kernel, *rest),
        ),
    )
    count, shape = 3500, (40, 40)
    positions = np.full((count, 2), 20.0, np.float32)
    ones = np.ones(count, np.float32)
    splats = device.upload_splats(positions, np.ones((count, 3), np.float32), ones)
    _, cut = device.splat(splats, shape, 1.4, 6.3)
    bins = (5 + 2) ** 2
    group = splatting._moments._group
    assert [size for name, size in sizes if name == "sum_moments"] == [(group,)] * (4 * bins)
    for name in ("sum_rows", "sum_columns"):
        found = [size for each, size in sizes if each == name]
        assert {size[1] for size in found} == {1}
    monkeypatch.undo()
    monkeypatch.setattr(splatting, "method", "moments")
    _, whole = device.splat(splats, shape, 1.4, 6.3)
    assert np.allclose(cut, whole, rtol=1e-5)
    assert whole[20, 20] == pytest.approx(count, rel=1e-5)


def test_threads_take_turns(device):
    rng = np.random.default_rng(0)
    clouds = [device.upload(rng.random((n, 5)), np.full(n, 1 / n)) for n in (200, 300)]
    potentials = [rng.random(200), rng.random(300)]
    want = [
        device.softmin(clouds[0], clouds[1], potentials[1], 0.01),
        device.softmin(clouds[1], clouds[0], potentials[0], 0.01),
    ]
    wrong = []

    def work(rows, columns, potential, expected):
        for _ in range(60):
            if not np.array_equal(device.softmin(rows, columns, potential, 0.01), expected):
                wrong.append(1)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [
            threading.Thread(target=work, args=(*clouds, potentials[1], want[0])),
            threading.Thread(target=work, args=(*clouds[::-1], potentials[0], want[1])),
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not wrong


@pytest.mark.parametrize("error", [MemoryError("too large"), cl.RuntimeError("no resources")])
def test_failures_are_told_in_our_words(device, monkeypatch, error):
    def fail(*arguments, **options):
        raise error

    monkeypatch.setattr(device.work, "buffer", fail)
    with pytest.raises(DeviceError, match="failed in upload") as caught:
        device.upload(np.zeros((3, 5)), np.ones(3))
    assert "\n" not in str(caught.value)
