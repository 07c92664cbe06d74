"""Write a morph, or a chain of morphs, as files that people open."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.files import (
    atomic_paths,
    check_apart,
    check_file_place,
    check_place,
    home_of,
    is_empty,
    told_as_output,
)
from clmorph._shared.printable import printable
from clmorph._shared.progress import Report
from clmorph._shared.validation import check_choice, check_flag, check_progress, is_path, shown
from clmorph.errors import InputError, OutputError
from clmorph.frames.sequence import FrameSequence
from clmorph.output.formats import animation, archive, gif, page, sheet, stills, video
from clmorph.output.framing import FrameStyle
from clmorph.output.playback import Motion
from clmorph.output.provenance import as_text
from clmorph.output.recording import Recording, StageProgress, recorded
from clmorph.pipeline import presets as defaults

#: Options that decide about sizes and colors, and about when frames are shown.
SIZES = ("canvas", "scaling", "background")
PACE = ("fps", "duration", "hold", "loop")


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes
    ----------
    endings : tuple of str
        The first is the usual one.
    write : callable
        Called with a recording, a style, a new path and what to report to.
    animated : bool
        Whether it lasts as long as its frames are shown.
    exact : bool
        Whether it holds floats.
    keep : bool
        Whether it tells of the morphs, not of their frames alone.
    check : callable
        Raises OutputError if something that it needs is missing.
    relevant_options : tuple of str
        Which options about looks and motion make a difference to it.
    fastest : float
        Frames a second that it can hold, at most; a GIF's briefer frames are taken for long ones
        by browsers.
    """

    endings: tuple[str, ...]
    write: Callable[[Recording, FrameStyle, Path, Report], None]
    animated: bool = False
    exact: bool = False
    keep: bool = False
    check: Callable[[], None] = lambda: None
    relevant_options: tuple[str, ...] = (*SIZES, *PACE)
    fastest: float = math.inf


#: Every kind of file by its name; those without an ending of their own need to be named.
FORMATS: dict[str, Format] = {
    "gif": Format((".gif",), gif.write, animated=True, fastest=50.0),
    "webp": Format(
        (".webp",),
        animation.write_webp,
        animated=True,
        relevant_options=(*SIZES, *PACE, "lossless"),
    ),
    "apng": Format((".apng",), animation.write_apng, animated=True),
    "mp4": Format((".mp4",), video.write_mp4, True, check=video.check_video),
    "webm": Format((".webm",), video.write_webm, True, check=video.check_video),
    "html": Format((".html", ".htm"), page.write, keep=True),
    "sheet": Format((".png",), sheet.write, relevant_options=SIZES),
    "npz": Format((".npz",), archive.write, exact=True, keep=True, relevant_options=()),
    "tiff": Format((".tif", ".tiff"), stills.write_tiff, relevant_options=SIZES),
    "png-folder": Format(("",), stills.write_png_folder, relevant_options=SIZES),
    "tiff-folder": Format((), stills.write_tiff_folder, relevant_options=SIZES),
}
#: Formats whose result is a folder.
FOLDERS = ("png-folder", "tiff-folder")


class Output:
    """A place for a file, checked before anything is worked out.

    Parameters
    ----------
    path : path
    format : str, optional
        A name of `FORMATS`, in place of what the ending says.

    Attributes
    ----------
    path : Path
    format : Format
    name : str
        The format's.

    Raises
    ------
    OutputError
        If the ending is unknown, nothing can be written there, or something is missing that
        the format needs.
    """

    def __init__(self, path: str | PathLike[str], format: str | None = None) -> None:
        if not is_path(path):
            raise OutputError(f"path={shown(path)}: expected a path such as 'out.gif'")
        self.path = Path(path)
        if format is not None:
            self.name = check_choice("format", format, tuple(FORMATS))
        else:
            self.name = _by_ending(self.path)
        self.format = FORMATS[self.name]
        self.format.check()
        is_folder = self.name in FOLDERS
        self.place = check_place(self.path) if is_folder else check_file_place(self.path)
        with told_as_output(path):
            empty = self.place.is_dir() and is_empty(self.place)
        if is_folder and self.place.exists() and not empty:
            raise OutputError(
                f"{path} exists already; choose a new or empty folder, or a name ending in "
                + ", ".join(_endings())
            )

    @property
    def folder(self) -> Path:
        """Where temporary files for it go: on its own disk."""
        return home_of(self.place)

    def check_motion(self, motion: Motion) -> None:
        """Raise InputError if frames follow one another faster than the file can hold."""
        if motion.fps > self.format.fastest * (1 + 1e-9):
            raise InputError(
                f"fps={motion.fps:.4g} is too fast for {self.path}: expected at most "
                f"{self.format.fastest:g}; lower it, or write .webp, .apng or a video"
            )


def write_all(
    outputs: Sequence[Output],
    recording: Recording,
    style: FrameStyle | None = None,
    report: Callable[[Output, float], None] | None = None,
    texts: Mapping[Path, str] | None = None,
) -> None:
    """Write a recording to one or several places: all of them whole, or none.

    Parameters
    ----------
    outputs : sequence of Output
    recording : Recording
        Recorded with the `exact` and `keep` of their formats.
    style : FrameStyle, optional
    report : callable, optional
        Called with an output and the share of it done.
    texts : mapping, optional
        What else is to be written, by place.

    Raises
    ------
    OutputError
        If one cannot be written.
    InputError
        If the recording cannot be shown that way, or two of them have one place.
    """
    beside = dict(texts or {})
    places = [*(output.place for output in outputs), *beside]
    check_apart(places)
    with atomic_paths(places) as made:
        for new, (place, text) in zip(made[len(outputs) :], beside.items(), strict=True):
            with told_as_output(place):
                new.write_text(text, "utf-8")
        for output, new in zip(outputs, made, strict=False):
            told = partial(report, output) if report else (lambda share: None)
            with told_as_output(output.path):
                output.format.write(recording, style or FrameStyle(), new, told)


def _endings() -> list[str]:
    return [ending for format in FORMATS.values() for ending in format.endings[:1] if ending]


def _by_ending(path: Path) -> str:
    ending = path.suffix.lower()
    for name, format in FORMATS.items():
        if ending in format.endings:
            return name
    raise OutputError(
        f"{path}: unknown ending {path.suffix!r}; expected {', '.join(_endings())}, or none for "
        "a folder of PNG frames"
    )


def save(
    morphs: FrameSequence | Sequence[FrameSequence],
    path: str | PathLike[str],
    *,
    format: str | None = None,
    fps: float = defaults.FPS,
    hold: float = defaults.HOLD,
    loop: str = "loop",
    reverse: bool = False,
    canvas: Any = "dynamic",
    scaling: str = "auto",
    background: str | None = None,
    lossless: bool = False,
    parameters: Mapping[str, Any] | None = None,
    progress: StageProgress | None = None,
) -> None:
    """Write a morph, or a chain of morphs, to a file chosen by its ending.

    Parameters
    ----------
    morphs : Morph or sequence of Morph
        Of a chain, each begins with the picture that the one before ends with.
    path : path
        ``.gif``, ``.webp``, ``.apng`` (animated PNG), ``.mp4``, ``.webm``, ``.html`` (a page to
        play with), ``.png`` (a contact sheet), ``.npz`` (see `clmorph.load`), ``.tif`` (one
        page a frame), or no ending (a new folder of PNG frames). What is there is replaced.
    format : str, optional
        A name of `FORMATS`, in place of the ending.
    fps, hold, loop
        See `clmorph.output.playback.Motion`.
    reverse : bool
        From the end to the beginning.
    canvas, scaling, background, lossless
        See `clmorph.output.framing.FrameStyle`.
    parameters : mapping, optional
        What the file is to tell of its making, in place of the morphs' own parameters; JSON
        must take it.
    progress : callable, optional
        Called with a stage's name and the share of it done.

    Raises
    ------
    InputError
        If an option cannot be used.
    OutputError
        If it cannot be written there.
    """
    chain = _as_chain(morphs)
    output = Output(path, format)
    style, motion = FrameStyle(canvas, scaling, background, lossless), Motion(fps, hold, loop)
    output.check_motion(motion)
    reverse = check_flag("reverse", reverse)
    report = check_progress(progress)
    for one, other in itertools.pairwise(chain):
        if not np.array_equal(one.target.colors, other.source.colors):
            raise InputError(
                "morphs: expected each to begin with the picture that the one before ends with"
            )
    if parameters is not None and not isinstance(parameters, Mapping):
        raise InputError(f"parameters={shown(parameters)}: expected a mapping that JSON takes")
    told = parameters if parameters is not None else described(chain)
    try:
        as_text(told)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"parameters: expected what JSON takes ({printable(str(error), 120)})"
        ) from None
    with recorded(
        chain, motion, n_morphs=len(chain), reverse=reverse,
        exact=output.format.exact, keep=output.format.keep,
        pixelated=all(morph.pixelated for morph in chain), parameters=told,
        folder=output.folder, progress=progress,
    ) as recording:  # fmt: skip
        write_all([output], recording, style, lambda place, share: report(f"write {path}", share))


def _as_chain(
    morphs: FrameSequence | Sequence[FrameSequence],
) -> Sequence[FrameSequence]:
    """Return one morph or several as a sequence of morphs."""
    if isinstance(morphs, FrameSequence):
        return [morphs]
    if isinstance(morphs, list | tuple) and len(morphs) > 0:
        chain = [morph for morph in morphs if isinstance(morph, FrameSequence)]
        if len(chain) == len(morphs):
            return chain
    raise InputError("morphs: expected a Morph, or a sequence of at least one")


def described(morphs: Sequence[FrameSequence]) -> dict[str, Any]:
    """Return what a file tells of the morphs in it."""
    from clmorph._shared.version import __version__

    return {"clmorph": __version__, "morphs": [dict(morph.parameters) for morph in morphs]}
