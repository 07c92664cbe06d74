"""Small files in the user's cache folder."""

import json
import os
import tempfile
from pathlib import Path
from typing import Any

import platformdirs


def cache_folder() -> Path:
    """Return the folder for files that can be made anew at any time."""
    return Path(platformdirs.user_cache_dir("clmorph", appauthor=False))


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a small file so that readers see the old or the new one, never a part."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def load_record(name: str) -> dict[str, Any]:
    """Read a JSON object from the cache; a missing or damaged file is an empty one."""
    try:
        record = json.loads((cache_folder() / name).read_text())
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def save_record(name: str, record: dict[str, Any]) -> None:
    """Write a JSON object into the cache; without a writable folder nothing is kept."""
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        write_atomically(cache_folder() / name, json.dumps(record, indent=1, sort_keys=True))
    except OSError:
        return
