"""Benches tell what a device takes, and its longest launch, beside seconds of the host."""

from pathlib import Path

import benching
import numpy as np
import pytest

TIMED = ["assignment", "dimensions", "grids", "host", "operations", "scale", "solver"]


@pytest.mark.parametrize("name", TIMED)
def test_each_bench_of_times_tells_its_longest_launch(name):
    text = Path(benching.__file__).with_name(f"bench_{name}.py").read_text("utf-8")
    assert "OF_KERNELS" in text or "longest launch, ms" in text


def test_the_clock_is_the_devices(device, monkeypatch):
    monkeypatch.setattr(benching, "get_backend", lambda _: device)
    backend = benching.profiled("auto")
    cloud = backend.upload(np.random.default_rng(0).random((500, 3)), np.full(500, 1 / 500))

    def softmins(count):
        clock = benching.KernelClock(backend)
        for _ in range(count):
            backend.softmin(cloud, cloud, np.zeros(500), 0.01)
        return clock.cells()

    seconds, longest = softmins(9)
    assert longest.endswith(" (log_sum_exp)")
    assert (
        float(longest.split()[0]) <= 1e3 * float(seconds) + 0.1
    )  # the clock of Mesa's does not run
    assert softmins(0) == ("0", "0.0 ()")  # from now on


def test_numpy_has_no_kernels():
    assert benching.KernelClock(benching.profiled("numpy")).cells() == ("", "")
