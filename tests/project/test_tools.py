"""Tools: small parts of those that search for errors, and what benches tell of a device."""

import subprocess
import sys
from pathlib import Path

import benching
import compare_peers
import numpy as np
import pytest
import random_problems
from conftest import TESTED
from findings import Findings

TOOLS = Path(__file__).parents[2] / "tools"
TIMED = ["assignment", "dimensions", "grids", "host", "operations", "scale", "solver"]


@pytest.mark.full
@pytest.mark.parametrize(
    ("target", "count"), [("images", "300"), ("configs", "40"), ("api", "200")]
)
def test_fuzz_finds_nothing(target, count):
    given = [target, "--count", count, "--seed", "20261122", "--jobs", "1"]
    done = subprocess.run(
        [sys.executable, TOOLS / "fuzz.py", *given], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{target}: {count} cases, 0 findings" in done.stdout


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="needs signals as POSIX has them")
@pytest.mark.needs_device
def test_runs_that_are_interrupted(capsys):
    """Ctrl-C while frames are drawn and written, over an old file and without one; a full disk."""
    import faults

    runs = faults.Runs(TESTED[0].index, Findings([]))
    runs.measure("gif")
    seconds = runs.references["gif"].seconds
    for share, old in ((0.6, True), (0.9, False)):
        runs.kill("gif", "SIGINT", share * seconds, old)
    runs.fill("gif", 0)
    assert runs.findings.end() == 0, capsys.readouterr().out


def test_plans_and_potentials_are_pots(any_backend, capsys, monkeypatch):
    """One method of POT for each kind of entropy; what lines tell to repeat."""
    kept = {name: compare_peers.PEERS[name] for name in ("POT sinkhorn", "POT sinkhorn, entropy")}
    monkeypatch.setattr(compare_peers, "PEERS", kept)
    monkeypatch.setattr(sys, "argv", ["compare_peers.py"])
    findings = Findings([])
    compare_peers.compare(0, [0, 1, 2], any_backend, findings)
    assert findings.tried == {"POT sinkhorn": 3, "POT sinkhorn, entropy": 2}
    assert findings.end() == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "count"),
    [("assignments", 40), ("grids", 4), ("barycenters", 8), ("reaches", 4), ("second", 16)],
)
def test_random_problems_are_within_their_limits(kind, count, device):
    found = random_problems.worst(kind, count, device, seed=1000)
    assert found
    assert all(share <= 1 for share, _ in found.values()), found


@pytest.mark.parametrize("name", TIMED)
def test_each_bench_of_times_tells_its_longest_launch(name):
    text = (TOOLS / f"bench_{name}.py").read_text("utf-8")
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
    # The clock of Mesa's does not run.
    assert float(longest.split()[0]) <= 1e3 * float(seconds) + 0.1
    assert softmins(0) == ("0", "0.0 ()")  # from now on


def test_numpy_has_no_kernels():
    assert benching.KernelClock(benching.profiled("numpy")).cells() == ("", "")
