"""Test how devices are found, tested and chosen."""

import itertools
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest
from conftest import USABLE, forget_devices, found_anew

import clmorph
from clmorph import DeviceError, InputError
from clmorph.backends import select as backends
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import apply_quirks, choose_constants, gpu_constants
from clmorph.backends.opencl.build.variants import Variant, all_variants
from clmorph.backends.opencl.devices import cache as storage
from clmorph.backends.opencl.devices import find as devices
from clmorph.backends.opencl.devices import runtimes, verdicts
from clmorph.backends.opencl.devices.find import choose_device, find_devices
from clmorph.backends.opencl.devices.quirks import find_quirks
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.reference import NumPyOperations

_COUNTER = itertools.count()


def handle(name="Thing", platform="Works", kind="CPU", **properties):
    """Make up a device as drivers announce it."""
    announced = {
        "name": name,
        "platform": SimpleNamespace(name=platform, version="OpenCL 3.0", vendor="Nobody"),
        "driver_version": f"1.{next(_COUNTER)}",  # devices of the same driver share a verdict
        "type": getattr(cl.device_type, kind),
        "max_compute_units": 2,
        "native_vector_width_float": 1,
        "max_clock_frequency": 1000,
        "host_unified_memory": kind == "CPU",
        "global_mem_size": 1 << 30,
    }
    return SimpleNamespace(**announced | properties)


@pytest.fixture
def pretend(monkeypatch, tmp_path, fresh_search):
    """Replace the machine's devices by made-up ones; return the indices of those that are tried."""
    asked = []

    def replace(*found, broken=()):
        listed = tuple((f"{number}:0", device) for number, device in enumerate(found))
        bad = {listed[found.index(device)][0] for device in broken}

        def probe(index, request=None):
            if request is None:
                asked.append(index)
            reason = "its driver crashed" if index in bad else ""
            return verdicts.Verdict(reason, pairs_per_second=1.0)

        forget_devices()
        asked.clear()
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        monkeypatch.setattr(devices, "raw_devices", lambda: listed)
        monkeypatch.setattr(devices, "run_probe", probe)
        monkeypatch.setattr(storage, "cache_folder", lambda: folder)
        monkeypatch.delenv("PYOPENCL_CTX", raising=False)
        return asked

    return replace


def chosen(spec="auto"):
    return choose_device(spec).handle


INTEL, POCL = "Intel(R) OpenCL", "Portable Computing Language"


def test_the_order_is_what_devices_announce(pretend):
    """GPUs first, discrete before integrated; CPUs last, by what is known of their drivers."""
    rusticl, other = handle(platform="rusticl"), handle(platform="Something else")
    pocl, intel = handle(platform=POCL, max_compute_units=8), handle(platform=INTEL)
    accelerator = handle(kind="ACCELERATOR")
    integrated = handle(kind="GPU", host_unified_memory=True, max_compute_units=64)
    small, large = handle(kind="GPU"), handle(kind="GPU", max_compute_units=20)
    order = [large, small, integrated, accelerator, intel, pocl, other, rusticl]
    for number in range(len(order)):
        rest = order[number:]
        asked = pretend(*reversed(rest))
        assert chosen() is order[number]
        assert chosen("opencl") is order[number]
        assert asked == [f"{len(rest) - 1}:0"]  # no other device was tried
    old, pocl = handle(platform=POCL), handle(platform=POCL)
    old.platform.version = "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release"
    pretend(old, pocl)
    assert chosen() is pocl
    wide, narrow = handle(native_vector_width_float=16), handle(max_clock_frequency=4000)
    pretend(narrow, wide)
    assert chosen() is wide
    twins = handle(), handle()
    pretend(*twins)
    assert chosen() is twins[0]


def test_recorded_speeds_order_gpus_of_several_models(pretend, monkeypatch):
    """More lanes at a higher clock may be slower; near speeds, and twins, stay in their order.

    So do processors, of which no speed decides.
    """
    speeds = {"Arc": 2e11, "RTX": 1.3e12, "RTX Ti": 1.4e12, "Iris": 9e12, "broken": 0.0}
    speeds |= {"slow": 1e8, "fast": 1e11}

    def gpu(name, units, **more):
        return handle(name, kind="GPU", max_compute_units=units, **more)

    order = [gpu("RTX", 30), gpu("RTX Ti", 20), gpu("Arc", 400)]
    order += [gpu("broken", 999), gpu("Iris", 900, host_unified_memory=True)]
    asked = pretend(*reversed(order), broken=order[3:4])
    probe = devices.run_probe

    def measured(index, request=None):
        name = dict(devices.raw_devices())[index].name
        return replace(probe(index, request), pairs_per_second=speeds[name])

    monkeypatch.setattr(devices, "run_probe", measured)
    assert chosen() is order[0]
    assert sorted(asked) == ["1:0", "2:0", "3:0", "4:0"]  # the integrated one is not tried
    assert [entry[1] for entry in devices.in_order(devices.raw_devices())] == order
    asked = pretend(order[2], order[2])
    assert chosen() is order[2]
    assert asked == ["0:0"]  # twins need no measurement
    slow, fast = handle("slow", INTEL), handle("fast", POCL)
    pretend(fast, slow)
    probe = devices.run_probe
    monkeypatch.setattr(devices, "run_probe", measured)
    find_devices()  # as clmorph devices does
    assert chosen() is slow


def test_apples_processor_gets_work_groups_of_one():
    """It takes no larger ones for kernels with barriers, and has no float64."""
    apple = handle(
        "Apple M2", "Apple", max_work_group_size=1024, native_vector_width_float=4,
        local_mem_size=32768, extensions="cl_APPLE_SetMemObjectDestructor",
    )  # fmt: skip
    constants = choose_constants(apple)
    assert (constants.precise, constants.float64) == (1, 0)
    for variant in all_variants():
        if variant.suits(constants):
            macros = variant.macros(constants)
            assert {macros[name] for name in macros if name.endswith("GROUP")} <= {1}, variant


@pytest.mark.parametrize(("lanes", "width"), [(16, 1), (8, 8), (4, 4)])
def test_pips_pocl_has_vectors_that_its_compiler_takes(lanes, width):
    """It hangs on 16 lanes."""
    old = handle(
        platform=POCL, max_work_group_size=4096, native_vector_width_float=lanes,
        local_mem_size=1 << 19, extensions="cl_khr_fp64",
    )  # fmt: skip
    assert choose_constants(old).width == lanes
    old.platform.version = "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6"
    assert choose_constants(old).width == width


@pytest.mark.full
@pytest.mark.parametrize("largest", [8, 1])
def test_no_work_group_is_larger_than_a_device_takes(device, monkeypatch, largest):
    """Small cards take 8 or 12 work-items; Apple's processor one, where a kernel has barriers."""
    if "short_loops" in find_quirks(device.device):
        pytest.skip("groups that do not fill its lanes compute wrongly there")
    launch, groups = cl.enqueue_nd_range_kernel, set()

    def noted(queue, kernel, size, group, *rest, **options):
        groups.add(1 if group is None else int(np.prod(group)))
        return launch(queue, kernel, size, group, *rest, **options)

    monkeypatch.setattr(cl, "enqueue_nd_range_kernel", noted)
    monkeypatch.setattr(cl.Device, "max_work_group_size", property(lambda _: largest))
    constants = apply_quirks(gpu_constants(largest), find_quirks(device.device))
    operations = OpenCLOperations(device.device, constants, verify=False)
    for file in ("layers.cl", "color_table.cl", "splat.cl", "log_sum_exp.cl"):
        variant = Variant(file, 5 if file == "log_sum_exp.cl" else 0)
        assert first_failure(operations, variant) == ""
    assert max(groups) == largest


def test_the_search_ends_at_the_first_usable_device(pretend):
    first, second, third = handle(platform=INTEL), handle(platform=POCL), handle(platform="Else")
    asked = pretend(third, second, first, broken=[first])
    for _ in range(2):
        assert chosen() is second
        assert asked == ["2:0", "1:0"]
    find_devices()
    assert asked == ["2:0", "1:0", "0:0"]


def test_by_index_and_by_name(pretend):
    pocl, intel = handle("EPYC", POCL), handle("EPYC", INTEL)
    asked = pretend(pocl, intel)
    assert chosen("1:0") is intel
    assert chosen("intel") is intel
    assert asked == ["1:0"]
    assert chosen("portable") is pocl
    assert chosen("EPYC") is intel
    with pytest.raises(DeviceError, match="nvidia"):
        choose_device("nvidia")


def test_unusable_devices_are_never_chosen(pretend):
    bad = handle(platform=INTEL)
    pretend(bad, handle(), broken=[bad])
    with pytest.raises(DeviceError, match="its driver crashed"):
        choose_device("0:0")
    pretend(bad, broken=[bad])
    with pytest.raises(DeviceError, match=r"no OpenCL device is usable.*its driver crashed"):
        choose_device()


@pytest.mark.parametrize(
    ("value", "names"),
    [
        ("0", [0]), ("0:0", [0]), ("intel", [1]), ("portable", [2, 0]), ("PORTABLE:epyc", [2, 0]),
        ("portable:0", [2, 0]), ("1:EPYC", [1]), ("1:1", []), ("7", []), ("nobody", []),
        ("portable:0,epyc", [2, 0]), ("epyc", [2, 1, 0]), (":0", [0]),
    ],
)  # fmt: skip
def test_pyopencl_ctx_follows_the_same_rule(pretend, monkeypatch, value, names):
    """The first usable device of those that the variable names, in the fixed order."""
    found = handle("EPYC", POCL), handle("EPYC", INTEL), handle("EPYC", POCL, max_compute_units=8)
    for broken in ([], [found[2]], list(found)):
        pretend(*found, broken=broken)
        monkeypatch.setenv("PYOPENCL_CTX", value)
        usable = sorted(
            (found[name] for name in names if found[name] not in broken), key=devices.preference
        )
        if usable:
            assert chosen() is usable[0]
            continue
        why = f"names .*{'its driver crashed' if names else ''}"
        with pytest.raises(DeviceError, match=f"PYOPENCL_CTX='{value}' {why}") as caught:
            choose_device()
        assert "\n" not in str(caught.value)


def test_without_devices_the_remedy_is_named(pretend):
    pretend()
    for spec in ("auto", "intel"):
        with pytest.raises(DeviceError, match="backend 'numpy'"):
            choose_device(spec)


def test_backend_specs(device, monkeypatch):
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    assert isinstance(clmorph.get_backend("numpy"), NumPyOperations)
    for name in ("auto", "opencl"):
        assert isinstance(clmorph.get_backend(name), OpenCLOperations)
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


@pytest.mark.parametrize(("value", "disabled"), [("1", True), ("YES", True), ("0", False)])
def test_pyopencl_no_cache(monkeypatch, value, disabled):
    monkeypatch.setenv("PYOPENCL_NO_CACHE", value)
    assert runtimes.is_uncached() is disabled


@pytest.mark.parametrize("value", ["", "maybe"])
def test_pyopencl_no_cache_without_a_truth_value(monkeypatch, value):
    """In a new process the import of pyopencl itself would end in a traceback."""
    monkeypatch.setenv("PYOPENCL_NO_CACHE", value)
    with pytest.raises(DeviceError, match=f"PYOPENCL_NO_CACHE='{value}': .* set it to 1 or 0"):
        runtimes.list_platforms()


@pytest.mark.needs_device
def test_verdicts_are_remembered(monkeypatch, tmp_path, asked):
    first = found_anew()
    assert asked == [device.index for device in first]
    assert found_anew() == first
    assert len(asked) == len(first)
    records = len(list((tmp_path / "devices").iterdir()))
    # Another driver is another verdict.
    monkeypatch.setattr(verdicts, "cpu_identity", lambda: "another processor")
    found_anew()
    assert len(asked) == 2 * len(first)
    assert len(list((tmp_path / "devices").iterdir())) == 2 * records


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


def test_without_pyopencl_what_needs_it_is_told_in_one_line(tmp_path):
    """Where the import fails, as where Python finds no OpenCL library."""
    code = (
        "import sys; sys.modules['pyopencl'] = None\n"
        "import numpy as np, clmorph, clmorph.cli.main as c\n"
        "for words in (['check'], ['check', '--kernel', 'splat'], ['check', '--device', 'x'],\n"
        "              ['check', '--all'], ['tune'], ['check', '--kernel', 'grumpy'], ['demo']):\n"
        "    assert c.main(words) == 2\n"
        "assert c.main(['devices']) == 1\n"
        "print('---')\n"
        "pair = [(np.full(3, 1 / 3), np.arange(3.0))] * 2\n"
        "potentials = clmorph.sinkhorn(*pair, blur=0.1, backend='numpy')\n"
        "plan = clmorph.transport_plan(*pair, potentials, backend='numpy')\n"
        "morph = clmorph.morph(*np.zeros((2, 3, 3, 3)), n_frames=2, backend='numpy')\n"
        "for method in (potentials.to_device, plan.to_device, morph.device_frame):\n"
        "    try: method(0.5)\n"
        "    except clmorph.InputError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if k != "CLMORPH_DEVICE"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 7
    assert "no OpenCL device was found" in done.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []
    listed, _, told = done.stdout.partition("---\n")
    assert listed.startswith("No OpenCL device is usable. What helps:\n")
    assert told.count("pyopencl, which cannot be imported") == told.count("\n") == 3


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
    with pytest.raises(DeviceError, match=r"2\^24"):
        device.upload(np.broadcast_to(0.0, (1 << 25, 5)), np.broadcast_to(1.0, 1 << 25))


@pytest.mark.full
def test_builds_are_kept_and_damage_is_survived(device, empty_cache, monkeypatch):
    monkeypatch.delenv("PYOPENCL_NO_CACHE", raising=False)
    kept = empty_cache / "kernels"
    constants = Variant("log_sum_exp.cl", 5).macros(device.constants)
    program.build(device.context, "log_sum_exp.cl", constants)
    (file,) = kept.iterdir()
    whole, name = file.read_bytes(), f"kernels/{file.name}"
    # A kept build needs no source.
    with monkeypatch.context() as patch:
        patch.setattr(program, "_from_source", None)
        program.build(device.context, "log_sum_exp.cl", constants)
    for damaged in (b"", whole[:20], whole[:-1], whole[:-1] + b"x", b"x" * 1000):
        file.write_bytes(damaged)
        program.build(device.context, "log_sum_exp.cl", constants)
        again = file.read_bytes()
        assert again[:32] == program._digest(name, again[32:])
    # A driver that refuses the binary: whole by its digest, but no program.
    file.write_bytes(program._digest(name, b"not a program") + b"not a program")
    built = program.build(device.context, "log_sum_exp.cl", constants)
    assert "log_sum_exp" in built.get_info(cl.program_info.KERNEL_NAMES)
    # Other constants, another file.
    macros = Variant("log_sum_exp.cl", 3).macros(device.constants)
    program.build(device.context, "log_sum_exp.cl", macros)
    # One under the other's name is not taken for it.
    (other,) = set(kept.iterdir()) - {file}
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
