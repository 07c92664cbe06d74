"""Common steps of several commands: reading pictures, notes, and opening a device."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from clmorph._shared.validation import check_max_pixels
from clmorph.cli.terminal import NOTES, note, say
from clmorph.errors import ImageWarning, InputError

#: A handler that keeps Python from printing log records without another handler.
SILENT = logging.NullHandler()


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
    from clmorph.cli.options import in_option_names

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
    if device is not None and backend not in (None, "auto", "opencl"):
        raise InputError(f"--device {device} and --backend {backend} contradict: give one of them")
    return device or backend or "auto"


def open_backend(device: str | None, backend: str | None) -> Any:
    """Choose the device and print its name."""
    name = device_name(device, backend)
    from clmorph.backends.multi_device import sharing_notes
    from clmorph.backends.select import get_backend

    with NOTES.status("looking for OpenCL devices (the first time takes some seconds)"):
        operations = get_backend(name)
    say(f"device: {operations.description}")
    for each in sharing_notes(operations):
        note(each)
    return operations
