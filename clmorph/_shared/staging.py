"""Hidden folders in which files are made, and what is left of them when a process is killed.

A staging folder is called ``.clmorph-`` and eight characters. The process that made it holds a
lock on the file ``owner`` inside for as long as it lives; the system releases the lock however
the process ends. The next run that writes to the same place removes folders whose lock is free.
Of two runs side by side neither removes the other's.

Where the file system knows no locks, and where another machine made the folder (the file tells
its name), nothing is removed.
"""

import errno
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clmorph._shared.signals import undisturbed

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

#: What the folders are called, and the file inside that is locked.
PREFIX, OWNER = ".clmorph-", "owner"
NAME = re.compile(re.escape(PREFIX) + "[a-z0-9_]{8}")
#: What a lock's refusal is called where another process holds it.
HELD = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)
#: Windows locks ranges of bytes and forbids to read them: one that nobody reads.
FAR = 1 << 30
#: How often a folder is made anew, if others clear it away before it is locked.
TRIES = 100


@contextmanager
def staging_folder(home: Path) -> Iterator[Path]:
    """Make a folder for the block alone; afterwards it is gone, with all that is inside.

    Parameters
    ----------
    home : Path
        The folder in which it is made. What killed processes left there is removed first.

    Yields
    ------
    Path

    Raises
    ------
    OSError
        If it cannot be made.
    """
    clear_leftovers(home)
    folder = handle = None
    try:
        with undisturbed():
            folder, handle = _make(home)
        yield folder
    finally:
        if folder is not None and handle is not None:
            with undisturbed():
                _remove(folder, handle)


def is_staging(path: Path) -> bool:
    """Whether a path is that of a staging folder, by its name."""
    return NAME.fullmatch(path.name) is not None


def clear_leftovers(home: Path) -> None:
    """Remove the staging folders in a folder whose processes are gone; those that may be."""
    try:
        with os.scandir(home) as entries:
            found = [Path(entry.path) for entry in entries if NAME.fullmatch(entry.name)]
    except OSError:
        return
    for folder in found:
        with suppress(OSError):
            _clear(folder)


def _make(home: Path) -> tuple[Path, int]:
    """Return a new folder and the handle that keeps it locked.

    Between making and locking, another process may take the folder for a leftover. Then it is
    gone, or the lock is held, and the next one is tried.
    """
    for _ in range(TRIES):
        folder = Path(tempfile.mkdtemp(dir=home, prefix=PREFIX))
        owner = folder / OWNER
        try:
            handle = os.open(owner, os.O_RDWR | os.O_CREAT | _flags(), 0o600)
        except FileNotFoundError:
            continue
        except OSError:
            with suppress(OSError):
                folder.rmdir()
            raise
        try:
            os.write(handle, platform.node().encode())
            ours = _lock(handle) is not False and _is_at(handle, owner)
        except BaseException:
            _remove(folder, handle)
            raise
        if ours:
            return folder, handle
        os.close(handle)
    raise OSError(errno.EBUSY, "another process removes its temporary folders")


def _clear(folder: Path) -> None:
    """Remove one leftover; leave everything else alone."""
    known = folder.lstat()
    if not stat.S_ISDIR(known.st_mode):
        return
    if hasattr(os, "geteuid") and known.st_uid != os.geteuid():
        return
    owner = folder / OWNER
    try:
        handle = os.open(owner, os.O_RDWR | _flags())
    except FileNotFoundError:
        folder.rmdir()  # killed before it was locked, or nearly gone; fails if it is not empty
        return
    free = False
    try:
        if stat.S_ISREG(os.fstat(handle).st_mode):
            told = os.read(handle, 1024)
            free = told in (b"", platform.node().encode()) and _lock(handle) is True
            free = free and _is_at(handle, owner)
    finally:
        if not free:
            os.close(handle)
    if free:
        _remove(folder, handle)


def _remove(folder: Path, handle: int) -> None:
    """Remove a folder of one's own; the lock last, so that what remains is known for a leftover."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != OWNER:
                path.unlink(missing_ok=True)
    os.close(handle)  # some systems remove no file that is open
    with suppress(OSError):
        (folder / OWNER).unlink(missing_ok=True)
        folder.rmdir()


def _flags() -> int:
    """Neither follow a link nor wait for a pipe's other end."""
    return getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


def _lock(handle: int) -> bool | None:
    """Lock a file without waiting; False if another holds it, None if there are no locks."""
    try:
        if sys.platform == "win32":
            os.lseek(handle, FAR, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in HELD else None
    return True
