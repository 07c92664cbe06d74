"""``clmorph morph``: pictures in, a file out."""

import itertools
import json
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from clmorph import defaults
from clmorph.commands import settings as files
from clmorph.commands.common import note_warning, open_backend, read_picture
from clmorph.commands.settings import Settings
from clmorph.errors import ConvergenceWarning, InputError
from clmorph.export import Output
from clmorph.files import atomic_path
from clmorph.film import Film, recorded
from clmorph.framing import Look
from clmorph.images import fit
from clmorph.morph import check_options
from clmorph.morph import morph as make_morph
from clmorph.motion import Motion, resting
from clmorph.operations import Operations
from clmorph.potentials import Potentials
from clmorph.result import Morph
from clmorph.terminal import NOTES, Stages
from clmorph.widths import is_pixel_art

#: Settings that are not the morph's own, by what takes them.
MOTION = ("fps", "duration", "hold", "loop")
LOOK = ("canvas", "scaling", "background", "lossless")
RUN = ("frames", "size", "reverse", "format", "recipe")


@dataclass
class _Run:
    """One call of the command, its settings checked and sorted."""

    images: Sequence[Path]
    settings: Settings
    outputs: Sequence[Output]
    options: Settings = field(default_factory=dict)
    solved: list[Potentials] = field(default_factory=list)

    def __post_init__(self) -> None:
        said = self.settings
        own = {*MOTION, *LOOK, *RUN}
        self.options = {name: value for name, value in said.items() if name not in own}
        if "max_memory" in self.options:
            self.options["max_memory"] *= 1e9  # it is said in gigabytes
        self.n_frames = said.get("frames", defaults.N_FRAMES)
        check_options(n_frames=self.n_frames, **self.options)
        self.look = Look(**{name: said[name] for name in LOOK if name in said})
        self.motion = self._motion()

    def _motion(self) -> Motion:
        given = {name: self.settings[name] for name in MOTION if name in self.settings}
        duration = given.pop("duration", None)
        if duration is None:
            return Motion(**given)
        if "fps" in given:
            raise InputError(
                f"--duration {duration:g} and --fps {given['fps']:g} contradict: give one of them"
            )
        return Motion.lasting(duration, resting(len(self.images), self.n_frames), **given)

    def morphs(
        self, pictures: Sequence[NDArray[np.float64]], operations: Operations, stages: Stages
    ) -> Iterator[Morph]:
        """Solve one pair after the other."""
        for number, pair in enumerate(itertools.pairwise(pictures)):
            mark = f" {number + 1}" if len(pictures) > 2 else ""
            morph = make_morph(
                *pair, self.n_frames, backend=operations, progress=stages.marked(mark),
                **self.options,
            )  # fmt: skip
            self.solved.append(morph.potentials)
            yield morph


def run_morph(
    images: Sequence[Path],
    outputs: Sequence[Path],
    settings: Settings,
    *,
    max_pixels: int,
    device: str | None,
    backend: str | None,
    as_json: bool,
) -> None:
    """Morph pictures into one another, once, and write the files.

    Parameters
    ----------
    images : sequence of Path
        Two, or more for a chain.
    outputs : sequence of Path
    settings : dict
        By option names with underscores.
    max_pixels : int
        Larger files are refused.
    device, backend : str, optional
    as_json : bool
        Say what was made to programs, not to people.
    """
    began = time.perf_counter()
    for output, path in itertools.product(outputs, images):
        if output.exists() and path.exists() and output.samefile(path):
            raise InputError(f"-o {output} would overwrite an input; choose another name")
    places = [Output(output, settings.get("format")) for output in outputs]
    if len({place.place for place in places}) < len(places):
        raise InputError("two outputs have one name; choose different ones")
    run = _Run(images, settings, places)
    size = settings.get("size")
    pictures = [read_picture(path, max_pixels) for path in images]
    if size is not None:
        pictures = [fit(picture, size) for picture in pictures]
    operations = open_backend(device, backend)
    told = files.recipe(settings, images, operations.description)
    with Stages() as stages, warnings.catch_warnings():
        # Said in the last line.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.showwarning = note_warning
        with recorded(
            run.morphs(pictures, operations, stages), run.motion,
            reverse=bool(settings.get("reverse")),
            exact=any(place.format.exact for place in places),
            keep=any(place.format.keep for place in places),
            pixelated=all(map(is_pixel_art, pictures)), parameters=told,
            folder=places[0].place.parent, progress=stages,
        ) as film:  # fmt: skip
            for place in places:
                place.write(film, run.look, partial(stages, place.path.name))
            summary = _summary(run, film, stages, told)
    if settings.get("recipe"):
        for place in places:
            _write_recipe(run, place.path, operations.description)
    summary["seconds"]["total"] = round(time.perf_counter() - began, 3)
    click.echo(json.dumps(summary) if as_json else _last_line(run, summary))


def _write_recipe(run: _Run, output: Path, device: str) -> None:
    """Leave what repeats the run beside a file."""
    beside = output.with_name(f"{output.name}.json")
    whole = files.recipe(run.settings, run.images, device, beside.resolve().parent)
    with atomic_path(beside) as new:
        new.write_text(json.dumps(whole, indent=2) + "\n", "utf-8")


def _summary(run: _Run, film: Film, stages: Stages, told: dict[str, Any]) -> dict[str, Any]:
    """Return what was made, for programs."""
    return {
        "outputs": [{"path": str(output.path), "format": output.name} for output in run.outputs],
        "frames": len(film),
        "played": len(film.played()),
        "duration": round(film.duration, 6),
        "fps": film.motion.fps,
        "sizes": [list(size) for size in dict.fromkeys((w, h) for h, w, _ in film.shapes)],
        "solver": [
            {
                "status": potentials.status,
                "residual": float(potentials.residual),
                "iterations": potentials.n_iter,
                "message": potentials.message,
            }
            for potentials in run.solved
        ],
        "seconds": {name: round(value, 3) for name, value in stages.seconds.items()},
        **told,
    }


def _last_line(run: _Run, summary: dict[str, Any]) -> str:
    """Return what was made, for people."""
    worst = max(run.solved, key=lambda potentials: potentials.residual)
    lasting = ""
    if any(output.format.animated for output in run.outputs):
        lasting = f", {summary['duration']:.3g} s a round"
    names = ", ".join(str(output.path) for output in run.outputs)
    return (
        f"{names}: {summary['frames']} frames{lasting}, made in "
        f"{summary['seconds']['total']:.1f} s; {worst.message}"
    )


def announce_changes(images: Sequence[tuple[Path, str | None]]) -> None:
    """Note images that are not what they were when a file of settings was written."""
    for path, known in images:
        if known is not None and path.is_file() and files.digest(path) != known:
            NOTES.print(f"note: {path} is not the file that was used then", markup=False)
