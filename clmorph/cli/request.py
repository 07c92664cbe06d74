"""What the command line asks of a command that turns pictures into files."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import click

from clmorph._shared.files import check_apart, is_standard_output
from clmorph._shared.options import Options
from clmorph._shared.printable import printable
from clmorph.backends.interface import Operations
from clmorph.cli.common import beside_entries, open_backend, read_picture, recipe_places
from clmorph.cli.terminal import Stages
from clmorph.errors import InputError
from clmorph.output.save import Output
from clmorph.pipeline.maps import AUTO_LABELS
from clmorph.pipeline.recipe import picture_entries, recipe


@dataclass(frozen=True)
class Request:
    """A call of ``clmorph morph``, ``mix``, ``rearrange`` or ``recolor``."""

    images: Sequence[Path]
    outputs: Sequence[Path]
    options: Any  #: an object of the command's class of options
    max_pixels: int
    #: The output format, in place of the format of the output's ending.
    format: str | None = None
    #: Whether a recipe is written beside each output.
    recipe: bool = False
    #: The file of settings, which must not be overwritten.
    config: Path | None = None
    device: str | None = None
    backend: str | None = None
    as_json: bool = False
    #: Files beside the pictures, by what they are: labels, features, mask.
    beside: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    #: Tables of colors that are also written.
    tables: Sequence[Path] = ()
    #: The options by a preset, if the pictures choose it; they replace `options`.
    options_of: Callable[[str], Any] | None = None
    #: Whether `max_memory` comes from a recipe, which may lower the device's limit but not raise
    #: it.
    capped: bool = False
    #: What of mixes is shown: one of "grid" (the number of mixes along a side, or rows x columns,
    #: such as "5x5"), "weights" (of each mix), "path" (letters) and "stops" (weights), see
    #: `clmorph.pipeline.mixing.weights`.
    shown: Mapping[str, Any] | None = None
    #: Names of the options that the user gives, in Python.
    named: frozenset[str] = frozenset()
    began: float = field(default_factory=time.perf_counter)

    @cached_property
    def recipes(self) -> list[Path]:
        """Paths of the recipes that are written."""
        return recipe_places(self.outputs) if self.recipe else []

    def places(self) -> list[Output]:
        """Return the outputs in their formats."""
        return places_of(self.outputs, self.format)

    def formats(self) -> list[str | None]:
        """Return the format of each output; None if its ending says it."""
        return _formats(self.outputs, self.format)

    def check_files(self) -> None:
        """Raise an error if a file that is read would be overwritten."""
        beside = [path for paths in self.beside.values() for path in paths]
        read = [path for path in beside if path not in AUTO_LABELS]
        own = [] if self.config is None else [self.config]
        check_apart([*self.outputs, *self.tables, *self.recipes], [*self.images, *read, *own])

    def read(self) -> list[Any]:
        """Read the pictures."""
        return [read_picture(path, self.max_pixels) for path in self.images]

    def open(self) -> Operations:
        """Choose the device and print its name."""
        return open_backend(self.device, self.backend)

    def stages(self) -> Stages:
        """Return the display of the command's progress."""
        return Stages(self.began)

    def metadata(
        self, options: Options, operations: Operations, folder: Path | None = None
    ) -> dict[str, Any]:
        """Return the recipe; pictures are named as seen from `folder`."""
        return recipe(
            options, images=picture_entries(self.images, folder), device=operations.description,
            beside=beside_entries(self.beside, folder), mixes=self.shown,
        )  # fmt: skip

    def texts(self, options: Options, operations: Operations) -> dict[Path, str]:
        """Return the texts of the recipes by their paths."""
        found = {}
        for path in self.recipes:
            made = self.metadata(options, operations, path.resolve().parent)
            found[path] = json.dumps(made, indent=2) + "\n"
        return found

    def finish(self, summary: dict[str, Any], stages: Stages, what: str, more: str = "") -> None:
        """Print the summary for programs, or in one line what was made, how fast, and `more`."""
        seconds = {name: round(value, 3) for name, value in stages.seconds.items()}
        seconds["total"] = round(time.perf_counter() - self.began, 3)
        summary["seconds"] = seconds
        names = ", ".join(map(printable, [*self.outputs, *self.tables]))
        line = f"{names}: {what}, made in {seconds['total']:.1f} s{more}"
        text = json.dumps(summary) if self.as_json else line
        click.echo(text, err=any(map(is_standard_output, self.outputs)))


def places_of(outputs: Sequence[Path], format: str | None) -> list[Output]:
    """Return outputs in the format asked for, or in those of their endings."""
    return list(map(Output, outputs, _formats(outputs, format)))


def _formats(outputs: Sequence[Path], format: str | None) -> list[str | None]:
    """Return the format of each output; that asked for is, of several, standard output's."""
    piped = [len(outputs) == 1 or is_standard_output(output) for output in outputs]
    if format is not None and not any(piped):
        raise InputError(
            "--format is for one output, or for standard output among several: leave it out, or "
            "write one at a time"
        )
    return [format if each else None for each in piped]
