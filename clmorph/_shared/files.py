"""Files appear whole or not at all, and never in the place of what is read."""

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from os import PathLike
from pathlib import Path

from clmorph._shared.printable import printable, reason_of
from clmorph._shared.signals import note_written, undisturbed
from clmorph._shared.staging import PREFIX, is_staging, staging_folder
from clmorph.errors import InputError, OutputError

#: Characters of an ending that a temporary file has too; longer ones are none of ours.
LONGEST_ENDING = 16
#: Files from which on all that waits for the disk is written at once.
MANY = 16
#: What file systems say that cannot flush one file.
NO_FLUSH = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EROFS)


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
        If it is no path, its folder is missing or cannot be written, it is write-protected, or
        it is neither a file nor a folder (a device, say, or a pipe).
    """
    if not isinstance(target, str | PathLike) or not str(target):
        raise OutputError(f"{target!r} is not a path; expected one such as 'out.gif'")
    try:
        # A link stays a link: what it points to is replaced, as by any other writer.
        place = Path(target).resolve()
        special = place.exists() and not (place.is_file() or place.is_dir())
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputError(f"{target}: there is no such place ({reason_of(error)})") from None
    if special:
        raise OutputError(f"{target} is neither a file nor a folder; choose another place")
    if not place.parent.is_dir():
        raise OutputError(f"{target}: there is no folder {place.parent}; make it first")
    if place.is_file() and not os.access(place, os.W_OK):
        raise OutputError(f"{target} is write-protected; choose another place")
    with errors_as_output(target):
        # Some folders only seem to be writable.
        with tempfile.TemporaryFile(dir=home_of(place)):
            pass
        # In the temporary folder, the path is longer.
        with suppress(FileNotFoundError):
            (home_of(place) / f"{PREFIX}{8 * '0'}" / _new_name(place)).lstat()
    return place


def check_file_place(target: str | PathLike[str]) -> Path:
    """Return where a file can be written, as `check_place` does; a folder is refused too."""
    place = check_place(target)
    if place.is_dir():
        raise OutputError(f"{target} is a folder; choose a file name")
    return place


def home_of(place: Path) -> Path:
    """Return the folder in which files for a place are made.

    Parameters
    ----------
    place : Path
        Of a file, or of a folder that is new or empty.

    Returns
    -------
    Path
        On the same file system; a folder that is there may be a disk of its own.
    """
    return place if place.is_dir() else place.parent


def is_empty(folder: Path) -> bool:
    """Whether nothing is in a folder but temporary folders of ours."""
    return all(is_staging(path) for path in folder.iterdir())


def check_apart(
    written: Sequence[str | PathLike[str]], read: Sequence[str | PathLike[str]] = ()
) -> None:
    """Check that nothing that is to be written replaces what is read, or one another.

    Links are followed, other names of one file (hard links, capitals where the file system does
    not tell them apart) are recognized.

    Parameters
    ----------
    written : sequence of paths
        All files and folders that a command will write; they need not be there.
    read : sequence of paths
        All that it reads: pictures, settings.

    Raises
    ------
    InputError
        If one would be replaced by, or lie in a folder that is replaced by, another.
    """
    outputs = [(Path(path), _resolved(path)) for path in written]
    for number, (name, place) in enumerate(outputs):
        for source in map(_resolved, read):
            if _same(place, source) or place in source.parents:
                raise InputError(
                    f"{name} would overwrite an input, {printable(source.name)}; choose another "
                    "name for the output"
                )
        for other, there in outputs[:number]:
            if place == there or (_same_names(place, there)):
                raise InputError(
                    f"two outputs have one name, {other} and {name}; choose different ones"
                )
            if place in there.parents or there in place.parents:
                raise InputError(
                    f"one of the outputs {other} and {name} lies in the other; choose another name"
                )


def _resolved(path: str | PathLike[str]) -> Path:
    try:
        return Path(path).resolve()
    except (OSError, RuntimeError, ValueError):  # who opens it says why
        return Path(path).absolute()


def _same(place: Path, other: Path) -> bool:
    """Whether two places are one."""
    if place == other:
        return True
    with suppress(OSError, ValueError):
        return place.samefile(other)
    return _same_names(place, other)


def _same_names(place: Path, other: Path) -> bool:
    """Whether two places, at least one of which is not there, would be one."""
    if place.name.casefold() != other.name.casefold():
        return False
    with suppress(OSError, ValueError):
        if place.parent.samefile(other.parent):
            return place.name == other.name or ignores_case(place.parent)
    return False


def ignores_case(folder: Path) -> bool:
    """Whether capitals make no difference to the names of files, judged by a folder's own name."""
    for part in (folder, *folder.parents):
        swapped = part.name.swapcase()
        if swapped != part.name:
            with suppress(OSError, ValueError):
                return part.with_name(swapped).samefile(part)
            return False
    return os.name == "nt"


@contextmanager
def errors_as_output(target: str | PathLike[str]) -> Iterator[None]:
    """Tell an OSError of the block as OutputError, in one line that names the target."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written ({reason_of(error)}); choose another place"
        ) from error


@contextmanager
def atomic_path(target: str | PathLike[str]) -> Iterator[Path]:
    """Give a path to write to; what is written there then takes the target's place at once.

    See `atomic_paths`.

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
        If it cannot be written; so every OSError of the block becomes one.
    """
    with atomic_paths([target]) as (made,), errors_as_output(target):
        yield made


@contextmanager
def atomic_paths(targets: Sequence[str | PathLike[str]]) -> Iterator[list[Path]]:
    """Give paths to write to; what is written there then takes the targets' places together.

    Each stands in a temporary folder on the target's disk, has its ending and does not exist yet.
    If the block raises anything, KeyboardInterrupt included, or one of them cannot take its
    place, all targets are as they were; in any case nothing is left beside them. What is written
    is on the disk before it replaces anything. Permissions and, where that is allowed, the owner
    of a file that is replaced are kept.

    Parameters
    ----------
    targets : sequence of paths
        Of files, or of folders that are new or empty; each another.

    Yields
    ------
    list of Path
        Where the block must leave files or folders; other files may lie beside them meanwhile.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    places = [check_place(target) for target in targets]
    with ExitStack() as stack:
        made = []
        for target, place in zip(targets, places, strict=True):
            with errors_as_output(target):
                folder = stack.enter_context(staging_folder(home_of(place)))
                made.append(folder / _new_name(place))
        yield list(made)
        for target, place, new in zip(targets, places, made, strict=True):
            with errors_as_output(target):
                _keep_rights(place, new)
                _flush(new)
        with undisturbed(), ExitStack() as undo:
            for target, place, new in zip(targets, places, made, strict=True):
                with errors_as_output(target):
                    _put(new, place, undo)
            undo.pop_all()
            note_written()
        for home in {place.parent for place in places}:
            _flush_folder(home)


def _new_name(place: Path) -> str:
    """Return a temporary file's name; a long one's own may be as long as names can be."""
    return f"new{place.suffix}" if len(place.suffix) <= LONGEST_ENDING else "new"


def _put(new: Path, place: Path, undo: ExitStack) -> None:
    """Move what was made to its place, and note how to take it back."""
    if new.is_dir() and place.is_dir():
        _fill(place, new, undo)
    elif new.is_file() and place.is_file():
        old = new.with_name("old")
        with suppress(OSError):  # where there are no links, there is no way back
            os.link(place, old)
        new.replace(place)
        if old.exists():
            undo.callback(_try, old.replace, place)
    else:
        new.replace(place)
        undo.callback(_try, shutil.rmtree if place.is_dir() else Path.unlink, place)


def _fill(place: Path, made: Path, undo: ExitStack) -> None:
    """Move files into a folder that is empty: it stays the folder that people stand in."""
    if not is_empty(place):
        raise OSError(errno.ENOTEMPTY, os.strerror(errno.ENOTEMPTY))
    for file in sorted(made.iterdir()):
        there = place / file.name
        there.touch(exist_ok=False)  # of two runs, the second fails here
        undo.callback(_try, there.unlink)
        file.replace(there)
    _flush_folder(place)


def _try(step: Callable[..., object], *arguments: object) -> None:
    """Take a step back; what cannot be must not hide why."""
    with suppress(OSError):
        step(*arguments)


def _keep_rights(place: Path, new: Path) -> None:
    """Give a file the permissions, and if possible the owner, of the one that it replaces."""
    if not (place.is_file() and new.is_file()):
        return
    old, mine = place.stat(), new.stat()
    if hasattr(os, "chown") and (old.st_uid, old.st_gid) != (mine.st_uid, mine.st_gid):
        with suppress(OSError):
            os.chown(new, old.st_uid, old.st_gid)
    new.chmod(stat.S_IMODE(old.st_mode) & 0o777)


def _flush(made: Path) -> None:
    """Bring a file, or all files of a folder, onto the disk."""
    files = [path for path in made.rglob("*") if path.is_file()] if made.is_dir() else [made]
    if len(files) >= MANY and hasattr(os, "sync"):
        # One by one, each file waits for the disk: hundreds of frames for seconds. All at once
        # they do not; fsync, which alone tells of failures, then finds little left to write.
        os.sync()
    for file in files:
        with file.open("r+b") as stream:
            try:
                os.fsync(stream.fileno())
            except OSError as error:
                if error.errno not in NO_FLUSH:
                    raise
    if made.is_dir():
        _flush_folder(made)


def _flush_folder(folder: Path) -> None:
    """Bring a folder's entries onto the disk, where the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
