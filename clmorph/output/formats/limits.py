"""Limits of formats, and failures of encoders, as errors of clmorph."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager

from clmorph._shared.printable import reason_of
from clmorph.errors import ClmorphError, InputError, OutputError


def check_sides(size: tuple[int, int], most: int, words: str) -> None:
    """Raise InputError if a side (pixels) is longer than `most`; `words` is the format's name."""
    if max(size) > most:
        raise InputError(
            f"pictures of {size[0]} x {size[1]} pixels are too large for {words}, whose sides have "
            f"at most {most}: set a smaller canvas, or write .apng, .tif or a folder"
        )


@contextmanager
def encoding(words: str, *kinds: type[Exception]) -> Iterator[None]:
    """Raise OutputError for an encoder's errors, but let those of clmorph and of the disk pass."""
    failures: tuple[type[Exception], ...] = (
        RuntimeError,
        ValueError,
        OverflowError,
        struct.error,
        *kinds,
    )
    try:
        yield
    except (ClmorphError, OSError):
        raise
    except failures as error:
        raise OutputError(
            f"the encoder of {words} failed ({reason_of(error)}): try another canvas, or "
            "another format"
        ) from error
