"""Write a morph, or a chain of morphs, as files that people open."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from clmorph import defaults
from clmorph.checks import check_choice
from clmorph.errors import InputError, OutputError
from clmorph.files import atomic_path, check_place
from clmorph.film import Film, StageProgress, recorded
from clmorph.formats import animation, archive, gif, page, sheet, stills, video
from clmorph.framing import Look
from clmorph.motion import Motion
from clmorph.progress import Report
from clmorph.result import Morph


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes
    ----------
    endings : tuple of str
        The first is the usual one.
    words : str
        What it is, for people.
    write : callable
        Called with a film, a look, a new path and what to report to.
    animated : bool
        Whether it lasts as long as its frames are shown.
    exact : bool
        Whether it holds floats.
    keep : bool
        Whether it tells of the morphs, not of their frames alone.
    check : callable
        Raises OutputError if something that it needs is missing.
    """

    endings: tuple[str, ...]
    words: str
    write: Callable[[Film, Look, Path, Report], None]
    animated: bool = False
    exact: bool = False
    keep: bool = False
    check: Callable[[], None] = lambda: None


#: Every kind of file by its name; those without an ending of their own need to be named.
FORMATS: dict[str, Format] = {
    "gif": Format((".gif",), "a looping GIF", gif.write, animated=True),
    "webp": Format((".webp",), "an animated WebP", animation.write_webp, animated=True),
    "apng": Format((".apng",), "an animated PNG", animation.write_apng, animated=True),
    "mp4": Format((".mp4",), "a video, H.264", video.write_mp4, True, check=video.check_video),
    "webm": Format((".webm",), "a video, VP9", video.write_webm, True, check=video.check_video),
    "html": Format((".html", ".htm"), "a page to play with", page.write, keep=True),
    "sheet": Format((".png",), "a contact sheet", sheet.write),
    "npz": Format(
        (".npz",), "NumPy arrays: frames, times, plan", archive.write, exact=True, keep=True
    ),
    "tiff": Format((".tif", ".tiff"), "a TIFF with a page for each frame", stills.write_tiff),
    "png-folder": Format(("",), "a folder of PNG frames", stills.write_png_folder),
    "tiff-folder": Format((), "a folder of TIFF frames", stills.write_tiff_folder),
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
        if not isinstance(path, str | PathLike) or not str(path):
            raise OutputError(f"{path!r} is not a path; expected one such as 'out.gif'")
        self.path = Path(path)
        if format is not None:
            self.name = check_choice("format", format, tuple(FORMATS))
        else:
            self.name = _by_ending(self.path)
        self.format = FORMATS[self.name]
        self.format.check()
        self.place = check_place(self.path)
        is_folder = self.name in FOLDERS
        if self.place.is_dir() and not is_folder:
            raise OutputError(f"{path} is a folder; choose a file name")
        empty = self.place.is_dir() and not any(self.place.iterdir())
        if is_folder and self.place.exists() and not empty:
            raise OutputError(
                f"{path} exists already; choose a new or empty folder, or a name ending in "
                + ", ".join(_endings())
            )

    def write(self, film: Film, look: Look | None = None, report: Report | None = None) -> None:
        """Write a film there: whole, or not at all.

        Parameters
        ----------
        film : Film
            Recorded with this format's `exact` and `keep`.
        look : Look, optional
        report : callable, optional
            Called with the share done.

        Raises
        ------
        OutputError
            If it cannot be written.
        InputError
            If the film cannot be shown that way.
        """
        with atomic_path(self.place) as new:
            self.format.write(film, look or Look(), new, report or (lambda share: None))


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
    morphs: Morph | Sequence[Morph],
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
        See `clmorph.motion.Motion`.
    reverse : bool
        From the end to the beginning.
    canvas, scaling, background, lossless
        See `clmorph.framing.Look`.
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
    chain = [morphs] if isinstance(morphs, Morph) else morphs
    a_chain = isinstance(chain, list | tuple) and len(chain) > 0
    if not a_chain or not all(isinstance(morph, Morph) for morph in chain):
        raise InputError("morphs: expected a Morph, or a sequence of at least one")
    output = Output(path, format)
    look, motion = Look(canvas, scaling, background, lossless), Motion(fps, hold, loop)
    report = progress or (lambda stage, share: None)
    told = parameters if parameters is not None else described(chain)
    with recorded(
        chain, motion, reverse=reverse, exact=output.format.exact, keep=output.format.keep,
        pixelated=all(morph.pixelated for morph in chain), parameters=told,
        folder=output.place.parent, progress=progress,
    ) as film:  # fmt: skip
        output.write(film, look, partial(report, output.name))


def described(morphs: Sequence[Morph]) -> dict[str, Any]:
    """Return what a file tells of the morphs in it."""
    from clmorph.release import __version__

    return {"clmorph": __version__, "morphs": [dict(morph.parameters) for morph in morphs]}
