"""Paths of inputs and outputs: local ones, and every other one that fsspec opens."""

import os
import tempfile
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any
from uuid import uuid4

from clmorph._shared.printable import reason_of
from clmorph.errors import FileError, OutputError

#: The names of the index and of the journal in a folder of outputs.
INDEX, JOURNAL = "index.html", "clmorph-batch.jsonl"


def is_remote(place: str) -> bool:
    """Return whether a path names a file system, as ``s3://bucket/a.png`` does."""
    return "://" in place and not place.startswith("file://")


def resolved(place: str, folder: str = "") -> str:
    """Return a path that means the same in every process, relative to `folder` if it is given."""
    if is_remote(place):
        return place
    place = place.removeprefix("file://")
    if is_remote(folder) and not Path(place).is_absolute():
        return f"{folder.rstrip('/')}/{place}"
    # Links stay: a link's own name is that of the output.
    return os.path.abspath(Path(folder, place))  # noqa: PTH100


def file_identity(place: str) -> Hashable:
    """Return what two names of one file have in common."""
    if is_remote(place):
        return place
    try:
        known = Path(place).stat()
    except OSError:
        return str(Path(place).resolve())
    return known.st_dev, known.st_ino


def name_of(place: str) -> str:
    """Return the name of a file, without its folder."""
    return PurePosixPath(place).name if is_remote(place) else Path(place).name


def stamp(place: str) -> str:
    """Return a text of a file's size and time, which changes with it; "missing" if none is."""
    try:
        if not is_remote(place):
            known = Path(place).stat()
            return f"{known.st_size} {known.st_mtime_ns}"
        system, path = _system(place)
        info = system.info(path)
        keys = ("size", "mtime", "created", "LastModified", "ETag", "etag", "updated")
        return " ".join(str(info[key]) for key in keys if key in info)
    except Exception:  # file systems raise exceptions of any class
        return "missing"


def exists(place: str) -> bool:
    """Return whether there is such a file or folder."""
    return stamp(place) != "missing"


@contextmanager
def local_copy(place: str) -> Iterator[Path]:
    """Yield the path of a file on this machine; a remote one is copied for the block."""
    if not is_remote(place):
        yield Path(place)
        return
    with tempfile.TemporaryDirectory(prefix="clmorph-") as folder:
        copy = Path(folder, name_of(place))
        try:
            system, path = _system(place)
            system.get_file(path, str(copy))
        except Exception as error:
            raise FileError(f"{place}: cannot be read ({reason_of(error)})") from None
        yield copy


@contextmanager
def local_output(place: str) -> Iterator[Path]:
    """Yield the path to which an output is written; a remote output is sent when it is whole."""
    if not is_remote(place):
        try:
            Path(place).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{place}: its folder cannot be made ({reason_of(error)})") from None
        yield Path(place)
        return
    with tempfile.TemporaryDirectory(prefix="clmorph-") as folder:
        new = Path(folder, name_of(place))
        yield new
        if new.is_dir():
            raise OutputError(f"{place}: a folder of frames is written on this machine alone")
        try:
            system, path = _system(place)
            parent, _, name = path.rpartition("/")
            system.makedirs(parent, exist_ok=True)
            # A reader never meets half a file.
            part = f"{parent}/.clmorph-{uuid4().hex[:8]}-{name}"
            system.put_file(str(new), part)
            system.mv(part, path)
        except Exception as error:
            raise OutputError(f"{place}: cannot be written ({reason_of(error)})") from None


def read_bytes(place: str, missing: bytes | None = None) -> bytes:
    """Return the content of a file, or `missing` if there is none, or raise FileError."""
    try:
        if not is_remote(place):
            return Path(place).read_bytes()
        system, path = _system(place)
        return system.cat_file(path)
    except Exception as error:  # file systems raise exceptions of any class
        if missing is not None and isinstance(error, FileNotFoundError):
            return missing
        raise FileError(f"{place}: cannot be read ({reason_of(error)})") from None


def _system(place: str) -> tuple[Any, str]:
    import fsspec

    system, path = fsspec.core.url_to_fs(place)
    return system, str(path)
