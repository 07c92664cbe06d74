"""Write a morph, or a chain of morphs, as files that people open."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.files import (
    NO_ENDING,
    check_file_place,
    check_place,
    errors_as_output,
    home_of,
    is_empty,
    is_standard_output,
    write_together,
)
from clmorph._shared.options import Options, specifications, unknown_option
from clmorph._shared.progress import StageProgress
from clmorph._shared.validation import check_choice, check_progress, is_path, shown
from clmorph.errors import InputError, OutputError
from clmorph.frames.sequence import FrameSequence
from clmorph.output.formats.archive import write_solved
from clmorph.output.formats.format import PACE, SIZES
from clmorph.output.formats.registry import FORMATS, by_ending, usual_endings
from clmorph.output.formats.solved import SAVED as SAVED_RESULTS
from clmorph.output.metadata import checked_parameters
from clmorph.output.options import FrameStyle, PlaybackOptions
from clmorph.output.playback import Motion, motion_of
from clmorph.output.recording import Drawn, Recording, recorded
from clmorph.transport.divergence import Divergence
from clmorph.transport.matching import Assignment
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials

#: The options of `save`.
SAVED = ("fps", "duration", "hold", "loop", "reverse", *specifications(FrameStyle))

__all__ = ["FORMATS", "PACE", "SIZES", "Output", "metadata_of", "recorded_for", "save", "write_all"]


class Output:
    """The path and format of a file to be written, both checked; `format` overrides the ending."""

    def __init__(self, path: str | PathLike[str], format: str | None = None) -> None:
        if not is_path(path):
            raise OutputError(f"path={shown(path)}: expected a path such as 'out.gif'")
        self.path = Path(path)
        if format is not None:
            self.format = FORMATS[check_choice("format", format, tuple(FORMATS))]
        elif is_standard_output(self.path):
            raise OutputError(NO_ENDING)
        else:
            found = by_ending(self.path)
            if found is None:
                raise OutputError(
                    f"{path}: unknown ending {self.path.suffix!r}; expected "
                    f"{', '.join(usual_endings())}, or none for a folder of PNG frames"
                )
            named = f"film{self.path.name}"
            if by_ending(Path(named)) not in (None, found):  # ".gif" alone
                raise OutputError(f"{path}: a name is missing before the ending, as in {named}")
            self.format = found
        self.name = self.format.name
        if self.format.folder and is_standard_output(self.path):
            raise OutputError(
                f"format={self.name} is a folder, which standard output cannot hold; expected one "
                "of " + ", ".join(kind.name for kind in FORMATS.values() if not kind.folder)
            )
        self.format.check()
        is_folder = self.format.folder
        self.place = check_place(self.path) if is_folder else check_file_place(self.path)
        with errors_as_output(path):
            empty = self.place.is_dir() and is_empty(self.place)
        if is_folder and self.place.exists() and not empty:
            raise OutputError(
                f"{path} exists already; choose a new or empty folder, or a name ending in "
                + ", ".join(usual_endings())
            )

    @property
    def folder(self) -> Path:
        """The folder of its temporary files, which is on the same disk."""
        return home_of(self.place)

    def check_motion(self, motion: Motion) -> None:
        """Raise InputError if frames follow one another faster than the file can hold."""
        if motion.fps > self.format.fastest * (1 + 1e-9):
            others = ", ".join(
                kind.endings[0]
                for kind in FORMATS.values()
                if kind.animated and kind.fastest >= motion.fps
            )
            raise InputError(
                f"fps={motion.fps:.4g} is too fast for {self.path}: expected at most "
                f"{self.format.fastest:g}, because browsers show faster frames at 10 a second; "
                f"lower it, or write {others}"
            )


def recorded_for(
    outputs: Sequence[Output], morphs: Iterable[Drawn], motion: Motion, **more: Any
) -> AbstractContextManager[Recording]:
    """Return what `recorded` returns, with all that the formats of some files need."""
    return recorded(
        morphs, motion, exact=any(each.format.exact for each in outputs),
        keep=any(each.format.keep for each in outputs), folder=outputs[0].folder, **more,
    )  # fmt: skip


def write_all(
    outputs: Sequence[Output],
    recording: Recording,
    style: FrameStyle | None = None,
    report: Callable[[Output, float], None] | None = None,
    texts: Mapping[Path, str] | None = None,
) -> None:
    """Write a recording that was made for files, and `texts` by their paths: all whole, or none."""

    def write(output: Output, new: Path) -> None:
        report_share = partial(report, output) if report else (lambda share: None)
        output.format.write(recording, style or FrameStyle(), new, report_share)

    write_together([(each.place, each.path, partial(write, each)) for each in outputs], texts)


def save(
    morphs: FrameSequence | Sequence[FrameSequence] | Potentials | Plan | Divergence | Assignment,
    path: str | PathLike[str],
    *,
    format: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    progress: StageProgress | None = None,
    **given: Any,
) -> None:
    """Write a morph, a chain of morphs, or a result of the solver to a file chosen by its ending.

    Parameters
    ----------
    morphs : Morph or sequence of Morph
        One morph, or a chain in which each begins with the picture that the one before ends with.
        Or a Potentials, Plan, Divergence, PotentialsBatch or Assignment, for ``.npz`` without
        other options: `clmorph.load` reads it, and it holds no pickles.
    path : path
        ``.gif``, ``.webp``, ``.apng`` (animated PNG), ``.mp4``, ``.webm``, ``.html`` (a page to
        play with), ``.png`` (a contact sheet), ``.npz`` (see `clmorph.load`), ``.tif`` (one
        page a frame), or no ending (a new folder of PNG frames). An existing file is replaced.
        ``/dev/stdout`` is standard output, on all systems; it needs `format`.
    format : str, optional
        A name of `FORMATS`, in place of the ending.
    parameters : mapping, optional
        Metadata of the file in place of the recipe, as values that JSON can represent.
    progress : callable, optional
        Called with a stage's name and the share of it done.
    **given
        Options of `PlaybackOptions` (fps, duration, hold, loop, reverse) and of `FrameStyle`
        (canvas, scaling, background, lossless), in place of those that the first morph was made
        with.

    Raises
    ------
    InputError
        If an option cannot be used.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import clmorph
    >>> import numpy as np
    >>> images = np.zeros((3, 6, 6, 3))
    >>> images[0, :, :3] = images[1, :3] = images[2, :, 3:] = 1.0
    >>> chain = [
    ...     clmorph.morph(one, other, n_frames=4, backend="numpy")
    ...     for one, other in zip(images, images[1:])
    ... ]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     clmorph.save(chain, Path(folder) / "out.npz")
    ...     clmorph.load(Path(folder) / "out.npz")
    <Archive of 7 frames, 2 plans>
    """
    if isinstance(morphs, SAVED_RESULTS):
        output = Output(path, format)
        if output.name != "npz" or given:
            raise InputError(
                f"{path}: a result of the solver ({type(morphs).__name__}) is saved as .npz, "
                "without other options; choose a name that ends in .npz"
            )
        write_together([(output.place, output.path, partial(write_solved, morphs))])
        return
    chain = [morphs] if isinstance(morphs, FrameSequence) else morphs
    if (
        not isinstance(chain, list | tuple)
        or not chain
        or not all(isinstance(morph, FrameSequence) for morph in chain)
    ):
        raise InputError("morphs: expected a Morph, or a sequence of at least one")
    output = Output(path, format)
    for name in given:
        if name not in SAVED:
            raise InputError(unknown_option(name, dict.fromkeys(SAVED)))
    options = chain[0].options.replace(**given)
    steps = [len(morph) - 1 for morph in chain]
    holds = np.zeros(1 + sum(steps), bool)
    holds[[0, *np.cumsum(steps)]] = True  # the frames that are pictures themselves
    motion = motion_of(options, holds)
    output.check_motion(motion)
    report = check_progress(progress)
    for one, other in itertools.pairwise(chain):
        if not np.array_equal(one.target.colors, other.source.colors):
            raise InputError(
                "morphs: expected each to begin with the picture that the one before ends with"
            )
    metadata = checked_parameters(metadata_of(chain, options) if parameters is None else parameters)
    with recorded_for(
        [output], chain, motion, n_morphs=len(chain), reverse=options.reverse,
        pixelated=all(morph.pixelated for morph in chain), parameters=metadata, progress=progress,
    ) as recording:  # fmt: skip
        write_all([output], recording, options, lambda place, share: report(f"write {path}", share))


#: The option that belongs to the two pictures of a morph; a chain has a list of its values.
LANDMARKS = "landmarks"


def metadata_of(morphs: Sequence[FrameSequence], options: Options) -> dict[str, Any]:
    """Return the recipe of all morphs; `options` are the first one's, with those of `save`."""
    own = {*specifications(PlaybackOptions), *specifications(FrameStyle), LANDMARKS}
    each = [
        {name: value for name, value in morph.options.as_dict().items() if name not in own}
        for morph in morphs
    ]
    metadata = dict(morphs[0].parameters)
    if all(one == each[0] for one in each):
        marks = [getattr(morph.options, LANDMARKS, None) or () for morph in morphs]
        if len(morphs) > 1 and any(marks):
            options = options.replace(**{LANDMARKS: marks})
        return metadata | {"options": options.outside()}
    del metadata["options"]
    return metadata | {"morphs": [morph.options.outside() for morph in morphs]}
