"""Hidden staging folders for new files, and the removal of those that killed processes left.

The process that made a folder ``.clmorph-XXXXXXXX`` holds a lock on the file ``owner`` inside,
which the system releases however the process ends. The next run that writes to the same place
removes the folders whose lock is free. Nothing is removed if the file system has no locks, or if
another machine made the folder (``owner`` contains its name).
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

#: Prefix of the folders' names, and name of the locked file inside.
PREFIX, OWNER = ".clmorph-", "owner"
NAME = re.compile(re.escape(PREFIX) + "[a-z0-9_]{8}")
#: Error numbers of a lock that another process holds.
HELD = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)
#: Offset of the locked byte. Windows forbids reading locked bytes, and nobody reads this one.
FAR = 1 << 30
#: Number of attempts to make a folder, as other runs can remove it before it is locked.
TRIES = 100


@contextmanager
def staging_folder(home: Path) -> Iterator[Path]:
    """Make a folder in `home` for the block, and remove it with its contents afterwards.

    Folders that killed processes left there are removed first.
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
    """Return whether a path is that of a staging folder, by its name."""
    return NAME.fullmatch(path.name) is not None


def clear_leftovers(home: Path) -> None:
    """Remove the staging folders of ended processes inside a folder, where permissions allow it."""
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

    Before the new folder is locked, another process can take it for a leftover and remove or lock
    it. Another folder is then made.
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
    """Remove one leftover folder; leave every other folder alone."""
    known = folder.lstat()
    if not stat.S_ISDIR(known.st_mode):
        return
    if hasattr(os, "geteuid") and known.st_uid != os.geteuid():
        return
    owner = folder / OWNER
    try:
        handle = os.open(owner, os.O_RDWR | _flags())
    except FileNotFoundError:
        folder.rmdir()  # not locked yet, or nearly removed; fails if the folder is not empty
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
    """Remove a locked folder, its lock last, so that an incomplete one is seen as a leftover."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != OWNER:
                path.unlink(missing_ok=True)
    os.close(handle)  # some systems cannot remove open files
    with suppress(OSError):
        (folder / OWNER).unlink(missing_ok=True)
        folder.rmdir()


def _flags() -> int:
    """Return flags to open a file without following a link or waiting for a pipe's other end."""
    return getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


def _lock(handle: int) -> bool | None:
    """Lock a file without waiting; False if another process holds it, None without lock support."""
    try:
        if sys.platform == "win32":
            os.lseek(handle, FAR, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in HELD else None
    return True
