"""Small files in the user's cache folder, which can be made anew at any time.

No function here raises an error. A file that cannot be read counts as missing, and a file that
cannot be written is not kept. Processes that write at the same time replace each other's files
as a whole.
"""

import contextlib
import json
import os
import stat
import tempfile
import time
from pathlib import Path
from typing import Any

import platformdirs

#: Ending of files that are being written, and the age in seconds at which nobody writes them
#: any more: their process was killed.
_PART, _PART_SECONDS = ".part", 3600.0


def cache_folder() -> Path | None:
    """Return the folder for such files; None if none can be written to.

    The user's cache folder; where that cannot be written to (a read-only home, say), one in
    the temporary folder that is its owner's alone: kernels that are run lie there.
    """
    for folder in _wanted_folders():
        # A relative path would be another folder after each change of directory.
        if folder.is_absolute() and _can_write(folder):
            return folder
    return _private_folder()


def _wanted_folders() -> list[Path]:
    folders = [Path(platformdirs.user_cache_dir("clmorph", appauthor=False))]
    if not folders[0].is_absolute():
        # The XDG specification has it that a relative XDG_CACHE_HOME be ignored.
        with contextlib.suppress(RuntimeError):  # there is no home
            folders.append(Path.home() / ".cache" / "clmorph")
    return folders


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError):
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _private_folder() -> Path | None:
    """Return a folder of the user in the temporary one; None if it is not theirs alone."""
    user = os.getuid() if hasattr(os, "getuid") else "cache"
    try:
        folder = Path(tempfile.gettempdir()) / f"clmorph-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    if not stat.S_ISDIR(found.st_mode):
        return None
    # On Windows the temporary folder itself is the user's.
    if hasattr(os, "getuid") and (found.st_uid != user or found.st_mode & 0o077):
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def read_cached(name: str) -> bytes:
    """Return the content of a file in the cache; nothing if there is none.

    Parameters
    ----------
    name : str
        With the folder inside the cache, such as "kernels/rows.bin".
    """
    folder = cache_folder()
    try:
        return (folder / name).read_bytes() if folder else b""
    except OSError:
        return b""


def write_cached(name: str, content: bytes) -> None:
    """Keep a file in the cache, if that is possible; see `read_cached`."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        _remove_parts((folder / name).parent)
        write_atomically(folder / name, content)


def forget_cached(name: str) -> None:
    """Remove a file, or all files of a folder, from the cache."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        place = folder / name
        for file in place.iterdir() if place.is_dir() else [place]:
            file.unlink(missing_ok=True)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a small file so that readers see the old or the new one, never a part."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=_PART)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _remove_parts(folder: Path) -> None:
    """Remove what killed processes left half-written."""
    for file in folder.glob(f"*{_PART}"):
        with contextlib.suppress(OSError):
            if time.time() - file.stat().st_mtime > _PART_SECONDS:
                file.unlink()


def load_record(name: str) -> dict[str, Any]:
    """Read a JSON object from the cache; a missing or damaged one is empty.

    Parameters
    ----------
    name : str
        Without its ending, such as "devices/0123".
    """
    try:
        record = json.loads(read_cached(f"{name}.json"))
    except (ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def save_record(name: str, record: dict[str, Any]) -> None:
    """Keep a JSON object in the cache, if that is possible; see `load_record`.

    One file each: processes that find out different things at once do not undo each other.
    """
    write_cached(f"{name}.json", json.dumps(record, indent=1, sort_keys=True).encode())
