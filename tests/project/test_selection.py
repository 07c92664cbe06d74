"""Without ``--full`` the tests still cover each value of each parameter."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from conftest import (
    LONGEST,
    TESTED,
    _is_in_turns,
    _is_repeated,
    _one_device_each,
    _share,
    _suits,
    _turn,
)

ROOT = Path(__file__).parents[2]


def items(*marks, **parameters):
    """Return stand-ins of a grid's items: all combinations of the values of each parameter."""
    grids = [{}]
    for name, values in parameters.items():
        grids = [{**grid, name: value} for grid in grids for value in values]
    return [
        SimpleNamespace(
            nodeid="test.py::test[x]",
            callspec=SimpleNamespace(params=grid),
            get_closest_marker=lambda name: name if name in marks else None,
        )
        for grid in grids
    ]


def test_a_test_that_hangs_fails_by_its_name(tmp_path, pytestconfig):
    """Each test has a limit, here a shorter one, in every process that shares the tests."""
    assert 0 < float(pytestconfig.getini("timeout")) <= 600
    place = tmp_path / "test_hanging.py"
    place.write_text("import threading\ndef test_waiting(): threading.Event().wait()\n")
    call = ["-c", ROOT / "pyproject.toml", "-o", "timeout=2", "-n", "1", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *call, place], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 1
    assert "FAILED" in done.stdout
    assert "test_waiting - Failed: Timeout" in done.stdout


AXES = {"a": "xyz", "b": [1.0, 2.0], "c": [None, True, False, 4, 5]}


def values(chosen, name):
    return {item.callspec.params[name] for item in chosen}


def test_each_value_is_tested_on_each_device():
    chosen = _share(items(variant="PQR", **AXES))
    for device in "PQR":
        own = [item for item in chosen if item.callspec.params["variant"] == device]
        assert len(own) == 5
        assert all(values(own, name) == set(wanted) for name, wanted in AXES.items())


@pytest.mark.parametrize("name", ["device", "any_backend"])
def test_each_value_is_tested_on_one_device(name):
    chosen = _share(items(**{name: "PQR"}, **AXES))
    assert len(chosen) == 5
    assert values(chosen, name) == set("PQR")
    assert all(values(chosen, axis) == set(wanted) for axis, wanted in AXES.items())
    assert len(_share(items(**{name: "PQR"}))) == 1
    assert len(_share(items(**{name: "P"}, **AXES))) == 5


def test_parameters_that_are_set_together_stay_together():
    grid = items(device="P", pair=[("x", 1), ("x", 2), ("y", 1)])
    for item in grid:
        params = item.callspec.params
        params["one"], params["other"] = params.pop("pair")
    assert _share(grid) == grid


def test_tests_without_a_grid_stay():
    alone = [SimpleNamespace(nodeid="test.py::alone", get_closest_marker=lambda name: None)]
    assert _share(alone) == alone
    row = items(device="P", a=range(7))
    assert _share(row) == row


@pytest.mark.parametrize(
    ("marks", "name"), [((), "device"), ((), "any_backend"), (("in_turns",), "variant")]
)
def test_each_combination_is_tested_on_one_device(monkeypatch, marks, name):
    monkeypatch.setattr("conftest._device_of", lambda item: item.callspec.params[name])
    grid = items(*marks, **AXES, **{name: [None, "P", "Q"]})
    assert all(map(_is_in_turns, grid))
    chosen = [item.callspec.params for item in _one_device_each(grid)]
    on_devices = [params for params in chosen if params[name] is not None]
    combinations = {tuple(params[axis] for axis in AXES) for params in on_devices}
    assert len(on_devices) == len(combinations) == 3 * 2 * 5
    assert {params[name] for params in on_devices} == {"P", "Q"}
    assert len(chosen) - len(on_devices) == 3 * 2 * 5  # those of NumPy


def test_small_tests_and_operations_are_for_all_devices(monkeypatch):
    monkeypatch.setattr("conftest._device_of", lambda item: item.callspec.params["device"])
    grid = items("small", device="PQR", a="xyz")
    assert len(_one_device_each(grid)) == len(grid) == 9
    assert not any(_is_in_turns(item) for item in items(variant="PQR", a="xyz"))
    assert not any(_is_in_turns(item) for item in items(each_device="PQR"))


def test_a_slow_device_takes_no_turns(monkeypatch):
    monkeypatch.setattr("conftest._is_slow", lambda device: device == "P")
    for marks, suits in (((), True), (("in_turns",), False), (("in_turns", "small"), True)):
        slow, fast = items(*marks, variant=["P", "Q"])
        assert _suits(slow, "P") == suits
        assert _suits(fast, "Q")


@pytest.mark.full
@pytest.mark.needs_device
def test_one_device_can_be_named():
    def collected(*options):
        command = [sys.executable, "-m", "pytest", "-n", "0", "--collect-only", "-q", *options]
        # With one device those that the whole run requires are not all there.
        environment = {k: v for k, v in os.environ.items() if k != "CLMORPH_TEST_REQUIRE"}
        return subprocess.run(
            command, capture_output=True, text=True, check=False, cwd=ROOT, env=environment
        )

    done = collected("--device", TESTED[0].index, "tests/cli/test_check.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("test_every_device_passes[") == 1
    done = collected("--device", "warp-drive", "tests/cli/test_check.py")
    assert done.returncode == 4
    assert "no usable OpenCL device matches --device warp-drive" in done.stderr


def test_a_device_that_repeats_another_one_is_known(monkeypatch):
    devices = [
        SimpleNamespace(index=index, platform=platform, kind=kind)
        for index, (platform, kind) in enumerate(
            [("P", "CPU"), ("P", "GPU"), ("Q", "CPU"), ("P", "CPU")]
        )
    ]
    monkeypatch.setattr("conftest.TESTED", devices)
    assert [_is_repeated(device) for device in [*devices, None]] == [False] * 3 + [True, False]


def test_the_longest_modules_come_first():
    modules = [path.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("test_*.py")]
    assert set(LONGEST) <= {path.as_posix() for path in modules}
    items = [SimpleNamespace(path=ROOT / "tests" / path) for path in modules]
    items.sort(key=_turn)
    assert [item.path for item in items[: len(LONGEST)]] == [
        ROOT / "tests" / path for path in LONGEST
    ]


@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="this process runs all tests")
def test_processes_of_tests_have_one_thread_of_linear_algebra():
    assert "OPENBLAS_NUM_THREADS" in os.environ
