"""What the command line asks of a command that turns pictures into files."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import click

from clmorph._shared.files import check_apart, check_place, is_standard_output
from clmorph._shared.options import Options
from clmorph._shared.printable import printable
from clmorph.backends.interface import Operations
from clmorph.cli.terminal import (
    Stages,
    note,
    noted_libraries,
    open_backend,
    quiet_libraries,
    read_picture,
    say,
)
from clmorph.errors import InputError, OutputError
from clmorph.images.pixels import reduced_shape
from clmorph.output.playback import Motion, held_frames, motion_of
from clmorph.output.save import Output
from clmorph.pipeline.guides import Guided, guides, labeled
from clmorph.pipeline.maps import AUTO_LABELS, Maps, read_maps
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import recognized
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.recipe import picture_entries, recipe

#: Pixels of the shorter side of a reduced picture below which little of it is left.
THIN = 8


class Prepared(NamedTuple):
    """Pictures that were read, and what was chosen for them."""

    pictures: list[Any]
    maps: Maps
    guide: Guided  #: the options, and the landmarks of each pair
    preset: str | None  #: the preset that the pictures have chosen
    operations: Operations


@dataclass(frozen=True)
class Request:
    """A call of ``clmorph morph``, ``mix``, ``rearrange``, ``recolor`` or ``inspect``."""

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
    device: str = "auto"
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
        """Paths of the recipes that are written beside the outputs."""
        found = []
        for output in self.outputs if self.recipe else ():
            if is_standard_output(output):
                raise OutputError(
                    "--recipe writes a file beside the output, and standard output is not a file: "
                    "leave it out, or name a file"
                )
            # Paths without a name, such as ``.``, are resolved.
            named = output if output.name not in ("", "..") else output.resolve()
            found.append(named.with_name(f"{named.name}.json") if named.name else named / ".json")
            if check_place(found[-1]).is_dir():
                raise OutputError(f"{found[-1]} is a folder; choose another name for the output")
        return found

    @cached_property
    def formats(self) -> list[str | None]:
        """The format of each output, None if its ending says it; of several, standard output's."""
        piped = [len(self.outputs) == 1 or is_standard_output(output) for output in self.outputs]
        if self.format is not None and not any(piped):
            raise InputError(
                "--format is for one output, or for standard output among several: leave it out, "
                "or write one at a time"
            )
        return [self.format if each else None for each in piped]

    @cached_property
    def places(self) -> list[Output]:
        """The outputs in their formats."""
        return list(map(Output, self.outputs, self.formats))

    @property
    def written(self) -> list[dict[str, str]]:
        """The outputs for the summary."""
        return [{"path": str(each.path), "format": each.name} for each in self.places]

    def motion(self) -> Motion:
        """Return the pace of a film of all pictures, which all outputs can hold."""
        motion = motion_of(self.options, held_frames(len(self.images), self.options.n_frames))
        for place in self.places:
            place.check_motion(motion)
        return motion

    def round_text(self, seconds: float) -> str:
        """Return a text about the time of a film, "" if no output shows one."""
        animated = any(place.format.animated for place in self.places)
        return f", {seconds:.3g} s a round" if animated else ""

    def check_files(self) -> None:
        """Raise an error if a file that is read would be overwritten."""
        beside = [path for paths in self.beside.values() for path in paths]
        read = [path for path in beside if path not in AUTO_LABELS]
        own = [] if self.config is None else [self.config]
        check_apart([*self.outputs, *self.tables, *self.recipes], [*self.images, *read, *own])

    def read(self) -> list[Any]:
        """Read the pictures."""
        return [read_picture(path, self.max_pixels) for path in self.images]

    def prepared(self, pairs: Sequence[tuple[int, int]]) -> Prepared:
        """Read the files, and choose and tell the options, labels and landmarks of pairs."""
        pictures, options, preset = self.read(), self.options, None
        # A mistake in its name is one line, before anything is told of the pictures.
        operations = self.open()
        if self.options_of is not None:
            preset = recognized(pictures)
            options = self.options_of(preset)
            say(_chosen_preset(preset, options))
        self.note_thin(pictures, options)
        labels, features = (self.beside.get(name, ()) for name in ("labels", "features"))
        with noted_libraries():
            maps = read_maps(labels, features, self.max_pixels)
        with quiet_libraries():
            maps, text = labeled(pictures, maps)
            guide = guides(pictures, pairs, options, maps)
        for what, found in (("labels", text), ("landmarks", guide.found)):
            if found:
                say(f"{what}: {found}")
        return Prepared(pictures, maps, guide, preset, operations)

    def note_thin(self, pictures: Sequence[Any], options: Any) -> None:
        """Print a note about each picture whose shorter side is nearly lost when it is reduced."""
        if getattr(options, "detail", "") == "pixels":
            return  # blocks of sprites become pixels
        for path, picture in zip(self.images, pictures, strict=False):
            height, width = picture.shape[:2]
            down, across = reduced_shape((height, width), options.size or max(height, width))
            if min(down, across) < min(THIN, height, width):
                note(
                    f"{path} of {width} x {height} pixels is reduced to {across} x {down} (--size),"
                    " which leaves little of its shorter side; give a larger --size, or cut it"
                )

    def open(self) -> Operations:
        """Choose the device and print its name."""
        return open_backend(self.device)

    def stages(self) -> Stages:
        """Return the display of the command's progress, after its preparation."""
        stages = Stages(self.began)
        stages.count("preparation")
        return stages

    def metadata(
        self, options: Options, operations: Operations, folder: Path | None = None
    ) -> dict[str, Any]:
        """Return the recipe; pictures are named as seen from `folder`."""
        beside = {
            name: AUTO if tuple(paths) == AUTO_LABELS else picture_entries(paths, folder)
            for name, paths in self.beside.items()
        }
        return recipe(
            options, images=picture_entries(self.images, folder), device=operations.description,
            beside=beside, mixes=self.shown,
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


def _chosen_preset(preset: str, options: MorphOptions) -> str:
    """Return a line about the preset of the pictures, and which options differ from it."""
    usual = MorphOptions(preset=preset)
    given = [
        name for name in PRESETS[preset].options if getattr(options, name) != getattr(usual, name)
    ]
    other = f"; given otherwise: {', '.join(given)}" if given else " (--preset takes another)"
    return f"preset: {preset}, for what the pictures show{other}"
