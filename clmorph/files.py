"""Files appear whole or not at all."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from clmorph.errors import OutputError


def check_place(target: str | PathLike[str]) -> Path:
    """Return where a result can be written, before the work for it begins.

    Parameters
    ----------
    target : path
        Of a file or a folder, there already or not.

    Returns
    -------
    Path
        The same place; behind a symbolic link, what it points to.

    Raises
    ------
    OutputError
        If it is no path, its folder is missing or cannot be written, or it is neither a file
        nor a folder (a device, say, or a pipe).
    """
    if not isinstance(target, str | PathLike) or not str(target):
        raise OutputError(f"{target!r} is not a path; expected one such as 'out.gif'")
    try:
        # A link stays a link: what it points to is replaced, as by any other writer.
        place = Path(target).resolve()
        special = place.exists() and not (place.is_file() or place.is_dir())
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputError(f"{target}: there is no such place ({_reason(error)})") from None
    if special:
        raise OutputError(f"{target} is neither a file nor a folder; choose another place")
    if not place.parent.is_dir():
        raise OutputError(f"{target}: there is no folder {place.parent}; make it first")
    try:
        # Some folders only seem to be writable.
        with tempfile.TemporaryFile(dir=place.parent):
            pass
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written ({_reason(error)}); choose another place"
        ) from None
    return place


@contextmanager
def atomic_path(target: str | PathLike[str]) -> Iterator[Path]:
    """Give a path to write to; what is written there then takes the target's place at once.

    It stands beside the target (the same disk), has the same ending and does not exist yet. If
    the block raises anything, KeyboardInterrupt included, the target stays as it was; in either
    case nothing is left beside it.

    Parameters
    ----------
    target : path
        Of a file, or of a folder that is new or empty.

    Yields
    ------
    Path
        Where the block must leave a file or a folder; other files may lie beside it meanwhile.

    Raises
    ------
    OutputError
        If it cannot be written; so every OSError of the block is told.
    """
    place = check_place(target)
    folder = None
    try:
        # In a folder of its own: a temporary file would be for its owner's eyes only.
        folder = Path(tempfile.mkdtemp(dir=place.parent, prefix=".clmorph-"))
        made = folder / f"new{place.suffix}"
        yield made
        if made.is_dir() and place.is_dir():
            _fill(place, made)
            return
        if place.is_file():
            shutil.copymode(place, made)
        made.replace(place)
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written ({_reason(error)}); choose another place"
        ) from error
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _fill(place: Path, made: Path) -> None:
    """Move files into a folder that is empty: it stays the folder that people stand in."""
    if any(place.iterdir()):
        raise OSError(errno.ENOTEMPTY, os.strerror(errno.ENOTEMPTY))
    moved = []
    try:
        for file in sorted(made.iterdir()):
            moved.append(file.replace(place / file.name))
    except BaseException:
        for file in moved:
            file.unlink(missing_ok=True)
        raise


def _reason(error: Exception) -> str:
    """Return what an error says, in one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split())
