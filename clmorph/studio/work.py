"""What the worker does for a tab: previews in steps, whole morphs, and files of them."""

import itertools
import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.progress import StageProgress
from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import Operations
from clmorph.backends.select import get_backend
from clmorph.errors import ClmorphError, ClmorphWarning, ConvergenceWarning, MemoryWarning
from clmorph.output.save import save
from clmorph.pipeline.budget import default_memory
from clmorph.pipeline.morph import morph
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import recognized
from clmorph.pipeline.presets import DRAFT_TOL
from clmorph.pipeline.recipe import picture_entries, recipe
from clmorph.pipeline.result import Morph
from clmorph.studio.choices import Choices
from clmorph.studio.tabs import Result, Shown, Tab

#: Size and number of frames of each step of a preview: first fast, then finer.
STEPS = ((40, 5), (96, 12))
#: Largest number of blocks and of particles of a preview.
BLOCKS, PARTICLES = 48, 40_000
#: Seconds between two reports of progress.
PACE = 0.1

#: How the command line says an error.
LineOf = Callable[[ClmorphError], str]


@dataclass(frozen=True)
class Ask:
    """What a tab wants to see."""

    tab: Tab
    pictures: tuple[Shown, ...]
    choices: Choices
    number: int

    def options(self) -> MorphOptions:
        """Return the options of the whole morph."""
        return self.choices.options(self.recognized())

    def recognized(self) -> str:
        """Return the preset that the pictures choose."""
        return recognized(picture.pixels for picture in self.pictures)


def guarded(work: Callable[[], None], failed: Callable[[str], None], line_of: LineOf) -> None:
    """Do some work; say an error in one line, as the command line does."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            work()
    except ClmorphError as error:
        failed(printable(line_of(error), MESSAGE))
    except MemoryError:
        failed("not enough memory; use a smaller --size")
    except Exception as error:  # a driver raises what it likes, and the studio goes on
        failed(printable(f"{type(error).__name__}: {reason_of(error)}", MESSAGE))


def preview(ask: Ask) -> None:
    """Show small morphs, each finer than the one before."""
    options = ask.options()
    operations = get_backend(ask.choices.device)
    for step, (size, frames) in enumerate(STEPS):
        small = _small(options, size, frames)
        chain = _chain(ask, small, operations, checking)
        name = f"preview-{ask.number}-{step}"
        path = ask.tab.folder / f"{name}.html"
        save(chain, path, parameters=_parameters(ask, small, operations), progress=checking)
        ask.tab.publish(
            "preview", number=ask.number, step=step, url=ask.tab.view(name, path),
            last=step == len(STEPS) - 1 or _is_whole(small, options),
        )  # fmt: skip
        if _is_whole(small, options):
            break


def _is_whole(small: MorphOptions, options: MorphOptions) -> bool:
    """Return whether a further step would show nothing more."""
    return small.size == options.size and small.n_frames == options.n_frames


def _small(options: MorphOptions, size: int, frames: int) -> MorphOptions:
    """Return the options of a preview, which plays as long as the whole morph."""
    pace = (options.fps or 20.0) * min(frames, options.n_frames) / options.n_frames
    return options.replace(
        size=_least(options.size, size), n_frames=min(options.n_frames, frames),
        fps=None if options.fps is None else max(pace, 0.1),
        solve_size=_least(options.solve_size, BLOCKS), tol=max(options.tol, DRAFT_TOL),
        max_particles=_least(options.max_particles, PARTICLES),
    )  # fmt: skip


def _least(value: int | None, most: int) -> int:
    return most if value is None else min(value, most)


def run(ask: Ask) -> None:
    """Compute the whole morph, and show it."""
    tab, began = ask.tab, time.perf_counter()
    options = ask.options()
    report = _Reports(tab, ask.number)
    report("preparation", 0.0)
    operations = get_backend(ask.choices.device)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ClmorphWarning)
        warnings.simplefilter("ignore", ConvergenceWarning)
        chain = _chain(ask, options, operations, report)
        if options.max_memory is None and any(
            isinstance(each.message, MemoryWarning) for each in found
        ):
            # As on the command line: the recipe holds the limit that reduced the particles.
            options = options.replace(max_memory=default_memory(operations))
    result = Result(ask.number, chain, options, _parameters(ask, options, operations), ask.choices)
    path = tab.folder / f"result-{ask.number}.html"
    write_file(result, path, report)
    tab.result = result
    worst = max(chain, key=lambda each: each.potentials.residual)
    tab.publish(
        "result", number=ask.number, url=tab.view(f"result-{ask.number}", path),
        seconds=round(time.perf_counter() - began, 2), message=worst.potentials.message,
        notes=[printable(str(each.message), MESSAGE) for each in found],
    )  # fmt: skip


def write_file(result: Result, path: Path, report: StageProgress) -> None:
    """Write a file of a finished run, by the same steps as ``clmorph morph``."""
    if path.suffix == ".json":
        path.write_text(json.dumps(result.parameters, indent=2) + "\n", "utf-8")
        return
    save(result.morphs, path, parameters=result.parameters, progress=report)


def _chain(
    ask: Ask, options: MorphOptions, operations: Operations, report: StageProgress
) -> list[Morph]:
    images = [picture.pixels for picture in ask.pictures]
    found = []
    for number, (one, other) in enumerate(itertools.pairwise(images)):
        mark = f" {number + 1}" if len(images) > 2 else ""

        def marked(stage: str, share: float, mark: str = mark) -> None:
            report(f"{stage}{mark}", share)

        found.append(morph(one, other, options, backend=operations, progress=marked))
    return found


def _parameters(ask: Ask, options: MorphOptions, operations: Operations) -> dict[str, Any]:
    entries = picture_entries([picture.path for picture in ask.pictures])
    return recipe(options, images=entries, device=operations.description)


def checking(stage: str, share: float) -> None:
    """Let the work stop if it was cancelled; a report of progress that says nothing."""
    check_cancelled()


class _Reports:
    """Progress for the page: stage, share, the solver's note, and the seconds that are left."""

    def __init__(self, tab: Tab, number: int) -> None:
        self._tab, self._number = tab, number
        self._stage, self._began, self._last = "", 0.0, 0.0

    def __call__(self, stage: str, share: float) -> None:
        check_cancelled()
        now = time.perf_counter()
        if stage.startswith("write "):
            stage = "writing"
        if stage != self._stage:
            self._stage, self._began, self._last = stage, now, 0.0
        if now - self._last < PACE and share < 1.0:
            return
        self._last = now
        left = (now - self._began) * (1 - share) / share if share > 0.02 else None
        self._tab.publish(
            "progress", number=self._number, stage=stage, share=float(share),
            note=getattr(share, "note", ""), left=None if left is None else round(left, 1),
        )  # fmt: skip
