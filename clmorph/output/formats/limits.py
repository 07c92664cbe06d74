"""What files cannot hold, and encoders that fail, told as errors of ours."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager

from clmorph._shared.printable import reason_of
from clmorph.errors import ClmorphError, InputError, OutputError


def check_sides(size: tuple[int, int], most: int, words: str) -> None:
    """Raise InputError if pictures are larger than a file can hold.

    Parameters
    ----------
    size : (width, height)
        In pixels.
    most : int
        The longest side that the file can hold.
    words : str
        What the file is, for people.
    """
    if max(size) > most:
        raise InputError(
            f"pictures of {size[0]} x {size[1]} pixels are too large for {words}, whose sides have "
            f"at most {most}: set a smaller canvas, or write .apng, .tif or a folder"
        )


@contextmanager
def encoding(words: str, *kinds: type[Exception]) -> Iterator[None]:
    """Tell what an encoder raises as OutputError; errors of ours and of the disk pass.

    Parameters
    ----------
    words : str
        What is written, for people.
    kinds : exception classes
        Of the encoder's own, beside those that all of them use.
    """
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
