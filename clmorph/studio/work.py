"""The work behind the page: previews in steps, whole results, files."""

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from clmorph._shared.files import atomic_path
from clmorph._shared.options import Options
from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.progress import StageProgress
from clmorph.backends.cancellation import check_cancelled
from clmorph.backends.interface import Operations
from clmorph.backends.select import get_backend
from clmorph.errors import ClmorphError, ClmorphWarning, ConvergenceWarning, MemoryWarning
from clmorph.output.picture import write_picture
from clmorph.pipeline.budget import default_memory
from clmorph.pipeline.guides import Guided, guides
from clmorph.pipeline.mixing.mixes import pairs_of
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import recognized
from clmorph.pipeline.recipe import picture_entries, recipe
from clmorph.studio.choices import LANDMARKS_FOUND, Choices, command_line, python_code
from clmorph.studio.making import MAKERS, Task, small_tasks
from clmorph.studio.tabs import Result, Shown, Tab

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
    painted: tuple[Path, ...] = ()

    def recognized(self) -> str:
        """Return the preset that the pictures choose."""
        if not self.choices.kind.presets:
            return ""
        return recognized(picture.pixels for picture in self.pictures)

    def options(self, preset: str) -> Any:
        """Return all options, with the landmarks that were found if none are chosen."""
        options = self.choices.options(preset)
        if getattr(options, "landmarks", None) != LANDMARKS_FOUND:
            return options
        return self.guide(options).options

    def guide(self, options: Any) -> Guided:
        """Return the landmarks of the pictures; they are found once."""
        count = len(self.pictures)
        pairs = pairs_of(count) if self.choices.kind.grid else list(pairwise(range(count)))
        key = (self.choices.kind.grid, *(picture.key for picture in self.pictures))
        with self.tab.lock:
            if key not in self.tab.found:
                self.tab.found.clear()
                images = [picture.pixels for picture in self.pictures]
                self.tab.found[key] = guides(images, pairs, MorphOptions())
            found = self.tab.found[key]
        return found._replace(options=options.replace(landmarks=found.options.landmarks))

    def words(self, preset: str) -> dict[str, str]:
        """Return the command line and the Python code, for the page."""
        names = [picture.path.name for picture in self.pictures]
        return {
            "command": command_line(self.choices, preset, names),
            "python": python_code(self.choices, preset, names),
        }


def guarded(work: Callable[[], None], failed: Callable[[str], None], line_of: LineOf) -> None:
    """Do some work; say an error in one line, as the command line does."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            work()
    except ClmorphError as error:
        failed(printable(line_of(error), MESSAGE))
    except MemoryError:
        failed("not enough memory; use smaller pictures or a smaller size")
    except Exception as error:  # a driver raises what it likes, and the studio goes on
        failed(printable(f"{type(error).__name__}: {reason_of(error)}", MESSAGE))


def preview(ask: Ask) -> None:
    """Show small results, each finer than the one before."""
    operations = get_backend(ask.choices.device)
    kind = ask.choices.kind
    task = _task(ask, ask.options(ask.recognized()), operations)
    steps = small_tasks(kind.name, task)
    for step, small in enumerate(steps):
        made = MAKERS[kind.name](small, checking)
        name = f"preview-{ask.number}-{step}"
        path = ask.tab.folder / f"{name}.{'html' if kind.film else 'png'}"
        made.write(path, _parameters(ask, small.options, operations), checking)
        ask.tab.publish(
            "preview", number=ask.number, step=step, url=ask.tab.view(name, path),
            film=kind.film, last=step == len(steps) - 1, unmatched=made.unmatched,
        )  # fmt: skip


def run(ask: Ask) -> None:
    """Compute the whole result, and show it."""
    tab, began, kind = ask.tab, time.perf_counter(), ask.choices.kind
    preset = ask.recognized()
    options = ask.options(preset)
    report = _Reports(tab, ask.number)
    report("preparation", 0.0)
    operations = get_backend(ask.choices.device)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ClmorphWarning)
        warnings.simplefilter("ignore", ConvergenceWarning)
        made = MAKERS[kind.name](_task(ask, options, operations), report)
    gave_way = any(isinstance(each.message, MemoryWarning) for each in found)
    if gave_way and getattr(options, "max_memory", 0) is None:
        # As on the command line: the recipe holds the limit that reduced the particles.
        limit = {"max_memory": default_memory(operations)}
        options = options.replace(**limit)
        ask = replace(ask, choices=replace(ask.choices, given={**ask.choices.given, **limit}))
    result = Result(ask.number, made, _parameters(ask, options, operations), ask.choices)
    path = tab.folder / f"result-{ask.number}.{'html' if kind.film else 'png'}"
    write_file(result, path, report)
    tab.result = result
    tab.told = dict(
        number=ask.number, url=tab.view(f"result-{ask.number}", path), film=kind.film,
        seconds=round(time.perf_counter() - began, 2), message=made.message,
        notes=[printable(str(each.message), MESSAGE) for each in found],
        unmatched=made.unmatched, of=kind.name, **ask.words(preset),
    )  # fmt: skip
    tab.publish("result", **tab.told)


def write_file(result: Result, path: Path, report: StageProgress) -> None:
    """Write a file of a finished run, by the same steps as the command line."""
    if path.suffix == ".json":
        path.write_text(json.dumps(result.parameters, indent=2) + "\n", "utf-8")
        return
    result.made.write(path, result.parameters, report)


def write_still(result: Result, time: float, path: Path) -> None:
    """Write the frame of a finished film at a time, from 0 to the number of its parts."""
    with atomic_path(path) as file:
        write_picture(result.made.still(time), {**result.parameters, "time": time}, file)


def _task(ask: Ask, options: Options, operations: Operations) -> Task:
    pictures = [picture.pixels for picture in ask.pictures]
    return Task(pictures, ask.painted, options, operations, ask.choices.sides)


def _parameters(ask: Ask, options: Options, operations: Operations) -> dict[str, Any]:
    kind = ask.choices.kind
    beside = {kind.painted: picture_entries(ask.painted)} if ask.painted else {}
    return recipe(
        options, images=picture_entries([picture.path for picture in ask.pictures]),
        device=operations.description, beside=beside,
        mixes=ask.choices.mixes,
    )  # fmt: skip


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
