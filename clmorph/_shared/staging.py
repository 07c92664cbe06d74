"""Hidden folders for new files beside their targets, named after the process that made each.

A killed process leaves its folder ``.clmorph-PROCESS-PLACE-XXXXXXXX``. The next run that writes to
the same place removes it if that process is gone. PLACE stands for the machine and the container:
the folders of another one stay.
"""

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
from zlib import crc32

from clmorph._shared.signals import undisturbed

PREFIX = ".clmorph-"
NAME = re.compile(re.escape(PREFIX) + "([0-9]+)-([0-9a-f]{8})-[a-z0-9_]{8}")


@contextmanager
def staging_folder(home: Path) -> Iterator[Path]:
    """Make a folder in `home` for the block, after those that killed processes left are removed."""
    clear_leftovers(home)
    folder = None
    try:
        with undisturbed():
            folder = Path(tempfile.mkdtemp(dir=home, prefix=own_prefix()))
        yield folder
    finally:
        if folder is not None:
            with undisturbed():
                shutil.rmtree(folder, ignore_errors=True)


def own_prefix() -> str:
    """Return what the names of this process's folders begin with; eight characters follow."""
    return f"{PREFIX}{os.getpid()}-{_place()}-"


def is_staging(path: Path) -> bool:
    """Return whether a path is that of a staging folder, by its name."""
    return NAME.fullmatch(path.name) is not None


def clear_leftovers(home: Path) -> None:
    """Remove the staging folders of ended processes inside a folder, where permissions allow it."""
    with suppress(OSError), os.scandir(home) as entries:
        for entry in entries:
            found = NAME.fullmatch(entry.name)
            if found and found[2] == _place() and not _is_alive(int(found[1])):
                with suppress(OSError):  # a folder of this user; neither a file nor a link
                    known = Path(entry.path).lstat()
                    own = known.st_uid == getattr(os, "geteuid", lambda: 0)()
                    if own and stat.S_ISDIR(known.st_mode):
                        shutil.rmtree(entry.path, ignore_errors=True)


def _place() -> str:
    """Return a digest of the machine's name and, where there are some, the space of process ids."""
    spaces = ""
    with suppress(OSError):
        spaces = str(Path("/proc/self/ns/pid").readlink())
    return f"{crc32(f'{platform.node()} {spaces}'.encode()):08x}"


def _is_alive(process: int) -> bool:
    """Return whether there is a process with this number; True if that cannot be known."""
    if sys.platform == "win32":
        import ctypes

        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        synchronize, invalid = 0x100000, 87  # the error for a number that is no process's
        handle = kernel.OpenProcess(synchronize, False, process)
        if not handle:
            return ctypes.get_last_error() != invalid
        kernel.CloseHandle(handle)
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
