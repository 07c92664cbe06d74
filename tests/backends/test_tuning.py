"""Tuned constants are stored, used and forgotten, and invalid records of them are ignored."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from clmorph import DeviceError
from clmorph.backends.opencl import probe
from clmorph.backends.opencl import tuner as tuning
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import tuned_record
from clmorph.backends.opencl.build.constants import choose_constants
from clmorph.backends.opencl.build.programs import program_key
from clmorph.backends.opencl.build.tuned_record import forget_tuning, tuned_constants
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.devices import find, throughput, verdicts
from clmorph.backends.opencl.devices.cache import load_record, save_record
from clmorph.backends.opencl.tuner import tune
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.cli.main import main

VARIANT = Variant("plan_shares.cl", 5)

pytestmark = pytest.mark.usefixtures("empty_cache")


@pytest.fixture
def fast_tile(monkeypatch):
    """A device that likes large tiles and no others changes."""
    tried = []

    def speed(device, constants):
        tried.append(constants)
        return 1e9 * (2 if constants.tile == 128 else 1) / (1 + constants.exp2_builtin)

    monkeypatch.setattr(tuning, "_speed", speed)
    return tried


@pytest.mark.full
def test_a_later_change_makes_an_earlier_one_worth_while(device, monkeypatch):
    start = choose_constants(device.device)

    def speed(device, constants):
        both = constants.exp2_builtin != start.exp2_builtin and constants.tile != start.tile
        return 1e9 * (1 + (constants.tile != start.tile) + 2 * both)

    monkeypatch.setattr(tuning, "_speed", speed)
    best, _, after = tune(device.device, lambda line: None)
    assert best.exp2_builtin != start.exp2_builtin
    assert after == 4e9


@pytest.mark.parametrize("rate", [1e8, 1e10, 1e12])
def test_readings_do_not_saturate(monkeypatch, rate):
    """By the device's own clock, with points enough to fill it, whatever the host takes."""
    sizes, host = [], [0.0]

    class Device:
        work = SimpleNamespace(device_seconds=0.0)

        def upload(self, points, weights):
            return len(points)

        def softmin(self, rows, columns, potential, epsilon, precise):
            sizes.append(rows)
            host[0] += 1e-3
            self.work.device_seconds += 5e-6 + rows * columns / rate

    # A host that wakes late would seem to have a device whose clock does not run.
    clock = SimpleNamespace(perf_counter=lambda: host[0])
    monkeypatch.setattr(throughput, "time", clock)
    monkeypatch.setattr(throughput, "THROUGHPUT_SECONDS", 0.0)
    assert throughput.throughput(Device(), 2048) == pytest.approx(rate, rel=0.02)
    assert max(sizes) == {1e8: 2048, 1e10: 8192, 1e12: 65536}[rate]


def test_a_clock_that_does_not_run_is_not_read():
    work = SimpleNamespace(device_seconds=0.0)

    def run():
        time.sleep(1e-3)
        work.device_seconds += 1e-9

    assert throughput.seconds_of(SimpleNamespace(work=work), run) >= 1e-3


def test_the_devices_clock_measures_kernels(device):
    """Not what the host does, and nothing where the queue is not profiled."""
    n, seconds = 500, {}
    for profiled in (False, True):
        operations = OpenCLOperations(device.device, verify=False, profiled=profiled)
        cloud = operations.upload(np.random.default_rng(0).random((n, 3)), np.full(n, 1 / n))
        operations.softmin(cloud, cloud, np.zeros(n), 0.01)
        work = operations.work
        longest, name = work.longest_launch
        assert profiled == bool(name == "log_sum_exp" and 0 < longest <= work.device_seconds)
        began = time.perf_counter()
        seconds[profiled] = throughput.seconds_of(operations, lambda: time.sleep(0.01))
        assert 0.01 <= seconds[profiled] <= time.perf_counter() - began


@pytest.mark.full
@pytest.mark.parametrize("name", ["tile", "unroll", "width", "rows"])
def test_candidates_are_right(device, name):
    """Constants change speed only; candidates are timed before the best one is verified."""
    for constants in list(tuning.variants(choose_constants(device.device), name, 64))[:2]:
        operations = OpenCLOperations(device.device, constants, verify=False)
        assert first_failure(operations, Variant("log_sum_exp.cl", 5)) == ""


def test_tuning_is_kept_and_used(device, fast_tile):
    lines = []
    start = choose_constants(device.device)
    best, before, after = tune(device.device, lines.append)
    # Where vectors are narrow, other constants than the tile alone can lead to that tile.
    assert best.tile == 128
    assert best.exp2_builtin == start.exp2_builtin
    assert best in fast_tile
    assert (before, after) == (1e9, 2e9)
    assert len(lines) <= len(fast_tile)
    assert tuned_constants(device.device) == best
    assert OpenCLOperations(device.device).constants == best
    forget_tuning(device.device)
    assert tuned_constants(device.device) == start


def test_a_fast_build_that_is_wrong_is_not_kept(device, fast_tile, monkeypatch):
    monkeypatch.setattr(tuning, "_is_right", lambda device, constants, tell: constants.tile != 128)
    best, _, after = tune(device.device, lambda line: None)
    assert best.tile != 128
    assert after == 1e9
    assert tuned_constants(device.device) == best


@pytest.mark.full
def test_quirks_come_after_tuning(device, fast_tile, monkeypatch):
    tune(device.device, lambda line: None)
    monkeypatch.setenv("CLMORPH_QUIRKS", "small_local_memory,no_float64")
    constants = tuned_constants(device.device)
    assert constants.precise == 1
    assert constants == choose_constants(device.device)


@pytest.mark.parametrize(
    "entry",
    ["nonsense", {}, {"unknown": 1}, {"group": 256, "tile": 32}, {"width": True}]
    + [{"tile": value} for value in (7, "64", [], 64.0)],
)
def test_a_damaged_record_is_ignored(device, entry):
    save_record(tuned_record._record(device.device), entry)
    assert tuned_constants(device.device) == choose_constants(device.device)


def test_builds_that_fail_are_passed_over(device, monkeypatch):
    start = choose_constants(device.device)

    def speed(device, constants):
        if constants != start:
            raise DeviceError("no")
        return 1e9

    monkeypatch.setattr(tuning, "_speed", speed)
    assert tune(device.device, lambda line: None)[0] == start


@pytest.mark.needs_device
def test_the_command(capsys, fast_tile, asked, tmp_path, monkeypatch):
    # `test_tuning_is_kept_and_used` verifies the programs.
    monkeypatch.setattr(tuning, "_is_right", lambda *_: True)
    assert main(["tune"]) == 0
    assert "1.00 to 2.00·10⁹ pairs/s" in capsys.readouterr().out
    (record,) = (tmp_path / "tuning").iterdir()
    assert load_record(f"tuning/{record.stem}")
    assert main(["tune", "--all"]) == 0
    assert main(["tune", "--all", "--reset"]) == 0
    assert "tuning forgotten" in capsys.readouterr().out
    assert list((tmp_path / "tuning").iterdir()) == []
    assert main(["tune", "--device", "pocl", "--all"]) == 2
    assert "contradict" in capsys.readouterr().err


@pytest.fixture
def tuned(device, fresh_search):
    """Another build than the device's own, which is kept as tuned."""
    start = choose_constants(device.device)
    best = next(iter(tuning.variants(start, "unroll", int(device.device.max_work_group_size))))
    tuned_record.save_tuning(device.device, best, start)
    return best


@pytest.mark.parametrize("words", ["wrong result of", "its driver crashed", "cannot build"])
def test_a_tuned_build_that_fails_is_forgotten(device, tuned, words):
    """The device stays usable: its own build may be right."""
    operations = OpenCLOperations(device.device)
    assert operations.constants == tuned
    key = program_key(device.device, VARIANT, tuned)
    verdicts.save(key, verdicts.Verdict(f"{words} {VARIANT}: softmin is off by 1 nats"))
    with pytest.raises(DeviceError, match=r"tuned build: .* off by 1 nats; the tuning is now forg"):
        operations.programs.verify(VARIANT)
    assert verdicts.load(verdicts.verdict_key(device.device)) is None
    assert OpenCLOperations(device.device).constants == choose_constants(device.device)


def test_constants_of_the_caller_leave_the_tuning(device, tuned):
    key = program_key(device.device, VARIANT, tuned)
    verdicts.save(key, verdicts.Verdict("wrong result of x"))
    with pytest.raises(DeviceError, match="is unusable"):
        OpenCLOperations(device.device, tuned).programs.verify(VARIANT)
    assert tuned_constants(device.device) == tuned


def test_the_first_trial_leaves_the_tuned_build_out(device, tuned, monkeypatch):
    built = []

    def failure(operations, variant):
        built.append(operations.constants)
        return "wrong result of all"

    monkeypatch.setattr(probe, "first_failure", failure)
    assert probe.probe(find.index_of(device.device)).reason == "wrong result of all"
    assert built == [choose_constants(device.device)]


@pytest.mark.parametrize("reason", ["wrong result of x: y", "its driver crashed (signal 6) on x"])
def test_reset_takes_an_unusable_device(device, tuned, asked, capsys, reason, tmp_path):
    index = find.index_of(device.device)
    find.mark_unusable(device.device, reason)
    assert main(["tune", "--device", index]) == 2
    assert "unusable" in capsys.readouterr().err
    assert main(["tune", "--device", index, "--reset"]) == 0
    printed = capsys.readouterr()
    assert "tuning forgotten" in printed.out
    assert reason in " ".join(printed.err.split())
    assert list((tmp_path / "tuning").iterdir()) == []
    assert find.tried(index).usable
    assert main(["tune", "--device", "no such device", "--reset"]) == 2
