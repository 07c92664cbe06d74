"""``clmorph devices``, ``clmorph check``, quirks, and the table made of reports."""

import getpass
import json
import platform
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import TESTED, USABLE, found_anew

from clmorph import DeviceError
from clmorph.backends.interface import Operations
from clmorph.backends.opencl.build.constants import (
    apply_quirks,
    choose_constants,
    cpu_constants,
    gpu_constants,
)
from clmorph.backends.opencl.build.variants import KERNELS
from clmorph.backends.opencl.devices import find as devices
from clmorph.backends.opencl.devices import install_hints, verdicts
from clmorph.backends.opencl.devices.find import choose_device, find_devices
from clmorph.backends.opencl.devices.install_hints import (
    LINUX_PACKAGES,
    advice,
    missing_cards,
    missing_files,
)
from clmorph.backends.opencl.devices.quirks import QUIRKS, find_quirks
from clmorph.backends.opencl.verification import table
from clmorph.backends.opencl.verification.findings import Finding
from clmorph.backends.opencl.verification.table import TABLE
from clmorph.cli.devices import check, wanted_kernels
from clmorph.cli.main import main
from clmorph.reference import NumPyOperations


@pytest.mark.full
def test_every_device_passes(each_device, monkeypatch):
    """Every operation is compared."""
    device, asked = each_device, set()

    class Noting(type(device)):
        def __getattribute__(self, name):
            asked.add(name)
            return super().__getattribute__(name)

    monkeypatch.setattr(device, "__class__", Noting)
    findings = list(check(device))
    assert all(finding.passed for finding in findings), findings
    operations = {name for name, value in vars(Operations).items() if callable(value)}
    assert {name for name in operations if not name.startswith("_")} <= asked
    named = " ".join(finding.name for finding in findings)
    for name in ("softmin", "row_maxima", "plan_rows", "bin_splats", "splat", "morph"):
        assert name in named


def test_a_wrong_device_fails_the_check(device, monkeypatch):
    assert all(finding.passed for finding in check(device, ["tile_levels"]))
    right = device.softmin
    monkeypatch.setattr(device, "softmin", lambda *arguments: right(*arguments) + 1e-3)
    assert not all(finding.passed for finding in check(device, ["tile_levels"]))


@pytest.mark.full
@pytest.mark.needs_device
def test_report(tmp_path, capfd):
    # Whole checks have a test of their own.
    kernel = ["--kernel", "sample_plan_rows"]
    assert main(["check", "--all", *kernel, "--report", str(tmp_path / "r.json")]) == 0
    assert capfd.readouterr().out.count(" pass") >= 5 * len(USABLE)
    text = (tmp_path / "r.json").read_text()
    bundles = json.loads(text)
    bundles = bundles if isinstance(bundles, list) else [bundles]
    assert [b["device"]["index"] for b in bundles] == [d.index for d in USABLE]
    for bundle in bundles:
        assert bundle["pairs_per_second"] > 1e6
        seconds = bundle["seconds"]
        assert 0 < seconds["longest_launch"] <= seconds["device"] < seconds["all"]
        assert any(seconds["of"] in kernels for kernels in KERNELS.values())
        assert set(bundle["device"]["quirks"]) <= set(QUIRKS)
    # Nothing personal.
    for folder in (Path.home(), Path(__file__).parents[2], tmp_path):
        assert str(folder) not in text
    # As words of their own: a host may be called "vm", and a driver "llvmpipe".
    for name in (platform.node(), getpass.getuser()):
        assert not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text)


@pytest.mark.needs_device
def test_check_of_one_device(capfd):
    arguments = ["--device", TESTED[0].index, "--kernel", "sample_plan_rows"]
    assert main(["check", *arguments]) == 0
    said = capfd.readouterr().out
    assert said.startswith(f"[{TESTED[0].index}] ")
    told = r"kernels took [\d.]+ s of [\d.]+ s with NumPy's; the longest launch: \w+, [\d.]+ ms"
    assert re.search(told, said) or "rusticl" in TESTED[0].platform  # its clock does not run


@pytest.mark.needs_device
def test_a_clock_that_does_not_run_is_told(faked, capfd):
    """That of Mesa's rusticl; here because no kernel runs."""
    del faked[1]
    assert main(["check", "--device", TESTED[0].index]) == 0
    said = capfd.readouterr().out
    assert "the device's own clock does not run" in said
    assert "longest launch" not in said


@pytest.fixture
def faked(monkeypatch, asked):
    """Let `check` find what is in a list, in an empty cache and without real trials."""
    findings = [Finding("fine", 0.1, 1.0, "u"), Finding("splat, sigma 5", 2.0, 1.0, "u")]
    monkeypatch.setattr("clmorph.cli.devices.check", lambda operations, kernels: findings)
    monkeypatch.setattr("clmorph.backends.opencl.devices.throughput.throughput", lambda *_: 1e9)
    return findings


@pytest.mark.needs_device
def test_a_failed_check_ends_with_1_and_is_remembered(faked, capfd, asked):
    index = TESTED[0].index
    assert main(["check", "--device", index]) == 1
    printed = capfd.readouterr()
    assert "FAIL" in printed.out
    assert "nearest its tolerance: splat, sigma 5 (200% of it)" in printed.out
    assert "unusable from now on" in printed.err
    verdicts._known.clear()  # as in a new process
    device = next(device for device in found_anew() if device.index == index)
    assert not device.usable
    assert "clmorph check: splat, sigma 5 is off by 2 u (tolerance 1)" in device.reason
    with pytest.raises(DeviceError, match="clmorph check"):
        choose_device(index)
    tries = len(asked)

    # It can be checked again where it is named, alone and by single kernels.
    for more in ([], ["--kernel", "splat"]):
        assert main(["check", "--device", index, *more]) == 1
        assert "compared because it was named" in capfd.readouterr().err
    del faked[1]
    assert main(["check", "--device", index, "--kernel", "splat"]) == 0
    assert not next(d for d in found_anew() if d.index == index).usable  # others may still fail
    assert len(asked) == tries
    assert main(["check", "--device", index]) == 0
    assert "is forgotten" in capfd.readouterr().err
    assert next(d for d in found_anew() if d.index == index).usable
    assert len(asked) == tries + 1


@pytest.mark.needs_device
def test_auto_passes_over_what_check_found_until_devices_are_tried_again(faked, capfd, asked):
    first = choose_device("auto")
    assert main(["check", "--device", first.index]) == 1
    others = [device for device in find_devices() if device.usable]
    assert first.index not in [device.index for device in others]
    if others:
        assert choose_device("auto").index != first.index
    assert main(["devices", "--again"]) == 0
    assert next(device for device in find_devices() if device.index == first.index).usable


def test_check_of_some_kernels(device):
    named = [finding.name for finding in check(device, ["sample_plan_rows"])]
    assert any("sample_plan_rows" in name for name in named)
    assert not any("softmin" in name or "moments" in name for name in named)
    for name in ("near_field", "near_field.cl"):
        assert wanted_kernels([name]) == set(KERNELS["near_field.cl"])
    assert wanted_kernels(["mark_columns"]) == {"mark_columns"}


@pytest.mark.needs_device
def test_an_unknown_kernel_is_told(refused):
    told = refused("check", "--device", TESTED[0].index, "--kernel", "grumpy")
    for words in ("grumpy", "--kernel", *KERNELS, "mark_columns", "sum_columns"):
        assert words in told


def test_every_kernel_has_a_comparison():
    """One of its own, beside the morph, which uses all."""
    assert {kernel for row in TABLE for kernel in row.kernels} == wanted_kernels([])
    assert {row.file for row in TABLE} == set(KERNELS)


@pytest.mark.needs_device
def test_a_report_has_what_the_table_shows(faked, tmp_path, capfd):
    faked[1] = Finding("bins", 3.0, 0.0, "entries")
    assert main(["check", "--device", TESTED[0].index, "--report", str(tmp_path / "r.json")]) == 1
    bundle = json.loads((tmp_path / "r.json").read_text(), parse_constant=pytest.fail)
    assert bundle["nearest"] == "bins"
    fine, bins = bundle["findings"]
    assert fine["share"] == pytest.approx(0.1)
    assert (bins["share"], bins["error"], bins["passed"]) == (None, 3.0, False)


@pytest.mark.needs_device
@pytest.mark.parametrize("error", [RuntimeError("no\nresources"), DeviceError("no resources")])
@pytest.mark.parametrize("found", [True, False])
def test_a_failing_driver_is_told_in_one_line(faked, monkeypatch, capfd, error, found):
    """What was found before is printed and remembered."""

    def find(operations, kernels):
        yield from faked if found else ()
        raise error

    monkeypatch.setattr("clmorph.cli.devices.check", find)
    index = TESTED[0].index
    assert main(["check", "--device", index]) == 2
    printed = capfd.readouterr()
    assert "no resources" in printed.err.splitlines()[-1]
    if not found:
        assert printed.err.count("\n") == 1
        return
    assert "FAIL" in printed.out
    assert "splat, sigma 5" in next(d for d in found_anew() if d.index == index).reason


def test_errors_of_wrong_results_are_rows_of_the_table(monkeypatch):
    """The comparisons after them are still made."""

    def ends():
        yield Finding("splat, sigma 5", float("nan"), 1.0, "u")
        raise IndexError("out of\nrange")

    plan_rows = KERNELS["plan_rows.cl"]
    monkeypatch.setattr(table, "device_checks", lambda *_: [(plan_rows, ends)])
    findings = list(check(NumPyOperations(), plan_rows))
    failed = [finding for finding in findings if not finding.passed]
    assert [each.name for each in failed] == [
        "splat, sigma 5", "count_plan_rows, fill_plan_rows ended in IndexError: out of range",
    ]  # fmt: skip
    assert np.isinf(failed[1].error)
    assert str(failed[1]) == failed[1].name
    assert findings[-1].name.startswith("morph")


@pytest.mark.needs_device
def test_devices_table(capfd):
    assert main(["devices"]) == 0
    out = capfd.readouterr().out
    lines = out.splitlines()
    assert sum(line.startswith("auto ") for line in lines) == 1
    for device in find_devices():
        assert any(f" {device.index} " in line for line in lines)
        assert "\n" not in str(device)
    assert main(["devices", "--json"]) == 0
    records = json.loads(capfd.readouterr().out)
    assert [record["index"] for record in records] == [d.index for d in find_devices()]
    assert sum(record["auto"] for record in records) == 1
    assert all(record["usable"] == (not record["reason"]) for record in records)


@pytest.mark.needs_device
def test_a_broken_runtime_is_one_more_row(monkeypatch, capfd, empty_cache, fresh_search):
    """What pip's PoCL is on processors it does not know: listed, with its reason, not chosen."""
    broken = TESTED[0].index
    crashed = verdicts.Verdict("crashed (signal 6)")
    works = verdicts.Verdict(pairs_per_second=1.0)
    monkeypatch.setattr(
        devices, "run_probe", lambda index, **how: crashed if index == broken else works
    )
    found = found_anew()
    others = [d.index for d in found if d.usable]
    assert broken not in others
    assert main(["devices", "--json"]) == (0 if others else 1)
    records = {r["index"]: r for r in json.loads(capfd.readouterr().out)}
    assert records[broken]["reason"] == "crashed (signal 6)"
    assert not records[broken]["auto"]


@pytest.mark.parametrize(
    ("system", "machine", "family", "first"),
    [
        ("linux", "x86_64", "debian", "pip install"),
        ("linux", "x86_64", "", "pip install"),
        ("linux", "aarch64", "fedora", "dnf"),
        ("linux", "aarch64", "", "package manager"),
        ("darwin", "arm64", "", "macOS"),
        ("win32", "AMD64", "", "driver"),
        ("freebsd", "amd64", "", "PoCL"),
    ],
)
def test_advice(system, machine, family, first):
    lines = advice(system, machine, family, installed=False, missing=[])
    assert first in lines[0]
    assert "numpy" in lines[-1]
    if family:
        assert any(LINUX_PACKAGES[family] in line for line in lines)


def test_advice_does_not_name_what_is_installed():
    first = advice("linux", "x86_64", "debian", installed=True)[0]
    assert "is installed but was not found: unset OCL_ICD_VENDORS" in first
    assert "pip install" not in first


def pretend_files(root, *names, icd=None):
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    if icd is not None:
        (root / "etc/OpenCL/vendors").mkdir(parents=True)
        (root / "etc/OpenCL/vendors/some.icd").write_text(icd + "\n")


NVIDIA = "usr/lib/x86_64-linux-gnu/libnvidia-opencl.so.1"


@pytest.mark.parametrize("icd", [None, "libpocl.so.2", "libnvidia-opencl.so.1"])
def test_an_unregistered_driver_is_named(tmp_path, monkeypatch, icd):
    """With the file that is missing, and the command that writes it."""
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    pretend_files(tmp_path, NVIDIA, icd=icd)
    found = missing_files(tmp_path)
    assert missing_cards(tmp_path) == []
    if icd == "libnvidia-opencl.so.1":
        assert found == []
        return
    (line,) = found
    file = tmp_path / "etc/OpenCL/vendors/nvidia.icd"
    assert f"{file} is missing" in line
    assert f"echo {tmp_path / NVIDIA} > {file}" in line
    # A user's own folder counts in place of the system's.
    own = tmp_path / "own"
    own.mkdir()
    (own / "n.icd").write_text(str(tmp_path / NVIDIA))
    monkeypatch.setenv("OCL_ICD_VENDORS", str(own))
    assert missing_files(tmp_path) == []


def test_a_registered_library_that_is_gone_is_named(tmp_path, monkeypatch):
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    pretend_files(tmp_path, icd=str(tmp_path / "gone.so"))
    (line,) = missing_files(tmp_path)
    assert line.startswith(f"{tmp_path / 'etc/OpenCL/vendors/some.icd'} names {tmp_path}")


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["usr/lib/wsl/lib/libcuda.so.1"], "WSL: .*libnvidia-opencl"),
        (["usr/lib/wsl/lib/libnvidia-opencl.so.1"], None),
        ([".dockerenv"], "--gpus all"),
        (["run/.containerenv"], "--device /dev/dri"),
        ([".dockerenv", "dev/dri/card0"], None),
        ([".dockerenv", "dev/nvidiactl"], "without libnvidia-opencl"),
        ([".dockerenv", "dev/nvidiactl", NVIDIA], None),
        ([], None),
    ],
)
def test_a_card_that_is_not_passed_on_is_told(tmp_path, names, words):
    pretend_files(tmp_path, *names)
    found = missing_cards(tmp_path)
    assert len(found) == (words is not None)
    assert words is None or re.search(words, found[0])


@pytest.mark.parametrize("none", [False, True])
def test_devices_gives_advice_and_names_the_missing_file(monkeypatch, capsys, fresh_search, none):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(install_hints, "missing_files", lambda: ["/etc/x.icd is missing"])
    if none:
        monkeypatch.setattr(devices, "raw_devices", lambda: ())
    code = main(["devices"])
    said = capsys.readouterr()
    assert "/etc/x.icd is missing" in said.out + said.err
    if none:
        assert code == 1
        assert "What helps" in said.out
        assert "numpy" in said.out


# --- quirks -------------------------------------------------------------------------------


@pytest.mark.parametrize("quirk", QUIRKS)
def test_each_quirk_can_be_forced(device, monkeypatch, quirk):
    """What is built then is compared by `test_every_variant_is_right_with_each_quirk`."""
    plain = find_quirks(device.device)
    monkeypatch.setenv("CLMORPH_QUIRKS", quirk)
    assert find_quirks(device.device) == plain | {quirk}
    assert choose_constants(device.device) == choose_constants(device.device, plain | {quirk})


def test_quirks_change_the_build():
    gpu = gpu_constants(256)
    assert apply_quirks(gpu, frozenset()) == gpu
    assert apply_quirks(gpu, frozenset({"small_groups"})).group == 16
    assert apply_quirks(gpu, frozenset({"small_groups"})).tile_group == 4
    assert apply_quirks(gpu, frozenset({"inexact_exp2"})).exp2_builtin == 0
    assert apply_quirks(gpu, frozenset({"small_local_memory"})).tile == 16
    assert apply_quirks(cpu_constants(16), frozenset({"small_local_memory"})).tile == 16
    for quirk in QUIRKS:
        for constants in (gpu, gpu_constants(1), cpu_constants(16), cpu_constants(1)):
            made = apply_quirks(constants, frozenset({quirk}))
            assert made.tile % (made.group * made.width) == 0
            assert made.tile % made.unroll == 0


@pytest.mark.needs_device
def test_unknown_quirks_are_no_property_of_a_device(asked, monkeypatch, refused, tmp_path):
    monkeypatch.setenv("CLMORPH_QUIRKS", "grumpy")
    index = TESTED[0].index
    for words in (["check"], ["check", "--device", index], ["check", "--all"], ["devices"]):
        told = refused(*words)
        assert "CLMORPH_QUIRKS names 'grumpy': expected some of" in told
        assert "unusable" not in told
    assert asked == []
    assert not (tmp_path / "devices").exists()
    monkeypatch.delenv("CLMORPH_QUIRKS")
    assert choose_device(index).usable
