"""The parts of a file format: its names, its writer, its reader and its limits."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clmorph._shared.progress import Report
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

#: Options that decide about sizes and colors, and about when frames are shown.
SIZES = ("canvas", "scaling", "background")
PACE = ("fps", "duration", "hold", "loop")


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of files: how it is recognized, written and read.

    Attributes
    ----------
    name : str
        The value of the option `format` that selects this format.
    endings : tuple of str
        Endings of file names. The first is the usual one, and an empty one stands for a folder. A
        format without endings is chosen by its name alone.
    write : callable
        Called with a recording, a frame style, a new path and a function that reports the share
        done.
    read_metadata : callable
        Called with a path; returns the text of the metadata in a file of this format, empty if
        there is none.
    signatures : tuple of (offset, bytes)
        A file has this format if these bytes stand at one of these offsets.
    animated : bool
        Whether a file is an animation, whose frames have durations.
    folder : bool
        Whether the result is a folder of files, each of which has the signature.
    exact : bool
        Whether frames are stored as floats.
    keep : bool
        Whether the writer needs the morphs in addition to their frames.
    check : callable
        Raises OutputError if a library that the format needs is missing.
    relevant_options : tuple of str
        The options of frame style and playback that the format uses.
    fastest : float
        The highest frame rate, in frames per second. Browsers slow down a higher one to 10.
    """

    name: str
    endings: tuple[str, ...]
    write: Callable[[Recording, FrameStyle, Path, Report], None]
    read_metadata: Callable[[Path], str]
    signatures: tuple[tuple[int, bytes], ...]
    animated: bool = False
    folder: bool = False
    exact: bool = False
    keep: bool = False
    check: Callable[[], None] = lambda: None
    relevant_options: tuple[str, ...] = (*SIZES, *PACE)
    fastest: float = math.inf

    def matches(self, start: bytes) -> bool:
        """Return whether a file that starts with these bytes has this format.

        A text format may start with white space and is matched without regard to case.
        """
        text = start.lstrip().lower()
        return any(
            start.startswith(mark, offset) or text.startswith(mark, offset)
            for offset, mark in self.signatures
        )
