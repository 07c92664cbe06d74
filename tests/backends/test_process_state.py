"""Test the state that a process shares: first use by threads, forks, exit, cache, global state."""

import json
import math
import os
import pickle
import stat
import subprocess
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict

import numpy as np
import pyopencl as cl
import pytest
from conftest import TESTED, found_anew

import clmorph
from clmorph import DeviceError, InputError
from clmorph._shared.staging import own_prefix
from clmorph.backends.opencl import probe
from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.devices import cache as storage
from clmorph.backends.opencl.devices import find as devices
from clmorph.backends.opencl.devices import runtimes, trial, verdicts
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.opencl.devices.process import Once
from clmorph.errors import PlanSizeError
from clmorph.images import color as colors

WORKS = verdicts.Verdict(pairs_per_second=1.0)


# --- trials: one a device, and what is remembered of them ---------------------------------


def in_threads(function, count=8):
    """Call a function in threads at once and return what it returned."""
    gate = threading.Barrier(count)
    with ThreadPoolExecutor(count) as threads:
        return list(threads.map(lambda _: (gate.wait(), function())[1], range(count)))


@pytest.mark.needs_device
def test_threads_share_one_trial_of_a_device(asked, monkeypatch):
    def slow(index, request=None):
        if request is None:
            asked.append(index)
        time.sleep(0.05)
        return WORKS

    monkeypatch.setattr(devices, "run_probe", slow)
    answers = in_threads(find_devices)
    assert len(asked) == len(answers[0]) > 0
    assert all(answer is answers[0] for answer in answers)


@pytest.mark.needs_device
def test_threads_share_one_backend(monkeypatch):
    from clmorph.backends import select as backends

    made = []

    def choose(name):
        time.sleep(0.02)
        made.append(name)
        return TESTED[0]

    monkeypatch.setattr(devices, "choose_device", choose)
    monkeypatch.setattr(backends, "_named_backend", Once(backends._named_backend.__wrapped__))
    answers = in_threads(lambda: clmorph.get_backend("pocl"))
    assert made == ["pocl"]
    assert len(set(map(id, answers))) == 1
    # The same device by another name is the same backend.
    assert clmorph.get_backend("another name") is answers[0]


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="starts a process as POSIX does")
@pytest.mark.parametrize(
    ("body", "words"), [("time.sleep(60)", "within 5 s"), ("os.abort()", "crashed")]
)
def test_a_child_of_the_probe_does_not_hold_its_trial_up(monkeypatch, tmp_path, body, words):
    """A process that a driver starts keeps the probe's standard output open."""
    child, script = [sys.executable, "-c", "import time; time.sleep(60)"], tmp_path / "probe.py"
    script.write_text(
        "import os, subprocess, time\n"
        f"child = subprocess.Popen({child!r})\n"
        f"print({trial.LOADED!r}, flush=True)\n"
        f"print(child.pid, file=open({str(tmp_path / 'pid')!r}, 'w'), flush=True)\n"
        f"{body}\n"
    )
    monkeypatch.setattr(trial, "_command", lambda *_: [sys.executable, str(script)])
    # On a busy machine it may start late.
    monkeypatch.setenv("CLMORPH_PROBE_SECONDS", "5" if "sleep" in body else "60")
    verdict = trial.run_probe("0:0")
    os.kill(int((tmp_path / "pid").read_text()), 9)  # it fails if the child has ended, after 60 s
    assert words in verdict.reason


@pytest.mark.needs_device
def test_an_interrupted_trial_is_not_remembered(monkeypatch, empty_cache, fresh_search):
    closed = []

    def interrupted(command, seconds, reading):
        closed.append(reading)
        raise KeyboardInterrupt

    monkeypatch.setattr(trial, "_run", interrupted)
    for _ in range(2):  # the lock is free again
        with pytest.raises(KeyboardInterrupt):
            find_devices()
    assert list(empty_cache.iterdir()) == []
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(closed[-1])


@pytest.mark.parametrize("value", ["0", "-3", "soon", "nan", "inf", "1e9"])
def test_the_time_limit_is_checked(monkeypatch, value):
    monkeypatch.setenv("CLMORPH_PROBE_SECONDS", value)
    with pytest.raises(InputError, match=r"CLMORPH_PROBE_SECONDS=.*expected a number"):
        found_anew()


def test_a_failure_of_the_moment_is_told_apart():
    assert probe._is_passing(MemoryError(), None)
    assert not probe._is_passing(ValueError(), None)
    error = DeviceError("no memory")
    error.__cause__ = MemoryError()
    assert probe._is_passing(error, None)
    assert probe.probe("99:99").lasting is False


@pytest.mark.parametrize("executable", ["", "/usr/sbin/httpd", "/opt/game/app"])
def test_no_other_program_is_started_in_place_of_python(monkeypatch, executable):
    monkeypatch.setattr("multiprocessing.spawn.get_executable", lambda: os.fsencode(executable))
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr(subprocess, "Popen", None)
    verdict = trial.run_probe("0:0")
    assert "no Python interpreter" in verdict.reason
    assert not verdict.lasting


def test_an_interpreter_that_is_gone_is_a_reason(monkeypatch, tmp_path):
    monkeypatch.setattr("multiprocessing.spawn.get_executable", lambda: str(tmp_path / "python3"))
    assert "No such file" in trial.run_probe("0:0").reason


@pytest.mark.needs_device
def test_the_probe_finds_a_working_device_in_any_environment(monkeypatch, tmp_path):
    """Modules of the current folder, warnings as errors and the like are not the driver's."""
    for name in ("json.py", "numpy.py", "contextlib.py"):
        (tmp_path / name).write_text("raise RuntimeError('not meant')")
    monkeypatch.chdir(tmp_path)
    for name, value in {
        "PYTHONWARNINGS": "error", "PYTHONINSPECT": "1", "PYTHONIOENCODING": "utf-16",
        "PYTHONPATH": os.pathsep.join(["", "."]), "PYTHONSTARTUP": "json.py",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "path", ["", ".", *sys.path])
    verdict = trial.run_probe(TESTED[0].index)
    assert verdict.reason == ""
    assert verdict.pairs_per_second > 1e6


def test_numpy_has_one_thread_in_the_probe(monkeypatch):
    """Further ones spin while they wait, and the driver needs the cores."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    code = (
        "import json, os, numpy\n"
        "numpy.ones((600, 600)) @ numpy.ones((600, 600))\n"
        "tasks = '/proc/self/task'\n"
        "count = len(os.listdir(tasks)) if os.path.isdir(tasks) else 1\n"
        "names = 'OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS'\n"
        "print(json.dumps([count, *map(os.environ.get, names)]))"
    )
    command = [sys.executable, "-c", code]
    out = subprocess.run(command, env=trial._environment(), capture_output=True, check=True).stdout
    count, of_numpy, of_drivers = json.loads(out)
    assert (count, of_numpy) == (1, "1")
    assert of_drivers == "3"


@pytest.mark.skipif(sys.platform == "win32", reason="kills as POSIX does")
def test_no_probe_outlives_its_parent():
    """Not even one whose driver hangs, and whose parent could do nothing about it."""
    code = (
        "import subprocess, sys, os; r, w = os.pipe();"
        "p = subprocess.Popen([sys.executable, '-c', 'import time;"
        "from clmorph.backends.opencl.probe import end_with_parent;"
        "end_with_parent(); print(1, flush=True);"
        "time.sleep(300)'], stdin=r); print(p.pid, flush=True); p.wait()"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        child = max(int(parent.stdout.readline()) for _ in range(2))
        parent.kill()
    for _ in range(1200):
        try:
            os.kill(child, 0)
            # A zombie that nobody reaps is gone as well. It may go between any two of these lines.
            with suppress(FileNotFoundError), open(f"/proc/{child}/stat") as file:  # noqa: PTH123
                if file.read().rpartition(") ")[2].startswith("Z"):
                    return
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.kill(child, 9)
    pytest.fail("the probe lives on")


# --- caches -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "damaged",
    [
        "", "{", "[" * 100_000, "[]", "{}", "\xff\x00", '{"reason": ""}', "null",
        *(json.dumps({**asdict(WORKS), **change}) for change in (
            {"pairs_per_second": "fast"}, {"pairs_per_second": math.nan}, {"reason": 3},
            {"pairs_per_second": -1.0}, {"pairs_per_second": 10**400}, {"lasting": "yes"},
            {"many_eighths": "8"}, {"many_eighths": 9}, {"another": 1},
        )),
    ],
)  # fmt: skip
@pytest.mark.needs_device
def test_a_damaged_verdict_is_none(asked, tmp_path, damaged):
    first = found_anew()
    for file in (tmp_path / "devices").iterdir():
        file.write_text(damaged, "latin-1")
    assert found_anew() == first
    assert len(asked) == 2 * len(first)


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
@pytest.mark.parametrize("kind", ["folder", "loop", "a file for a folder"])
@pytest.mark.needs_device
def test_what_is_no_file_is_none(asked, tmp_path, kind):
    first = found_anew()
    for file in (tmp_path / "devices").iterdir():
        file.unlink()
        if kind == "folder":
            file.mkdir()
        elif kind == "loop":
            file.symlink_to(file.name)
    if kind.startswith("a file"):
        (tmp_path / "devices").rmdir()
        (tmp_path / "devices").write_text("")
    assert found_anew() == first
    verdicts.forget()


@pytest.mark.needs_device
def test_writers_at_once_keep_each_others_verdicts(monkeypatch, tmp_path):
    code = "from clmorph.backends.opencl.devices import trial, verdicts as v\n"
    code += "for n in range(64, 128): v.save(f'devices/{n}', v.Verdict())"
    environment = dict(os.environ, XDG_CACHE_HOME=str(tmp_path))
    monkeypatch.setattr(storage, "cache_folder", lambda: tmp_path / "clmorph")
    other = subprocess.Popen([sys.executable, "-c", code], env=environment)
    for number in range(64):
        verdicts.save(f"devices/{number}", WORKS)
    assert other.wait() == 0
    found = {path.stem for path in (tmp_path / "clmorph" / "devices").iterdir()}
    assert found == {str(number) for number in range(128)}
    verdicts.forget()


@pytest.fixture
def no_cache(monkeypatch, tmp_path):
    """A machine whose user has no cache folder, and an empty temporary folder."""
    (tmp_path / "file").write_text("")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(
        storage.platformdirs, "user_cache_dir", lambda *_, **__: str(tmp_path / "file" / "cache")
    )
    monkeypatch.setattr(storage.tempfile, "tempdir", str(tmp_path / "tmp"))
    return tmp_path / "tmp"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the temporary folder is the user's there")
def test_without_a_cache_folder_there_is_a_private_one(no_cache, monkeypatch):
    folder = storage.cache_folder()
    assert folder.parent == no_cache
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    verdicts.save("devices/key", WORKS)
    verdicts._known.clear()  # as in a new process
    assert verdicts.load("devices/key") == WORKS
    assert list(no_cache.iterdir()) == [folder]
    # Others may have made it, opened it, or put a link there: then there is none.
    folder.chmod(0o755)
    assert storage.cache_folder() is None
    folder.chmod(0o700)
    with monkeypatch.context() as patch:
        owner = os.getuid()
        patch.setattr(os, "getuid", lambda: owner + 1)
        folder.rename(no_cache / f"clmorph-{owner + 1}")
        assert storage.cache_folder() is None
    (no_cache / f"clmorph-{owner}").symlink_to(no_cache / f"clmorph-{owner + 1}")
    assert storage.cache_folder() is None
    assert storage.read_cached("devices/key.json") == b""
    verdicts.save("devices/other", WORKS)
    verdicts.forget()


def test_a_relative_cache_folder_is_ignored(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(storage.platformdirs, "user_cache_dir", lambda *_, **__: "cache")
    monkeypatch.setattr(storage.Path, "home", lambda: tmp_path / "home")
    assert storage.cache_folder() == tmp_path / "home" / ".cache" / "clmorph"
    assert not (tmp_path / "cache").exists()


def test_what_killed_writers_leave_is_removed(empty_cache):
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    for number in (gone.pid, os.getpid()):
        name = own_prefix().replace(str(os.getpid()), str(number), 1) + "abcdefgh"
        (empty_cache / "kernels" / name).mkdir(parents=True)
    storage.write_cached("kernels/a.bin", b"a")
    assert sorted(path.name for path in (empty_cache / "kernels").iterdir()) == [name, "a.bin"]
    storage.forget_cached("kernels")
    assert [path.name for path in (empty_cache / "kernels").iterdir()] == [name]


def test_pyopencls_own_cache_may_fail(device, monkeypatch):
    """Its folder may be missing, its database damaged: kernels are made without."""
    import sqlite3

    import pyopencl.invoker  # noqa: F401 (first, with its cache, which it misses ever after)

    real, made = cl.Kernel, []

    def fails(built, name):
        if not cl._PYOPENCL_NO_CACHE:
            raise sqlite3.DatabaseError("file is not a database")
        made.append(name)
        return real(built, name)

    monkeypatch.setattr(cl, "_PYOPENCL_NO_CACHE", False)
    macros = Variant("log_sum_exp.cl", 5).macros(device.constants)
    built = program.build(device.context, "log_sum_exp.cl", macros)
    monkeypatch.setattr(cl, "Kernel", fails)
    assert program.kernel(built, "log_sum_exp").function_name == "log_sum_exp"
    assert made[0] == "log_sum_exp"


# --- global state -----------------------------------------------------------------------


@pytest.mark.needs_device
def test_no_environment_variable_changes(monkeypatch):
    changes = []
    for name in ("putenv", "unsetenv"):
        monkeypatch.setattr(os, name, lambda *change: changes.append(change))
    assert runtimes.list_platforms()
    devices.raw_devices.__wrapped__()
    assert changes == []


def test_no_warning_filter_changes(device, monkeypatch):
    """`warnings.catch_warnings` is everybody's: another thread would lose its own filters."""
    real, entered = warnings.catch_warnings, []

    def spy(**options):
        entered.append(options)
        return real(**options)

    monkeypatch.setenv("PYOPENCL_NO_CACHE", "1")
    far = np.random.default_rng(0).uniform(-0.2, 1.2, (50, 3))
    colors.from_space(far, "lab")  # what is imported for it is not ours
    with monkeypatch.context() as patch:
        patch.setattr(warnings, "catch_warnings", spy)
        macros = Variant("log_sum_exp.cl", 5).macros(device.constants)
        program.build(device.context, "log_sum_exp.cl", macros)
        for space in colors.COLOR_SPACES:
            assert np.isfinite(colors.from_space(far, space)).all()
    assert entered == []


def test_out_of_gamut_colors_are_clipped_as_before(rng):
    """Limiting b leaves the same color as limiting Z."""
    from skimage.color import lab2rgb

    lab = rng.uniform([0, -100, -100], [100, 100, 400], (200, 3))
    with pytest.warns(UserWarning, match="negative Z"):
        expected = lab2rgb(lab.reshape(-1, 1, 3)).reshape(-1, 3)
    actual = colors.from_space(lab / colors._scale("lab"), "lab")
    np.testing.assert_allclose(actual, np.clip(expected, 0, 1), rtol=0, atol=1e-7)


# --- forks, and the end of a process ----------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
# JAX, which another test may have imported into this process, warns of its own threads.
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
def test_a_forked_child_is_told_and_can_use_numpy(device):
    picture = np.random.default_rng(0).random((4, 4, 3))
    cloud = device.upload(np.zeros((3, 5)), np.ones(3))
    uses = [
        lambda: device.softmin(cloud, cloud, np.zeros(3), 1.0),
        lambda: clmorph.get_backend("auto"),
        find_devices,
        devices.raw_devices,
    ]
    child = os.fork()
    if not child:
        told = 0
        for use in uses:
            try:
                use()
            except DeviceError as error:
                told += "get_context('spawn')" in str(error)
        clmorph.morph(picture, picture, n_frames=2, backend="numpy").frame(0.5)
        os._exit(told)
    for _ in range(6000):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            assert os.waitstatus_to_exitcode(status) == len(uses)
            return
        time.sleep(0.05)
    os.kill(child, 9)
    os.waitpid(child, 0)
    pytest.fail("the child hangs")


@pytest.mark.needs_device
def test_daemon_threads_do_not_abort_the_end():
    """A thread in a driver when the interpreter ends: that once ended by SIGABRT."""
    code = (
        "import threading, time, numpy as np, clmorph\n"
        f"o = clmorph.get_backend('{TESTED[0].index}')\n"
        "c = o.upload(np.random.default_rng(0).random((3000, 5)), np.ones(3000))\n"
        "def work():\n"
        "    while True: o.softmin(c, c, np.zeros(3000), 0.01)\n"
        "threading.Thread(target=work, daemon=True).start()\n"
        "time.sleep(0.2)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_errors_pass_between_processes():
    error = pickle.loads(pickle.dumps(PlanSizeError("too many", 7)))
    assert (str(error), error.pairs) == ("too many", 7)
