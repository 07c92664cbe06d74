import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

from clmorph._shared import files
from clmorph._shared.files import atomic_path, check_place, is_closed_pipe
from clmorph.errors import OutputError


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "out"
    place.mkdir()
    return place


def _names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("old", [None, b"old"])
def test_a_file_appears_whole_at_the_end_and_nothing_beside_it(folder, old):
    target = folder / "picture.png"
    if old:
        target.write_bytes(old)
    with atomic_path(target) as path:
        assert path.suffix == ".png"
        assert path.parent.parent == folder
        assert not path.exists()
        path.write_bytes(b"new")
        assert (target.read_bytes() if target.exists() else None) == old
    assert target.read_bytes() == b"new"
    assert _names(folder) == ["picture.png"]


@pytest.mark.parametrize("stop", [ValueError, KeyboardInterrupt, SystemExit, GeneratorExit])
def test_whatever_stops_the_block_leaves_the_target_as_it_was(folder, stop):
    target = folder / "a.txt"
    target.write_text("old")
    with pytest.raises(stop), atomic_path(target) as path:  # noqa: PT012 (the block is the test)
        path.write_text("half")
        (path.parent / "notes").write_text("beside it")
        raise stop
    assert target.read_text() == "old"
    assert _names(folder) == ["a.txt"]


def test_what_the_system_refuses_is_told_in_one_line(folder):
    with (
        pytest.raises(OutputError, match=r"a\.txt cannot be written \(No space left") as caught,
        atomic_path(folder / "a.txt"),
    ):
        raise OSError(28, "No space left on device")
    assert "\n" not in str(caught.value)
    assert _names(folder) == []


def test_nothing_written_is_an_error_and_not_an_empty_file(folder):
    with pytest.raises(OutputError, match="cannot be written"), atomic_path(folder / "a.txt"):
        pass
    assert _names(folder) == []


@pytest.mark.parametrize("exists", [False, True])
def test_a_folder_takes_the_place_of_none_or_of_an_empty_one(folder, exists):
    target = folder / "frames"
    if exists:
        target.mkdir()
    with atomic_path(target) as path:
        path.mkdir()
        (path / "0.png").write_bytes(b"0")
    assert _names(folder) == ["frames"]
    assert _names(target) == ["0.png"]


def test_a_full_folder_stays(folder):
    target = folder / "frames"
    target.mkdir()
    (target / "mine").write_text("keep")
    with pytest.raises(OutputError, match="not empty"), atomic_path(target) as path:
        path.mkdir()
    assert _names(target) == ["mine"]
    assert _names(folder) == ["frames"]


@pytest.mark.parametrize("old", [None, "old"])
def test_a_link_stays_a_link_and_its_file_is_written(folder, tmp_path, old):
    """Also a link to nothing yet."""
    (tmp_path / "far").mkdir()
    real = tmp_path / "far" / "real.txt"
    if old:
        real.write_text(old)
    link = folder / "link.txt"
    link.symlink_to(real)
    with atomic_path(link) as path:
        path.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert _names(tmp_path / "far") == ["real.txt"]


@pytest.mark.parametrize("target", ["", None, 3])
def test_what_is_no_path_is_refused(target):
    with pytest.raises(OutputError, match="is not a path"):
        check_place(target)


def test_places_that_cannot_be_are_refused_before_any_work(folder):
    with pytest.raises(OutputError, match=r"there is no folder .*missing; make it first"):
        check_place(folder / "missing" / "a.png")
    loop = folder / "loop"
    loop.symlink_to(loop)
    for place in (folder / ("n" * 5000), "null\0byte", loop):
        with pytest.raises(OutputError):
            check_place(place)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_device_or_a_pipe_is_not_replaced_by_a_file(folder):
    os.mkfifo(folder / "pipe")
    for place in (os.devnull, folder / "pipe"):
        with pytest.raises(OutputError, match="neither a file nor a folder"):
            check_place(place)


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
def test_a_folder_that_may_not_be_written_is_refused():
    """Checked as an ordinary user: root may write everywhere."""
    folder, user = Path(tempfile.mkdtemp()), os.geteuid()
    folder.chmod(0o555)
    try:
        if user == 0:
            os.seteuid(65534)
        with pytest.raises(OutputError, match="Permission denied"):
            check_place(folder / "a.png")
    finally:
        os.seteuid(user)
        folder.rmdir()


@pytest.mark.parametrize(
    ("error", "here", "there"),
    [
        (BrokenPipeError(32, "Broken pipe"), True, True),
        (OSError(22, "Invalid argument"), False, True),
        (OSError(22, "Invalid argument", "a?.gif"), False, False),
        (OSError(28, "No space left on device"), False, False),
    ],
)
def test_a_pipe_that_nobody_reads_has_an_error_of_its_own_on_windows(
    monkeypatch, capfd, tmp_path, error, here, there
):
    def fail(*_):
        raise error

    (tmp_path / "made").write_bytes(b"made")
    monkeypatch.setattr(shutil, "copyfileobj", fail)
    for platform, closed in (("linux", here), ("win32", there)):
        monkeypatch.setattr(sys, "platform", platform)
        assert is_closed_pipe(error) == closed
        if closed:
            assert not files._copied_out(tmp_path / "made")
            continue
        with pytest.raises(OutputError, match="standard output cannot be written"):
            files._copied_out(tmp_path / "made")
