"""However a run ends, its files are whole, and its temporary files are removed soon."""

import dataclasses
import importlib
import mmap
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import plain
import pytest
from PIL import Image
from sharing import refuse_what_is_open

import clmorph
from clmorph._shared import files, signals, staging
from clmorph._shared.files import atomic_path, atomic_paths, check_place
from clmorph._shared.staging import PREFIX, clear_leftovers
from clmorph.cli.main import main
from clmorph.errors import OutputError
from clmorph.output.recording import Spool
from clmorph.output.save import FORMATS

posix = pytest.mark.skipif(os.name == "nt", reason="signals, locks and rights of POSIX")
FEW = ["--frames", "2", "--backend", "numpy", "--solve-size", "4"]


@pytest.fixture(autouse=True)
def pictures(tmp_path, monkeypatch, rng):
    """Two small pictures, and a folder for results, which is the current one."""
    for name in ("a.png", "b.png"):
        Image.fromarray(rng.integers(0, 255, (5, 6, 3), np.uint8)).save(tmp_path / name)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    return tmp_path


@pytest.fixture
def morph(rng):
    return plain.morph(*rng.random((2, 5, 6, 3)), 3, backend="numpy")


def run(*arguments):
    return main(["morph", "../a.png", "../b.png", *map(str, arguments), *FEW])


def names(folder="."):
    return sorted(path.name for path in Path(folder).iterdir())


def replace_writer(monkeypatch, name, write):
    monkeypatch.setitem(FORMATS, name, dataclasses.replace(FORMATS[name], write=write))


def killing(number):
    """Return a writer that writes something and then gets a signal."""

    def write(film, look, file, report):
        file.write_bytes(b"half")
        os.kill(os.getpid(), number)

    return write


ENDS = [
    pytest.param(signal.SIGINT, 130, "interrupted", id="SIGINT"),
    pytest.param(signal.SIGTERM, 143, "terminated", id="SIGTERM"),
]
if hasattr(signal, "SIGHUP"):
    ENDS.append(pytest.param(signal.SIGHUP, 129, "terminated", id="SIGHUP"))


@posix
@pytest.mark.parametrize(("number", "code", "word"), ENDS)
def test_signals_leave_nothing(number, code, word, monkeypatch, capfd):
    """While the second file is written, to which the first is ready."""
    Path("x.gif").write_text("old")
    replace_writer(monkeypatch, "apng", killing(number))
    before = [signal.getsignal(end.values[0]) for end in ENDS]
    assert run("-o", "x.gif", "-o", "y.apng", "--recipe") == code
    assert [signal.getsignal(end.values[0]) for end in ENDS] == before
    out, err = capfd.readouterr()
    assert out == ""
    assert err.splitlines()[-1] == f"clmorph: {word}, nothing was written"
    assert "" not in err.splitlines()
    assert names() == ["x.gif"]
    assert Path("x.gif").read_text() == "old"


@posix
@pytest.mark.parametrize("moment", ["fitted", "read_picture", "recorded_for"])
def test_signals_at_other_moments(moment, monkeypatch, capfd):
    def kill(*arguments, **options):
        os.kill(os.getpid(), signal.SIGTERM)
        pytest.fail("the signal was not heard")

    module = "request" if moment == "read_picture" else "morph"
    monkeypatch.setattr(f"clmorph.cli.{module}.{moment}", kill)
    assert run("-o", "x.npz") == 143
    assert capfd.readouterr().err.splitlines()[-1] == "clmorph: terminated, nothing was written"
    assert names() == []


@posix
@pytest.mark.parametrize(
    "where",
    [
        # As modules do while they are imported: Python ends by the signal if its own exception
        # has been there, whatever exit code it is given.
        "cli.main = lambda: exec('send()', globals())",
        # In the midst of pyopencl's import, an exception aborts the process.
        "enum.EnumMeta.__call__ = noticed; cli.main = runtimes.list_platforms",
    ],
    ids=["compiled text", "import of pyopencl"],
)
def test_ctrl_c_ends_with_its_exit_code_wherever_it_comes(where):
    code = f"""if True:
        import enum, os, signal, sys
        import clmorph.__main__ as program, clmorph.cli.main as cli
        from clmorph.backends.opencl.devices import runtimes

        def send():
            os.kill(os.getpid(), signal.SIGINT)

        def noticed(*arguments, usual=enum.EnumMeta.__call__, **options):
            if "pyopencl" in sys.modules and options:
                enum.EnumMeta.__call__ = usual
                send()
            return usual(*arguments, **options)

        {where}
        raise SystemExit(program.main())
        """
    Path("run.py").write_text(code)
    command = [sys.executable, "-m", "run"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stderr == "clmorph: interrupted, nothing was written\n"


@posix
def test_a_signal_in_a_destructor_ends_the_run_all_the_same(monkeypatch, capfd):
    """There Python prints exceptions and goes on; and a remark of others is still printed."""

    class Gone:
        def __init__(self, number):
            self.number = number

        def __del__(self):
            if not self.number:
                raise ValueError("of theirs")
            os.kill(os.getpid(), self.number)

    def write(film, look, file, report):
        Gone(0)
        Gone(signal.SIGTERM)
        threading.Event().wait(60)  # on a busy machine it comes late
        pytest.fail("the signal was not heard")

    seen = []
    monkeypatch.setattr(sys, "unraisablehook", seen.append)
    replace_writer(monkeypatch, "gif", write)
    assert run("-o", "x.gif") == 143
    assert [what.exc_type for what in seen] == [ValueError]
    assert sys.unraisablehook == seen.append
    assert capfd.readouterr().err.splitlines()[-1] == "clmorph: terminated, nothing was written"
    assert names() == []


@posix
def test_a_second_signal_does_not_disturb_the_clearing_up(monkeypatch, capfd):
    replace_writer(monkeypatch, "gif", killing(signal.SIGTERM))
    usual = shutil.rmtree

    def remove(folder, **options):
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        usual(folder, **options)

    monkeypatch.setattr(staging.shutil, "rmtree", remove)
    assert run("-o", "x.gif") == 143
    assert names() == []


@posix
def test_a_signal_while_files_take_their_places_waits(monkeypatch, capfd):
    """All or none: never one of two."""
    usual = files._put

    def put(new, place, undo):
        os.kill(os.getpid(), signal.SIGTERM)
        usual(new, place, undo)

    monkeypatch.setattr(files, "_put", put)
    assert run("-o", "x.gif", "-o", "y.apng") == 143
    assert names() == ["x.gif", "y.apng"]
    said = capfd.readouterr().err.splitlines()[-1]
    assert said == "clmorph: terminated, after the files were written"


@posix
def test_whose_handlers_are_left_alone(monkeypatch):
    """Ignored ones (nohup), a caller's own, other threads; and the library's users have none."""

    def own(number, frame):
        pass

    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, own)
    try:
        with signals.terminable() as ending:
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) is own
            assert signal.getsignal(signal.SIGINT) == ending.handle
            with signals.terminable() as inner:
                assert inner is ending
            assert signal.getsignal(signal.SIGINT) == ending.handle
    finally:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    codes = []
    monkeypatch.setattr(signal, "signal", lambda *both: pytest.fail("a handler was installed"))
    thread = threading.Thread(target=lambda: codes.append(run("-o", "x.gif")))
    thread.start()
    thread.join()
    assert codes == [0]
    with atomic_path("y.txt") as path:
        path.write_text("y")


#: A run that says when its file is half written, and then waits for what comes.
WAITING = """
import dataclasses, sys, time
from pathlib import Path
from clmorph.__main__ import main
from clmorph.output.save import FORMATS

def write(film, look, file, report):
    file.write_bytes(b"half")
    print("ready", flush=True)
    time.sleep(600)

FORMATS["gif"] = dataclasses.replace(FORMATS["gif"], write=write)
raise SystemExit(main())
"""


def waiting():
    arguments = ["morph", "../a.png", "../b.png", "-o", "x.gif", *FEW]
    process = subprocess.Popen(
        [sys.executable, "-c", WAITING, *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "ready\n", process.communicate()
    return process


@posix
def test_what_a_killed_run_leaves_is_removed_by_the_next(capfd):
    with waiting() as killed, waiting() as living:
        assert [name[: len(PREFIX)] for name in names()] == 2 * [PREFIX]
        killed.kill()
        killed.communicate()
        # Its folder goes; that of the run beside stays.
        assert run("-o", "y.gif") == 0
        left = names()
        assert len(left) == 2
        assert left[1] == "y.gif"
        assert (Path(left[0]) / "new.gif").read_bytes() == b"half"
        living.send_signal(signal.SIGTERM)
        _, err = living.communicate()
    assert living.returncode == 143
    assert err.splitlines()[-1] == "clmorph: terminated, nothing was written"
    assert "Traceback" not in err
    assert names() == ["y.gif"]


# Staging folders.


@pytest.fixture
def gone():
    """The number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        pass
    return process.pid


def leftover(process, end="abcdefgh", place=None):
    folder = Path(f"{PREFIX}{process}-{place or staging._place()}-{end}")
    folder.mkdir()
    (folder / "new.gif").write_text("half")
    (folder / "new").mkdir()
    (folder / "new" / "frame-0000.png").write_text("half")
    return folder


def test_leftovers_go_with_the_next_file(gone):
    leftover(gone)
    leftover(gone, "bcdefghi")
    with atomic_path("x.txt") as path:
        assert names() == [path.parent.name]
        path.write_text("x")
    assert names() == ["x.txt"]


def test_what_is_another_machines_or_not_ours_stays(tmp_path, gone):
    leftover(gone, place="00000000")
    leftover(os.getpid())
    leftover(2**70)  # no system has so many
    for name in (f"{PREFIX}mine", f"{PREFIX}x-{staging._place()}-abcdefgh", f"{PREFIX}bcdefghi"):
        Path(name).mkdir()
    ours = f"{PREFIX}{gone}-{staging._place()}-"
    Path(f"{ours}cdefghij").write_text("a file")
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "kept").write_text("")
    if os.name != "nt":
        Path(f"{ours}defghijk").symlink_to(linked)
    before = names()
    clear_leftovers(Path())
    assert names() == before
    assert names(linked) == ["kept"]
    clear_leftovers(Path("missing"))


@posix
def test_another_users_leftovers_stay(monkeypatch, gone):
    folder = leftover(gone)
    monkeypatch.setattr(os, "geteuid", lambda: folder.stat().st_uid + 1)
    clear_leftovers(Path())
    assert folder.exists()


# Places.


def test_all_take_their_places_or_none():
    Path("a.txt").write_text("old a")
    with ExitStack() as stack:
        for path in stack.enter_context(atomic_paths(["a.txt", "b.txt", "c.txt"])):
            path.write_text("new")
        Path("c.txt").mkdir()
        with pytest.raises(OutputError, match=r"c\.txt cannot be written"):
            stack.close()
    assert names() == ["a.txt", "c.txt"]
    assert Path("a.txt").read_text() == "old a"


def test_data_are_on_the_disk_before_they_replace_anything(monkeypatch):
    log = []
    usual = os.fsync, Path.replace

    def fsync(handle):
        log.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        usual[0](handle)

    def replace(path, target):
        log.append(f"{Path(target).name} replaced")
        return usual[1](path, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replace)
    with atomic_paths(["a.txt", "frames"]) as (file, folder):
        file.write_text("a")
        folder.mkdir()
        (folder / "0.png").write_text("0")
        (folder / "1.png").write_text("1")
    moved = ["a.txt replaced", "frames replaced"]
    last = [] if os.name == "nt" else ["folder"]
    assert log == ["file", "file", "file", *last, *moved, *last]


@posix
def test_a_disk_that_cannot_flush_is_good_enough_and_one_that_fails_is_not(monkeypatch):
    for code, good in ((22, True), (5, False)):

        def fsync(handle, code=code):
            raise OSError(code, "words")

        monkeypatch.setattr(os, "fsync", fsync)
        with ExitStack() as stack:
            if not good:
                stack.enter_context(pytest.raises(OutputError, match="words"))
            stack.enter_context(atomic_path(f"{code}.txt")).write_text("x")
    assert names() == ["22.txt"]


@contextmanager
def limited(size):
    """Limit the size of files, which stands for a full disk."""
    resource = pytest.importorskip("resource")
    before, kept = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    # Python would keep the first bytes of modules that are imported now, as if they were all.
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = kept


@pytest.mark.in_turns
@posix
@pytest.mark.parametrize("name", list(FORMATS))
def test_a_full_disk_leaves_nothing(name, monkeypatch, capfd):
    """Of every format, and an old file stays."""
    output = Path(f"x{(FORMATS[name].endings or ('',))[0]}")
    if output.suffix:
        output.write_text("old")
    with limited(200):
        # As Python has it; a compiler that was loaded before prints where it stood.
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        # On NumPy: a driver that finds no room for what it builds is not the matter here.
        # With a preset fewer lines are printed, which the limit cuts too.
        options = "--backend", "numpy", "--preset", "photo"
        code = run("-o", output, "--format", name, *options)
    out, err = capfd.readouterr()
    assert code == 2
    assert out == ""
    last = [line for line in err.splitlines() if not line.startswith(("device:", "memory:"))]
    assert len(last) == 1
    assert "cannot be written (File too large)" in last[0] or "failed" in last[0]
    assert names() == [output.name][: bool(output.suffix)]
    assert not output.suffix or output.read_text() == "old"


@posix
def test_frames_that_find_no_room_are_told(monkeypatch, capfd):
    monkeypatch.setattr("clmorph.output.recording.IN_MEMORY", 64)
    with limited(400):
        # The limit is also that of the captured lines.
        line = ["morph", "../a.png", "../b.png", "-o", "x.gif", *FEW, "--frames", "9"]
        assert main(line) == 2
        with Spool(np.uint8, Path()) as spool:
            spool.append(np.zeros(390, np.uint8))
            spool.append(np.zeros(390, np.uint8))  # still in Python's buffer
            with pytest.raises(OutputError, match="cannot be kept on disk"):
                spool[0]
    assert "frames cannot be kept on disk" in capfd.readouterr().err.splitlines()[-1]
    assert names() == []


@posix
def test_a_spool_has_no_name(monkeypatch):
    monkeypatch.setattr("clmorph.output.recording.IN_MEMORY", 64)
    with Spool(np.uint8, Path()) as spool:
        spool.append(np.zeros(60, np.uint8))
        assert names() == []  # still in memory
        spool.append(np.ones(9000, np.uint8))
        (folder,) = map(Path, names())
        assert staging.is_staging(folder)
        assert names(folder) == []
        assert not spool[0].any()
        assert spool[1].all()
    assert names() == []


@pytest.mark.parametrize("at", ["frames", "../out"])
def test_frames_that_wait_beside_a_folder_are_not_in_it(at, monkeypatch, capfd):
    """As on Windows, and on network disks: the file that they wait in has a name."""
    monkeypatch.setattr("clmorph.output.recording.IN_MEMORY", 64)
    monkeypatch.setattr("tempfile.TemporaryFile", tempfile.NamedTemporaryFile)
    Path(at).mkdir(exist_ok=True)
    assert run("-o", at) == 0, capfd.readouterr().err
    assert names(at) == ["frame-0000.png", "frame-0001.png"]


@pytest.mark.in_turns
@pytest.mark.parametrize("name", list(FORMATS))
def test_no_file_is_moved_or_removed_while_it_is_open(name, monkeypatch, capfd):
    """Windows refuses that. Frames wait on the disk, and files replace old ones."""
    monkeypatch.setattr("clmorph.output.recording.IN_MEMORY", 64)
    monkeypatch.setattr("tempfile.TemporaryFile", tempfile.NamedTemporaryFile)
    refused = refuse_what_is_open(monkeypatch)
    target = f"x{(FORMATS[name].endings or ('',))[0]}"
    for _ in range(2):
        assert run("-o", target, "--format", name, "--recipe") == 0, capfd.readouterr().err
        for frame in Path(target).iterdir() if Path(target).is_dir() else ():
            frame.unlink()
    assert refused == []
    assert names() == [target, f"{target}.json"]


def test_a_file_that_another_program_shows_stays(monkeypatch):
    """On Windows; one line tells it, and nothing is left beside it."""
    Path("x.gif").write_bytes(b"old")
    refuse_what_is_open(monkeypatch)
    with Path("x.gif").open("rb"), ExitStack() as stack:
        for path in stack.enter_context(atomic_paths(["y.gif", "x.gif"])):
            path.write_bytes(b"new")
        with pytest.raises(OutputError, match=r"x\.gif cannot be written \(The process cannot"):
            stack.close()
    assert names() == ["x.gif"]
    assert Path("x.gif").read_bytes() == b"old"


@posix
def test_a_signal_that_waited_for_a_block_that_fails():
    """It ends the run then, not at the next block."""
    with signals.terminable():
        with pytest.raises(signals.Terminated) as caught, signals.undisturbed():  # noqa: PT012
            os.kill(os.getpid(), signal.SIGTERM)
            raise ValueError
        assert isinstance(caught.value.__context__, ValueError)
        with signals.undisturbed():
            pass


@posix
def test_a_signal_during_an_import_comes_after_it(monkeypatch):
    """A compiled module may lose what is raised in it, as this one does."""
    Path("clmorph_late.py").write_text(
        "import os, signal, time\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    for _ in range(10): time.sleep(0.01)\n"
        "except BaseException:\n"
        "    pass\n"
        "complete = True\n"
    )
    monkeypatch.syspath_prepend(Path.cwd())
    with signals.terminable(), pytest.raises(signals.Terminated):  # noqa: PT012
        assert importlib.import_module("clmorph_late").complete
        threading.Event().wait(60)
        pytest.fail("the signal was not heard")


@pytest.mark.parametrize(("number", "times"), [(3, 0), (200, 1)])
def test_many_files_go_to_the_disk_at_once(number, times, monkeypatch):
    """For each to wait for the disk takes long; but each is asked whether it got there."""
    told = []
    flush = os.fsync
    monkeypatch.setattr(os, "sync", lambda: told.append("sync"), raising=False)
    monkeypatch.setattr(os, "fsync", lambda handle: (told.append("fsync"), flush(handle)))
    with atomic_path("frames") as folder:
        folder.mkdir()
        for index in range(number):
            (folder / f"{index}").write_bytes(b"x")
    assert told[:times] == ["sync"] * times
    assert told.count("sync") == times
    assert told.count("fsync") >= number
    assert len(names("frames")) == number


@posix
def test_a_folder_that_is_removed_meanwhile_is_told(tmp_path, monkeypatch, capfd):
    gone = tmp_path / "gone"

    def early(film, look, file, report):
        shutil.rmtree(gone)
        file.write_bytes(b"x")

    def late(film, look, file, report):
        file.write_bytes(b"x")
        shutil.rmtree(gone)

    for writer in (early, late):
        gone.mkdir()
        replace_writer(monkeypatch, "gif", writer)
        assert run("-o", "../gone/x.gif") == 2
        err = capfd.readouterr().err.splitlines()[-1]
        assert "gone/x.gif cannot be written (No such file or directory)" in err


@posix
def test_rights_stay_as_they_were():
    for mode in (0o600, 0o644, 0o666, 0o640):
        Path("x.txt").write_text("old")
        Path("x.txt").chmod(mode)
        if os.geteuid() == 0:
            os.chown("x.txt", 12345, 54321)
        with atomic_path("x.txt") as path:
            path.write_text("new")
        after = Path("x.txt").stat()
        assert stat.S_IMODE(after.st_mode) == mode
        if os.geteuid() == 0:
            assert (after.st_uid, after.st_gid) == (12345, 54321)
    before = os.umask(0o027)
    try:
        with atomic_paths(["y.txt", "frames"]) as (file, folder):
            file.write_text("y")
            folder.mkdir()
    finally:
        os.umask(before)
    assert stat.S_IMODE(Path("y.txt").stat().st_mode) == 0o640
    assert stat.S_IMODE(Path("frames").stat().st_mode) == 0o750


def test_a_write_protected_file_is_not_replaced(monkeypatch):
    Path("x.gif").write_text("kept")
    Path("x.gif").chmod(0o444)
    # Root may write anything; others are told.
    usual = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: not (mode & os.W_OK) and usual(path, mode))
    with pytest.raises(OutputError, match="write-protected"):
        check_place("x.gif")
    Path("x.gif").chmod(0o644)


@posix
def test_names_as_long_as_they_can_be(morph):
    for name in ("n" * 251 + ".gif", "n." + "s" * 253, "." * 255):
        with atomic_path(name) as path:
            path.write_text("x")
        assert Path(name).read_text() == "x"
        Path(name).unlink()
    with pytest.raises(OutputError, match="too long"):
        check_place("n" * 256)
    assert run("-o", "n" * 251 + ".gif", "--recipe") == 2  # OUTPUT.json would be longer
    assert names() == []


@posix
def test_a_path_too_long_for_what_lies_beside_is_said_first():
    deep = Path.cwd()
    while len(str(deep)) < 4080:
        deep /= "d" * min(200, 4084 - len(str(deep)))
    deep.mkdir(parents=True)
    with pytest.raises(OutputError, match="too long"):
        check_place(deep / "x.txt")


@posix
def test_who_reads_the_old_file_goes_on(morph):
    morph.save("x.npz")
    before = Path("x.npz").read_bytes()
    with (
        Path("x.npz").open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped,
    ):
        morph.save("x.npz", parameters={"clmorph": "other"})
        assert bytes(mapped) == before
    assert clmorph.load("x.npz").parameters == {"clmorph": "other"}


def test_what_goes_into_a_folder_is_made_there(tmp_path, morph, monkeypatch, gone):
    """The folder may be a separate disk, or the only writable place."""
    homes = []
    usual = staging.tempfile.mkdtemp

    def mkdtemp(**options):
        homes.append(Path(options["dir"]))
        return usual(**options)

    monkeypatch.setattr(staging.tempfile, "mkdtemp", mkdtemp)
    (tmp_path / "frames").mkdir()
    beside = leftover(gone)
    beside.rename(tmp_path / "frames" / beside.name)  # which does not fill it
    morph.save(tmp_path / "frames")
    assert homes == [tmp_path / "frames"]
    assert names(tmp_path / "frames") == [f"frame-000{number}.png" for number in range(3)]


@pytest.mark.parametrize("at_once", [False, True])
def test_two_runs_into_one_folder_do_not_mix(monkeypatch, at_once):
    """Also if both have found the folder empty."""
    Path("frames").mkdir()
    if at_once:
        monkeypatch.setattr(files, "is_empty", lambda folder: True)
    with ExitStack() as stack:
        path = stack.enter_context(atomic_path("frames"))
        path.mkdir()
        for name in ("0.png", "1.png"):
            (path / name).write_text("mine")
        Path("frames/1.png").write_text("theirs")
        with pytest.raises(OutputError, match="exists" if at_once else "not empty"):
            stack.close()
    assert names("frames") == ["1.png"]
    assert Path("frames/1.png").read_text() == "theirs"


def test_the_last_of_two_runs_wins():
    with atomic_path("x.txt") as one, atomic_path("x.txt") as other:
        one.write_text("one")
        other.write_text("other")
    assert Path("x.txt").read_text() == "one"
    assert names() == ["x.txt"]


def test_no_other_folder_is_needed(morph, monkeypatch):
    """TMPDIR may name none, or one that is full."""

    def gettempdir():
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setattr("tempfile.gettempdir", gettempdir)
    monkeypatch.setattr("clmorph.output.recording.IN_MEMORY", 64)
    for name in ("x.gif", "x.webp", "x.npz", "x.tif", "x.html", "x.png", "frames", "x.mp4"):
        morph.save(name)
    assert not [name for name in names() if name.startswith(PREFIX)]
