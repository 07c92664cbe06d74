"""The parts of a file format: names, writer, reader and limits; failures of encoders as errors."""

import math
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from clmorph._shared.printable import reason_of
from clmorph._shared.progress import Report
from clmorph.errors import ClmorphError, InputError, OutputError
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

#: Options that decide about sizes and colors, and about when frames are shown.
SIZES = ("canvas", "scaling", "background")
PACE = ("fps", "duration", "hold", "loop")


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of files: how it is recognized, written and read."""

    #: The value of the option `format` that selects this format.
    name: str
    #: The first ending is the usual one; an empty one stands for a folder. A format without endings
    #: is chosen by its name alone.
    endings: tuple[str, ...]
    #: Writes a recording in a frame style to a new path, and reports the share done.
    write: Callable[[Recording, FrameStyle, Path, Report], None]
    #: Returns the text of the metadata in a file of this format, empty if there is none.
    read_metadata: Callable[[Path], str]
    #: A file has this format if these bytes stand at one of these offsets.
    signatures: tuple[tuple[int, bytes], ...]
    #: Whether a file is an animation, whose frames have durations.
    animated: bool = False
    #: Whether the result is a folder of files, each of which has the signature.
    folder: bool = False
    #: Whether frames are stored as floats.
    exact: bool = False
    #: Whether the writer needs the morphs in addition to their frames.
    keep: bool = False
    #: Raises OutputError if a library that the format needs is missing.
    check: Callable[[], None] = lambda: None
    #: The options of frame style and playback that the format uses.
    relevant_options: tuple[str, ...] = (*SIZES, *PACE)
    #: The highest frame rate, in frames per second. Browsers slow down a higher one to 10.
    fastest: float = math.inf

    def matches(self, start: bytes) -> bool:
        """Return whether a file that starts with these bytes has this format; text in any case."""
        starts = start, start.lstrip().lower()
        return any(each.startswith(mark, at) for each in starts for at, mark in self.signatures)


def check_sides(size: tuple[int, int], most: int, words: str) -> None:
    """Raise InputError if a side (pixels) is longer than `most`; `words` is the format's name."""
    if max(size) > most:
        raise InputError(
            f"pictures of {size[0]} x {size[1]} pixels are too large for {words}, whose sides have "
            f"at most {most}: set a smaller canvas, or write .apng, .tif or a folder"
        )


@contextmanager
def encoding(words: str, own: type[Exception] = RuntimeError) -> Iterator[None]:
    """Raise OutputError for an encoder's errors, but let those of clmorph and of the disk pass."""
    try:
        yield
    except (ClmorphError, OSError):
        raise
    except (RuntimeError, ValueError, OverflowError, struct.error, own) as error:
        raise OutputError(
            f"the encoder of {words} failed ({reason_of(error)}): try another canvas, or "
            "another format"
        ) from error
