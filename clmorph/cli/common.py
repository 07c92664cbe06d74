"""What several commands begin with: reading pictures, opening a device."""

import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from clmorph._shared.validation import check_max_pixels
from clmorph.cli.terminal import NOTES, note, say
from clmorph.errors import FileError, ImageWarning, InputError

#: Keeps Python from printing what is logged and nobody handles.
SILENT = logging.NullHandler()


@contextmanager
def quiet_libraries() -> Iterator[list[warnings.WarningMessage]]:
    """Hide what Pillow, tifffile and libtiff print about odd metadata.

    Such remarks do not help the user: pixels and recipes are checked by clmorph itself. Only the
    command line may use this, because it changes what all threads of the process share.

    Yields
    ------
    list of warnings.WarningMessage
        Warnings of clmorph itself, for the caller to print.
    """
    # Below Python, libtiff prints by itself.
    kept = os.dup(2) if sys.__stderr__ is not None else None
    logs = [logging.getLogger(name) for name in ("PIL", "tifffile")]
    for log in logs:
        log.addHandler(SILENT)
    try:
        if kept is not None:
            sys.stderr.flush()
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, 2)
            os.close(nothing)
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", ImageWarning)
            yield found
    finally:
        if kept is not None:
            os.dup2(kept, 2)
            os.close(kept)
        for log in logs:
            log.removeHandler(SILENT)


def read_picture(path: Path, max_pixels: int) -> Any:
    """Read an image and print what is to be noted.

    Parameters
    ----------
    path : Path
    max_pixels : int
        Larger ones are refused.

    Returns
    -------
    (H, W, 3) or (H, W, 4) array

    Raises
    ------
    FileError
        If it cannot be read, or there is nothing to see.
    """
    from clmorph.images.pixels import read_image

    check_max_pixels(max_pixels)  # a mistake in the option, not in the file
    with quiet_libraries() as found:
        try:
            pixels = read_image(path, max_pixels=max_pixels)
        except InputError as error:
            raise FileError(str(error)) from None
    for remark in found:
        note(remark.message)
    if pixels.shape[2] == 4 and not pixels[..., 3].any():
        raise FileError(f"{path}: every pixel is transparent; expected something to see")
    return pixels


def note_warning(notes: list[Warning], message: Any, *others: Any, **more: Any) -> None:
    """Print a warning as a note and keep it; the rest stands in for `warnings.showwarning`."""
    from clmorph.cli.options import in_option_names

    notes.append(message)
    note(in_option_names(str(message)))


def open_backend(device: str | None, backend: str | None) -> Any:
    """Choose the device and say which it is.

    Raises
    ------
    InputError
        If both are named and contradict.
    DeviceError
        If there is none.
    """
    if device is not None and backend not in (None, "auto", "opencl"):
        raise InputError(f"--device {device} and --backend {backend} contradict: give one of them")
    from clmorph.backends.select import get_backend

    with NOTES.status("looking for OpenCL devices (the first time takes some seconds)"):
        operations = get_backend(device or backend or "auto")
    say(f"device: {operations.description}")
    return operations
