"""Small files in the user's cache folder, replaced as a whole; what fails counts as missing."""

import contextlib
import json
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

import platformdirs

from clmorph._shared.staging import staging_folder


def cache_folder() -> Path | None:
    """Return the folder of the cache, or a private temporary one; None if none is writable."""
    wanted = [Path(platformdirs.user_cache_dir("clmorph", appauthor=False))]
    if not wanted[0].is_absolute():
        # The XDG specification requires that a relative XDG_CACHE_HOME is ignored.
        with contextlib.suppress(RuntimeError):  # the user has no home
            wanted.append(Path.home() / ".cache" / "clmorph")
    for folder in wanted:
        # A relative path would be another folder after each change of directory.
        if folder.is_absolute():
            with contextlib.suppress(OSError, ValueError):
                folder.mkdir(parents=True, exist_ok=True)
                if os.access(folder, os.W_OK | os.X_OK):
                    return folder
    return _private_folder()


def _private_folder() -> Path | None:
    """Return the user's folder in the temporary folder; None if other users have access to it."""
    user = os.getuid() if hasattr(os, "getuid") else "cache"
    try:
        folder = Path(tempfile.gettempdir()) / f"clmorph-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    if not stat.S_ISDIR(found.st_mode):
        return None
    # On Windows the temporary folder itself belongs to the user.
    if hasattr(os, "getuid") and (found.st_uid != user or found.st_mode & 0o077):
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def read_cached(name: str) -> bytes:
    """Return the content of a file in the cache, such as "kernels/rows.bin"; empty if missing."""
    folder = cache_folder()
    try:
        return (folder / name).read_bytes() if folder else b""
    except OSError:
        return b""


def write_cached(name: str, content: bytes) -> None:
    """Write a file to the cache, if that is possible; see `read_cached`."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        with staging_folder(place.parent) as staging:
            new = staging / "new"
            new.write_bytes(content)
            new.replace(place)


def forget_cached(name: str) -> None:
    """Remove a file, or all files of a folder, from the cache."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        place = folder / name
        for file in place.iterdir() if place.is_dir() else [place]:
            if not file.is_dir():  # another process writes there
                file.unlink(missing_ok=True)


def load_record(name: str) -> dict[str, Any]:
    """Read a JSON object, such as "devices/0123", from the cache; a damaged one is empty."""
    try:
        record = json.loads(read_cached(f"{name}.json"))
    except (ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def save_record(name: str, record: dict[str, Any]) -> None:
    """Write a JSON object to a file of its own in the cache, if possible; see `load_record`."""
    write_cached(f"{name}.json", json.dumps(record, indent=1, sort_keys=True).encode())
