"""Atomic output: files appear whole or not at all, and never replace an input of the same run.

Standard output is a target too: what was made whole in a temporary file is copied to it, so that
formats whose writers seek can be piped.
"""

import errno
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from os import PathLike
from pathlib import Path

from clmorph._shared.printable import printable, reason_of
from clmorph._shared.signals import note_partial, note_written, undisturbed
from clmorph._shared.staging import is_staging, own_prefix, staging_folder
from clmorph._shared.validation import is_path, shown
from clmorph.errors import InputError, OutputError

#: Longest ending, in characters, that a temporary file takes over from its target. clmorph writes
#: no format with a longer one.
LONGEST_ENDING = 16
#: From this number of files on, `os.sync` writes all pending data before the files are flushed.
MANY = 16
#: Error numbers of file systems that cannot flush a single file.
NO_FLUSH = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EROFS)
#: The name by which standard output is a target, on all systems, and its other names.
STANDARD_OUTPUT = Path("/dev/stdout")
_OTHER_NAMES = (Path("/dev/fd/1"), Path("/proc/self/fd/1"))
#: What is said of standard output without a format.
NO_ENDING = (
    "standard output has no ending, which would say the format: expected --format (format) with it"
)


def is_standard_output(target: str | PathLike[str]) -> bool:
    """Return whether a path is a name of standard output."""
    return Path(target) in (STANDARD_OUTPUT, *_OTHER_NAMES)


def check_place(target: str | PathLike[str]) -> Path:
    """Return the resolved path of a file or folder that can be written, or raise OutputError."""
    if not isinstance(target, str | PathLike) or not str(target):
        raise OutputError(f"{target!r} is not a path; expected one such as 'out.gif'")
    if str(target) == "-":
        raise OutputError(f"-: expected the name of a file, or {STANDARD_OUTPUT}")
    if is_standard_output(target):
        if sys.__stdout__ is None or sys.stdout is None:
            raise OutputError("standard output is closed: pipe it into a program, or name a file")
        if sys.stdout.isatty():
            raise OutputError(
                "standard output is a terminal, which shows no pictures: pipe it into a program, "
                "or name a file"
            )
        try:
            sys.stdout.fileno()
        except (AttributeError, OSError):
            raise OutputError("standard output takes text alone here; name a file") from None
        return STANDARD_OUTPUT
    try:
        # A link stays a link: its destination is replaced, as by any other program.
        place = Path(target).resolve()
        special = place.exists() and not (place.is_file() or place.is_dir())
    except (OSError, RuntimeError, ValueError) as error:
        raise OutputError(f"{target}: this place does not exist ({reason_of(error)})") from None
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
        # The path in the temporary folder is longer and may exceed the system's limit.
        with suppress(FileNotFoundError):
            (home_of(place) / f"{own_prefix()}{8 * '0'}" / _new_name(place)).lstat()
    return place


def check_file_place(target: str | PathLike[str]) -> Path:
    """Return the path at which a file can be written, as `check_place` does; refuse a folder."""
    place = check_place(target)
    if place != STANDARD_OUTPUT and place.is_dir():
        raise OutputError(f"{target} is a folder; choose a file name")
    return place


def check_named_place(
    path: object, endings: Collection[str], example: str, expected: str, ending: str | None = None
) -> Path:
    """Return the path at which a file with one of some endings (its own if None) can be written."""
    if not is_path(path):
        raise OutputError(f"path={shown(path)}: expected a path such as {example!r}")
    place = Path(str(path))
    ending = place.suffix.lower() if ending is None else ending
    if ending not in endings:
        name = printable(repr(ending), 40)
        raise OutputError(f"{path}: unknown ending {name}; expected {expected}")
    return check_file_place(place)


def home_of(place: Path) -> Path:
    """Return the folder of a target's temporary files, on its disk; a folder may be a mount."""
    if place == STANDARD_OUTPUT:
        return Path(tempfile.gettempdir())
    return place if place.is_dir() else place.parent


def is_empty(folder: Path) -> bool:
    """Return whether a folder holds nothing but temporary folders of clmorph."""
    return all(is_staging(path) for path in folder.iterdir())


def check_apart(
    written: Sequence[str | PathLike[str]], read: Sequence[str | PathLike[str]] = ()
) -> None:
    """Raise InputError if an output is an input or another output by any name, or holds one."""
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
    except (OSError, RuntimeError, ValueError):  # opening the file reports the reason
        return Path(path).absolute()


def _same(place: Path, other: Path) -> bool:
    """Return whether two paths name the same file or folder."""
    if place == other:
        return True
    with suppress(OSError, ValueError):
        return place.samefile(other)
    return _same_names(place, other)


def _same_names(place: Path, other: Path) -> bool:
    """Return whether two paths, at least one of which does not exist, would name one file."""
    if place.name.casefold() != other.name.casefold():
        return False
    with suppress(OSError, ValueError):
        if place.parent.samefile(other.parent):
            return place.name == other.name or ignores_case(place.parent)
    return False


def ignores_case(folder: Path) -> bool:
    """Return whether the file system ignores case, tested with the folder's own name."""
    for part in (folder, *folder.parents):
        swapped = part.name.swapcase()
        if swapped != part.name:
            with suppress(OSError, ValueError):
                return part.with_name(swapped).samefile(part)
            return False
    return os.name == "nt"


@contextmanager
def errors_as_output(target: str | PathLike[str]) -> Iterator[None]:
    """Convert an OSError of the block to an OutputError, one line that names the target."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written ({reason_of(error)}); choose another place"
        ) from error


@contextmanager
def atomic_path(target: str | PathLike[str]) -> Iterator[Path]:
    """Yield a path whose file replaces the target; an OSError becomes an OutputError."""
    with atomic_paths([target]) as (made,), errors_as_output(target):
        yield made


@contextmanager
def atomic_paths(targets: Sequence[str | PathLike[str]]) -> Iterator[list[Path]]:
    """Yield temporary paths, whose files replace all targets together, or none; nothing else stays.

    A target is a file, or a folder that is new or empty. What is for standard output is copied
    first: if its reader has gone, the others are replaced, and then BrokenPipeError is raised.
    """
    places = [check_place(target) for target in targets]
    with ExitStack() as stack:
        made = []
        for target, place in zip(targets, places, strict=True):
            with errors_as_output(target):
                folder = stack.enter_context(staging_folder(home_of(place)))
                made.append(folder / _new_name(place))
        yield list(made)
        ready = list(zip(targets, places, made, strict=True))
        files = [each for each in ready if each[1] != STANDARD_OUTPUT]
        piped = [new for _, place, new in ready if place == STANDARD_OUTPUT]
        for target, place, new in files:
            with errors_as_output(target):
                _keep_rights(place, new)
                _flush(new)
        unread = [new for new in piped if not _copied_out(new)]
        with undisturbed(), ExitStack() as undo:
            for target, place, new in files:
                with errors_as_output(target):
                    _put(new, place, undo)
            undo.pop_all()
            note_written()
        for home in {place.parent for _, place, _ in files}:
            _flush_folder(home)
        if unread:
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))


def write_together(
    writers: Sequence[tuple[Path, Path, Callable[[Path], None]]],
    texts: Mapping[Path, str] | None = None,
) -> None:
    """Write files (place, path as given, writer), and `texts` by path, all whole or none."""
    beside = dict(texts or {})
    places = [*(place for place, _, _ in writers), *beside]
    check_apart(places)
    with atomic_paths(places) as made:
        for new, (place, text) in zip(made[len(writers) :], beside.items(), strict=True):
            with errors_as_output(place):
                new.write_text(text, "utf-8")
        for new, (_, path, write) in zip(made, writers, strict=False):
            with errors_as_output(path):
                write(new)


def is_closed_pipe(error: OSError) -> bool:
    """Return whether an error says that nobody reads on; Windows calls that an invalid argument."""
    if sys.platform == "win32" and error.errno == errno.EINVAL and error.filename is None:
        return True
    return isinstance(error, BrokenPipeError)


def _copied_out(made: Path) -> bool:
    """Copy a file to standard output; return False if its reader has closed the pipe."""
    note_partial("a part was written to standard output")
    sys.stdout.flush()
    with errors_as_output("standard output"), made.open("rb") as file:
        try:
            # A stream of its own: bytes that cannot be written must not stay in that of `print`.
            with open(sys.stdout.fileno(), "wb", closefd=False) as stream:
                shutil.copyfileobj(file, stream)
        except OSError as error:
            if is_closed_pipe(error):
                return False
            raise
    note_partial("")
    return True


def _new_name(place: Path) -> str:
    """Return a short name for a temporary file, because the target's name may have full length."""
    return f"new{place.suffix}" if len(place.suffix) <= LONGEST_ENDING else "new"


def _put(new: Path, place: Path, undo: ExitStack) -> None:
    """Move a new file or folder to its target, and record how to undo the move."""
    if new.is_dir() and place.is_dir():
        _fill(place, new, undo)
    elif new.is_file() and place.is_file():
        old = new.with_name("old")
        with suppress(OSError):  # without hard links, the old file cannot be kept
            os.link(place, old)
        new.replace(place)
        if old.exists():
            undo.callback(_try, old.replace, place)
    else:
        new.replace(place)
        undo.callback(_try, shutil.rmtree if place.is_dir() else Path.unlink, place)


def _fill(place: Path, made: Path, undo: ExitStack) -> None:
    """Move files into an empty folder; the folder stays the same one for programs that use it."""
    if not is_empty(place):
        raise OSError(errno.ENOTEMPTY, os.strerror(errno.ENOTEMPTY))
    for file in sorted(made.iterdir()):
        there = place / file.name
        there.touch(exist_ok=False)  # if two runs write here, the second one fails
        undo.callback(_try, there.unlink)
        file.replace(there)
    _flush_folder(place)


def _try(step: Callable[..., object], *arguments: object) -> None:
    """Undo one step; a failure to undo must not hide the original error."""
    with suppress(OSError):
        step(*arguments)


def _keep_rights(place: Path, new: Path) -> None:
    """Copy the permissions and, if possible, the owner of a replaced file to the new file."""
    if not (place.is_file() and new.is_file()):
        return
    old, mine = place.stat(), new.stat()
    if hasattr(os, "chown") and (old.st_uid, old.st_gid) != (mine.st_uid, mine.st_gid):
        with suppress(OSError):
            os.chown(new, old.st_uid, old.st_gid)
    new.chmod(stat.S_IMODE(old.st_mode) & 0o777)


def _flush(made: Path) -> None:
    """Flush a file, or all files of a folder, to the disk."""
    files = [path for path in made.rglob("*") if path.is_file()] if made.is_dir() else [made]
    if len(files) >= MANY and hasattr(os, "sync"):
        # Files that are flushed one by one each wait for the disk, which takes seconds for
        # hundreds of frames. One sync of all files is faster. Only fsync reports failures, so it
        # follows and finds little left to write.
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
    """Flush a folder's entries to the disk, where the system supports it."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
