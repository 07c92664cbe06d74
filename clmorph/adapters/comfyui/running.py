"""Progress, interruption and files of a node, which are ComfyUI's where it runs."""

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

Item = TypeVar("Item")


def input_path(path: str) -> Path:
    """Return a path, from ComfyUI's folder for inputs on if it is relative."""
    folders = sys.modules.get("folder_paths")
    return Path(path) if folders is None else Path(folders.get_input_directory()) / path


#: Steps of the bar for each unit of work.
STEPS = 100


class Running:
    """The work of a node, in units: a solve is one, and so is a frame.

    An object is a progress function of clmorph, for the solve that is under way. Each report
    raises ComfyUI's exception if the user has asked to stop.
    """

    def __init__(self, units: int) -> None:
        utils = sys.modules.get("comfy.utils")
        self._bar = None if utils is None else utils.ProgressBar(units * STEPS)
        self._total, self._done, self._shown = units * STEPS, 0, 0
        self._stages: list[str] = []

    def __call__(self, stage: str, share: float) -> None:
        """Show the share of a stage; later stages divide what is left of the unit."""
        if stage not in self._stages:
            self._stages.append(stage)
        rest = 0.5 ** self._stages.index(stage)
        self._show(self._done + int(STEPS * (1.0 - rest * (1.0 - 0.5 * share))))

    def unit(self) -> None:
        """Count one unit of work as done."""
        self._stages.clear()
        self._done += STEPS
        self._show(self._done)

    def each(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield items, each of which is one unit of work."""
        for item in items:
            yield item
            self.unit()

    def _show(self, steps: int) -> None:
        management = sys.modules.get("comfy.model_management")
        if management is not None:
            management.throw_exception_if_processing_interrupted()
        if self._bar is not None and steps > self._shown:
            self._shown = steps
            self._bar.update_absolute(min(steps, self._total), self._total)
