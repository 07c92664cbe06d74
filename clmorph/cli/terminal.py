"""What commands share: notes, tables, progress and times, reading pictures, opening a device."""

import logging
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Self, cast

from rich import progress
from rich.console import Console
from rich.table import Table

from clmorph._shared.printable import MESSAGE, printable
from clmorph._shared.validation import check_max_pixels
from clmorph.cli.options import in_option_names
from clmorph.errors import ImageWarning, InputError
from clmorph.output.save import Output


class _StandardError:
    """The current `sys.stderr`; write errors, as of a log on a full disk, must not end a morph."""

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)

    def write(self, text: str) -> int:
        with suppress(OSError):
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            sys.stderr.flush()


#: A handler that keeps Python from printing log records without another handler.
SILENT = logging.NullHandler()
#: Console for progress, notes and errors; results go to standard output.
NOTES = Console(
    file=cast(IO[str], _StandardError()), highlight=False, soft_wrap=True, markup=False, emoji=False
)
#: Console for tables; it is 200 columns wide if the output is no terminal.
RESULTS = Console(
    highlight=False, width=None if sys.stdout.isatty() else 200, markup=False, emoji=False
)


def say(text: object) -> None:
    """Print a line on standard error; names in it may contain any characters."""
    NOTES.print(printable(text, MESSAGE))


def note(text: object) -> None:
    """Print a note on standard error."""
    say(f"note: {text}")


def print_table(
    titles: Iterable[str], rows: Iterable[Iterable[str]], right: Iterable[str] = ()
) -> None:
    """Print rows under the titles of their columns, of which those of `right` are set right."""
    table = Table(box=None, pad_edge=False)
    for title in titles:
        table.add_column(title, "", overflow="fold", justify="right" if title in right else "left")
    for row in rows:
        table.add_row(*(printable(cell, MESSAGE) for cell in row))
    RESULTS.print(table)


@contextmanager
def quiet_libraries() -> Iterator[list[warnings.WarningMessage]]:
    """Hide messages of Pillow about unusual metadata, and yield the warnings of clmorph itself.

    Such messages do not help the user, because clmorph itself checks pixels and recipes. Only the
    command line may use this function, because it changes the global state of the process.
    """
    log = logging.getLogger("PIL")
    log.addHandler(SILENT)
    try:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", ImageWarning)
            yield found
    finally:
        log.removeHandler(SILENT)


@contextmanager
def noted_libraries() -> Iterator[None]:
    """Hide what `quiet_libraries` hides, and print warnings of clmorph as notes."""
    with quiet_libraries() as found:
        yield
    for remark in found:
        note(remark.message)


@contextmanager
def noted_warnings() -> Iterator[list[Warning]]:
    """Print warnings as notes, and yield a list that has them."""
    notes: list[Warning] = []

    def show(message: Any, *others: Any, **more: Any) -> None:
        notes.append(message)
        note(in_option_names(str(message)))

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield notes


def read_picture(path: Path, max_pixels: int) -> Any:
    """Read an image as `clmorph.images.pixels.as_samples` has it; print its warnings as notes."""
    from clmorph.images.pixels import read_visible

    check_max_pixels(max_pixels)  # so that an error concerns the option, not the file
    with noted_libraries():
        return read_visible(path, max_pixels)


def device_name(device: str | None, backend: str | None) -> str:
    """Return the device that ``--device`` or ``--backend`` names; both may not differ."""
    others = ("auto",) if device == "numpy" else ("auto", "opencl")
    if device is not None and backend not in (None, *others):
        raise InputError(f"--device {device} and --backend {backend} contradict: give one of them")
    return device or backend or "auto"


def open_backend(name: str) -> Any:
    """Choose the device that is named and print its own name."""
    from clmorph.backends.multi_device import sharing_notes
    from clmorph.backends.select import get_backend

    with NOTES.status("looking for OpenCL devices (the first time takes some seconds)"):
        operations = get_backend(name)
    say(f"device: {operations.description}")
    for each in sharing_notes(operations):
        note(each)
    return operations


class Stages:
    """Progress bars, one for each stage; they are hidden if standard error is no terminal.

    A call with a stage's name and the share that is done opens, moves or closes the stage's bar.
    `seconds` has the time of each stage. What passes before a call counts for the stage that calls,
    so the times add up to the whole from `began`, by `time.perf_counter`.
    """

    def __init__(self, began: float | None = None) -> None:
        self._bars = progress.Progress(
            progress.TextColumn("{task.description:12}", markup=False),
            progress.BarColumn(),
            progress.TextColumn("{task.percentage:>3.0f} %"),
            progress.TimeElapsedColumn(),
            progress.TextColumn("left"),
            progress.TimeRemainingColumn(compact=True),
            progress.TextColumn("{task.fields[note]}", markup=False),
            console=NOTES,
            disable=not NOTES.is_terminal,
            transient=True,
        )
        self._tasks: dict[str, progress.TaskID] = {}
        self._counted_to = time.perf_counter() if began is None else began
        self.seconds: dict[str, float] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def marked(self, mark: str) -> Callable[[str, float], None]:
        """Return a progress function that appends a mark to the names of stages."""
        return lambda stage, share: self(stage + mark, share)

    def writing(self, output: Output, share: float) -> None:
        """Show the share of a file that is written."""
        self(f"write {output.path.name}", share)

    def __call__(self, stage: str, share: float) -> None:
        """Show the share (0 to 1) of a stage that is done, and the share's note, if any."""
        self.count(stage)
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(printable(stage), total=1.0, note="")
        note = getattr(share, "note", "")
        self._bars.update(self._tasks[stage], completed=share, note=note)

    def count(self, stage: str) -> None:
        """Count the time since the last call of any stage for this stage, which needs no bar."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._counted_to
        self._counted_to = now
