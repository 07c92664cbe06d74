"""Test how devices are found, tested and chosen."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pyopencl as cl
import pytest
from conftest import TESTED, USABLE

import clmorph
from clmorph import DeviceError, InputError
from clmorph.backends import select as backends
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.devices import cache as storage
from clmorph.backends.opencl.devices import find as devices
from clmorph.backends.opencl.devices import runtimes, verdicts
from clmorph.backends.opencl.devices.find import Device, choose_device, find_devices, run_probe
from clmorph.reference import NumPyOperations


def made(index="0:0", name="Thing", kind="CPU", usable=True, speed=1e9, platform="Works"):
    reason = "" if usable else "its driver crashed"
    return Device(
        index, name, platform, "OpenCL 3.0", "1.0", kind, 2, 1 << 30, usable, reason, speed, None
    )  # fmt: skip


@pytest.fixture
def pretend(monkeypatch):
    """Replace the machine's devices by made-up ones."""

    def replace(*found):
        monkeypatch.setattr(devices, "find_devices", lambda: found)
        monkeypatch.delenv("PYOPENCL_CTX", raising=False)

    return replace


def test_gpus_come_first_then_the_faster(pretend):
    slow, fast = made("0:0", speed=1e9), made("1:0", speed=5e9)
    gpu = made("2:0", kind="GPU", speed=5e8)
    broken = made("3:0", kind="GPU", usable=False, speed=0)
    pretend(slow, fast, broken)
    assert choose_device() is fast
    pretend(slow, fast, gpu, broken)
    assert choose_device("auto") is gpu
    assert choose_device("opencl") is gpu


def test_by_index_and_by_name(pretend):
    pretend(made("0:0", "EPYC", platform="PoCL"), made("1:0", "EPYC", platform="Intel(R) OpenCL"))
    assert choose_device("1:0").index == "1:0"
    assert choose_device("intel").index == "1:0"
    assert choose_device("pocl").index == "0:0"
    with pytest.raises(DeviceError, match="nvidia"):
        choose_device("nvidia")


def test_unusable_devices_are_never_chosen(pretend):
    pretend(made("0:0", usable=False), made("1:0", usable=True, speed=1.0))
    assert choose_device().index == "1:0"
    with pytest.raises(DeviceError, match="its driver crashed"):
        choose_device("0:0")
    pretend(made(usable=False))
    with pytest.raises(DeviceError, match=r"no OpenCL device is usable.*its driver crashed"):
        choose_device()


def test_without_devices_the_remedy_is_named(pretend):
    pretend()
    for spec in ("auto", "intel"):
        with pytest.raises(DeviceError, match="backend 'numpy'"):
            choose_device(spec)


def test_backend_specs(device, monkeypatch):
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    assert isinstance(clmorph.get_backend("numpy"), NumPyOperations)
    assert isinstance(clmorph.get_backend("auto"), OpenCLOperations)
    assert isinstance(clmorph.get_backend("opencl"), OpenCLOperations)
    assert clmorph.get_backend(device) is device
    index = next(d.index for d in USABLE if d.handle == device.device)
    assert clmorph.get_backend(index) is device
    for wrong in (3, None, object()):
        with pytest.raises(InputError, match="backend="):
            clmorph.get_backend(wrong)


def test_environment_variables(device, monkeypatch):
    index = next(d.index for d in USABLE if d.handle == device.device)
    monkeypatch.setenv("CLMORPH_DEVICE", index)
    assert clmorph.get_backend("auto") is device
    monkeypatch.setenv("CLMORPH_DEVICE", "numpy")
    assert isinstance(clmorph.get_backend(), NumPyOperations)
    monkeypatch.delenv("CLMORPH_DEVICE")
    monkeypatch.setenv("PYOPENCL_CTX", index)
    backends._named_backend.cache_clear()
    assert clmorph.get_backend("auto").device == device.device
    monkeypatch.setenv("PYOPENCL_CTX", "77:0")
    with pytest.raises(DeviceError, match="PYOPENCL_CTX"):
        clmorph.get_backend("auto")


@pytest.mark.needs_device
def test_the_probe_finds_a_working_device():
    verdict = run_probe(TESTED[0].index)
    assert verdict["usable"], verdict
    assert verdict["pairs_per_second"] > 1e6


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("import os; os.abort()", "crashed"),
        ("import time; time.sleep(60)", "within 2 s"),
        ("raise SystemExit(3)", "status 3"),
        ("print('noise')", "status 0"),
    ],
)
def test_a_broken_driver_breaks_only_the_probe(monkeypatch, tmp_path, body, words):
    script = tmp_path / "probe.py"
    script.write_text(body)
    real = subprocess.run
    monkeypatch.setattr(
        subprocess, "run", lambda command, **options: real([sys.executable, script], **options)
    )
    verdict = run_probe("0:0", seconds=2)
    assert not verdict["usable"]
    assert words in verdict["reason"]


@pytest.mark.needs_device
def test_verdicts_are_remembered(monkeypatch, tmp_path, asked):
    first = find_devices.__wrapped__()
    assert asked == [device.index for device in first]
    assert find_devices.__wrapped__() == first
    assert len(asked) == len(first)
    # A damaged record is as good as none.
    records = sorted((tmp_path / "devices").iterdir())
    for record in records:
        record.write_text("{")
    find_devices.__wrapped__()
    assert len(asked) == 2 * len(first)
    # Another driver is another verdict.
    monkeypatch.setattr(verdicts, "cpu_identity", lambda: "another processor")
    find_devices.__wrapped__()
    assert len(asked) == 3 * len(first)
    assert len(list((tmp_path / "devices").iterdir())) == 2 * len(records)


def test_every_listed_device_has_a_verdict():
    for device in find_devices():
        assert device.usable == (not device.reason)
        assert "\n" not in str(device)


@pytest.mark.skipif(runtimes.intel_runtime() is None, reason="Intel's runtime is not installed")
@pytest.mark.needs_device
def test_pip_runtimes_hide_nothing():
    """Platforms with Intel's registered are those without it, and Intel's."""
    listing = "print(sorted({d.platform.version for _, d in raw_devices()}))"
    import_it = "from clmorph.backends.opencl.devices.find import raw_devices;"
    without = (
        "import clmorph.backends.opencl.devices.runtimes as r; r.intel_runtime = lambda: None;"
    )
    found = [
        set(eval(subprocess.check_output([sys.executable, "-c", code + listing], text=True)))
        for code in (import_it, without + import_it)
    ]
    assert found[1] < found[0]
    assert len(found[0]) == len(found[1]) + 1


def test_a_users_vendor_folder_is_respected(tmp_path):
    """Who names a folder of drivers gets those, and not Intel's from pip as well."""
    code = "from clmorph.backends.opencl.devices.find import raw_devices;"
    code += "print([d.platform.name for _, d in raw_devices()])"
    environment = dict(os.environ, OCL_ICD_VENDORS=str(tmp_path))
    names = subprocess.check_output([sys.executable, "-c", code], text=True, env=environment)
    assert "Intel" not in names


def test_import_needs_no_driver():
    """Not even pyopencl is imported before a device is requested."""
    code = "import sys, clmorph; print('pyopencl' in sys.modules, 'skimage' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).split() == ["False"] * 2


def test_without_any_driver_the_answer_is_one_line(tmp_path):
    code = "import clmorph.cli.main as c; c.main(['demo'])"
    block = "import sys; sys.modules['pyopencl'] = None;"
    # "auto" may be something else in these tests.
    environment = {k: v for k, v in os.environ.items() if k != "CLMORPH_DEVICE"}
    done = subprocess.run(
        [sys.executable, "-c", block + code], capture_output=True, text=True, check=False,
        cwd=tmp_path, env=environment,
    )  # fmt: skip
    assert done.stderr.count("\n") == 1
    assert "no OpenCL device was found" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_sources_are_expanded():
    text = program.source("log_sum_exp.cl")
    assert "#include" not in text
    assert '#line 1 "common.cl"' in text
    line = text.splitlines().index("#ifndef DIM")
    marker = [i for i, row in enumerate(text.splitlines()[:line]) if row.startswith("#line")][-1]
    _, number, name = text.splitlines()[marker].split()
    assert name == '"row_loop.cl"'
    original = (program.resources.files("clmorph.cl_kernels") / "row_loop.cl").read_text()
    assert original.splitlines()[int(number) + (line - marker) - 2] == "#ifndef DIM"


def test_a_build_failure_is_one_line(device):
    with pytest.raises(DeviceError, match=r"cannot build log_sum_exp\.cl") as caught:
        program.build(device.context, "log_sum_exp.cl", {"WIDTH": 1, "SENTINEL": -1e30})
    assert "\n" not in str(caught.value)
    assert "DIM" in str(caught.value)


def test_too_many_points(device):
    class Many:
        shape = (1 << 25, 5)

    points = np.broadcast_to(0.0, Many.shape)
    with pytest.raises(DeviceError, match=r"2\^24"):
        device.upload(points, np.broadcast_to(1.0, Many.shape[0]))


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(storage, "cache_folder", lambda: tmp_path)
    monkeypatch.delenv("PYOPENCL_NO_CACHE", raising=False)
    return tmp_path / "kernels"


@pytest.mark.full
def test_builds_are_kept_and_damage_is_survived(device, empty_cache, monkeypatch):
    constants = device.constants.row_macros(5)
    program.build(device.context, "log_sum_exp.cl", constants)
    (file,) = empty_cache.iterdir()
    whole = file.read_bytes()

    # A kept build needs no source.
    with monkeypatch.context() as patch:
        patch.setattr(program, "_from_source", None)
        program.build(device.context, "log_sum_exp.cl", constants)
    for damaged in (b"", whole[:20], whole[:-1], whole[:-1] + b"x", b"x" * 1000):
        file.write_bytes(damaged)
        program.build(device.context, "log_sum_exp.cl", constants)
        kept = file.read_bytes()
        assert kept[:32] == program._digest(f"kernels/{file.name}", kept[32:])
    # A driver that refuses the binary: whole by its digest, but no program.
    name = f"kernels/{file.name}"
    file.write_bytes(program._digest(name, b"not a program") + b"not a program")
    built = program.build(device.context, "log_sum_exp.cl", constants)
    assert "log_sum_exp" in built.get_info(cl.program_info.KERNEL_NAMES)
    # Other constants, another file.
    program.build(device.context, "log_sum_exp.cl", device.constants.row_macros(3))
    assert len(list(empty_cache.iterdir())) == 2
    # One under the other's name is not taken for it.
    (other,) = set(empty_cache.iterdir()) - {file}
    shutil.copy(other, file)
    built = program.build(device.context, "log_sum_exp.cl", constants)
    assert file.read_bytes() != other.read_bytes()
    assert "log_sum_exp" in built.get_info(cl.program_info.KERNEL_NAMES)


@pytest.mark.full
def test_two_processes_build_at_once(device, tmp_path):
    index = next(d.index for d in USABLE if d.handle == device.device)
    code = (
        "import clmorph, numpy as np; o = clmorph.get_backend('%s');"
        "c = o.upload(np.zeros((3, 5)), np.ones(3)); print(o.softmin(c, c, np.zeros(3), 1.0)[0])"
    )
    environment = dict(os.environ, XDG_CACHE_HOME=str(tmp_path))
    shutil.copytree(storage.cache_folder() / "devices", tmp_path / "clmorph" / "devices")
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code % index], env=environment, stdout=subprocess.PIPE
        )
        for _ in range(3)
    ]
    answers = {process.communicate()[0] for process in running}
    assert len(answers) == 1
    assert float(answers.pop()) == pytest.approx(-np.log(3), abs=1e-6)


def test_without_a_writable_cache_everything_works(device, tmp_path):
    (tmp_path / "file").write_text("")
    index = next(d.index for d in USABLE if d.handle == device.device)
    # PoCL itself needs a cache folder.
    environment = dict(
        os.environ, XDG_CACHE_HOME=str(tmp_path / "file"), POCL_CACHE_DIR=str(tmp_path)
    )
    done = subprocess.run(
        [sys.executable, "-c", f"import clmorph; print(clmorph.get_backend('{index}'))"],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert device.description in done.stdout
