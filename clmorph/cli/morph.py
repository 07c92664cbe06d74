"""The command ``clmorph morph``: it reads pictures and writes one or more output files."""

import itertools
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import size_text
from clmorph.backends.interface import Operations
from clmorph.cli import config as files
from clmorph.cli.common import (
    chosen_preset,
    found_guides,
    found_labels,
    note_misses,
    note_thin,
    note_warning,
    read_beside,
)
from clmorph.cli.request import Request, places_of
from clmorph.cli.terminal import Stages, note, say
from clmorph.errors import ConvergenceWarning, FileError, InputError, MemoryWarning, PruningWarning
from clmorph.images.detail import is_pixel_art
from clmorph.measures.pixel_blocks import block_side, solved_size
from clmorph.output.framing import enlargement_note
from clmorph.output.playback import held_frames, motion_of
from clmorph.output.recording import Recording
from clmorph.output.save import PACE, SIZES, Output, recorded_for, write_all
from clmorph.pipeline.budget import default_memory
from clmorph.pipeline.guides import Guided
from clmorph.pipeline.maps import NO_MAPS, Maps
from clmorph.pipeline.memory import expected, process_memory
from clmorph.pipeline.morph import ImagePair, shapes_of
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import fitted, lifted_shapes, recognized
from clmorph.pipeline.result import Morph
from clmorph.transport.potentials import Potentials


@dataclass
class _Run:
    """One call of the command, checked before the computation begins."""

    images: Sequence[Path]
    options: MorphOptions
    outputs: Sequence[Output]
    solved: list[Potentials] = field(default_factory=list)
    particles: list[int] = field(default_factory=list)
    shapes: Sequence[tuple[int, int]] = ()
    maps: Maps = NO_MAPS
    guide: Guided | None = None

    def __post_init__(self) -> None:
        self.motion = motion_of(self.options, held_frames(len(self.images), self.options.n_frames))
        for output in self.outputs:
            output.check_motion(self.motion)

    def memory(self, pictures: Sequence[NDArray[np.float64]], operations: Operations) -> str:
        """Return a text about the most memory of the process, without frames that are kept."""
        process = process_memory(operations)
        needs = [
            expected(
                pair,
                self.options,
                operations,
                self.maps,
                process=process,
                chained=len(pictures) > 2,
            )
            for pair in itertools.pairwise(map(_shape, pictures))
        ]
        text = f"memory: about {size_text(max(need.ram for need in needs))}"
        if not needs[0].shared:
            text += f", {size_text(max(need.device for need in needs))} on the device"
        return text + self._blocks(pictures)

    def _blocks(self, pictures: Sequence[NDArray[np.float64]]) -> str:
        """Return a text with the number of blocks that are solved; "" if pixels are solved."""
        most = self.options.solve_size
        shapes = [
            shape[:2] for pair in itertools.pairwise(map(_shape, pictures))
            for shape in lifted_shapes(pair, self.options, self.maps)
        ]  # fmt: skip
        taken = {solved_size(shape, most) for shape in shapes if block_side(shape, most) > 1}
        if not taken:
            return ""
        numbers = " and ".join(map(str, sorted(taken)))
        return f"; solved at {numbers} blocks of pixels along the longer side"

    def morphs(
        self, pictures: Sequence[NDArray[np.float64]], operations: Operations, stages: Stages
    ) -> Iterator[Morph]:
        """Compute the morphs of successive pictures, one at a time."""
        for number, pair in enumerate(itertools.pairwise(pictures)):
            mark = f" {number + 1}" if len(pictures) > 2 else ""
            options = self.options if self.guide is None else self.guide.of(number)
            morph = ImagePair(
                pair, options.replace(max_memory=self.options.max_memory),
                self.shapes[number : number + 2], self.maps,
            ).morph(operations, stages.marked(mark))  # fmt: skip
            note_misses(morph)
            self.solved.append(morph.potentials)
            self.particles.append(len(morph.particles))
            yield morph
            del morph  # before the next one is computed


def run_morph(request: Request) -> None:
    """Morph each picture into the next one, write the output files, and print a summary."""
    images, places = request.images, request.places()
    request.check_files()
    run = _Run(images, request.options, places)
    whole = request.read()
    preset = None
    if request.options_of is not None:
        preset = recognized(whole)
        run.options = request.options_of(preset)
    for name in request.beside:
        if len(whole) > 2:
            raise InputError(
                f"--{name} is for two pictures, but {len(whole)} are given: morph them two at a "
                "time"
            )
    labels, features = (request.beside.get(name, ()) for name in ("labels", "features"))
    run.maps = read_beside(labels, features, request.max_pixels)
    run.maps = found_labels(whole, run.maps)
    run.shapes = shapes_of(whole)
    run.guide = found_guides(
        whole, list(itertools.pairwise(range(len(whole)))), run.options, run.maps
    )
    run.options = run.guide.options
    pictures = fitted(whole, run.options)
    note_thin(images, whole, run.options)
    operations = request.open()
    if request.capped:
        _cap_memory(run, operations)
    reduced = any(a.shape != b.shape for a, b in zip(whole, pictures, strict=True))
    shown = ""
    if reduced and run.options.detail == "pixels":
        shown = "; blocks of the sprites are taken as pixels"
    elif reduced:
        shown = f"; pictures reduced to {run.options.size} pixels (--size)"
    if preset is not None:
        say(chosen_preset(preset, run.options))
    say(f"{run.memory(pictures, operations)}{shown}")

    notes: list[Warning] = []
    with request.stages() as stages, warnings.catch_warnings():
        stages.count("preparation")
        # The last line reports convergence instead.
        warnings.simplefilter("ignore", ConvergenceWarning)
        for kind in (MemoryWarning, PruningWarning):
            warnings.simplefilter("always", kind)
        warnings.showwarning = partial(note_warning, notes)
        with recorded_for(
            places, run.morphs(pictures, operations, stages), run.motion,
            n_morphs=len(pictures) - 1, reverse=run.options.reverse,
            pixelated=all(map(is_pixel_art, pictures)),
            parameters=request.metadata(run.options, operations), progress=stages,
        ) as film:  # fmt: skip
            gave_way = any(isinstance(each, MemoryWarning) for each in notes)
            if gave_way and run.options.max_memory is None:
                # Particles were reduced to fit into memory. A larger device would not reduce them,
                # so the recipe must contain the limit.
                run.options = run.options.replace(max_memory=default_memory(operations))
                film = replace(film, parameters=request.metadata(run.options, operations))
            enlarged = enlargement_note(run.options, film.shapes, film.pixelated, run.options.size)
            if enlarged and any("canvas" in place.format.relevant_options for place in places):
                note(enlarged)
            write_all(
                places, film, run.options,
                lambda place, share: stages(f"write {place.path.name}", share),
                request.texts(run.options, operations),
            )  # fmt: skip
            summary = _summary(run, film, notes)
    if preset is not None:
        summary["preset"] = preset
    summary["found"] = run.guide.found
    lasting = ""
    if any(place.format.animated for place in places):
        lasting = f", {summary['duration']:.3g} s a round"
    worst = max(run.solved, key=lambda potentials: potentials.residual)
    request.finish(summary, stages, f"{len(film)} frames{lasting}", f"; {worst.message}")


def _shape(picture: NDArray[np.float64]) -> tuple[int, int, int]:
    height, width, channels = picture.shape
    return height, width, channels


def _cap_memory(run: _Run, operations: Operations) -> None:
    """Ignore a recipe's limit of memory if it exceeds the device's default limit."""
    limit = default_memory(operations) or math.inf
    if (run.options.max_memory or 0.0) > limit:
        limit_there = size_text(run.options.max_memory or 0.0)
        run.options = run.options.replace(max_memory=None)
        note(f"the recipe's limit of {limit_there} is above the device's own, {size_text(limit)}")


def _summary(run: _Run, film: Recording, notes: list[Warning]) -> dict[str, Any]:
    """Return the summary of the run for programs."""
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
        "particles": run.particles,
        "notes": list(map(str, notes)),
        **film.parameters,
    }


def announce_changes(images: Sequence[tuple[Path, str | None]]) -> None:
    """Print a note about images that have changed since the file of settings was written."""
    for path, known in images:
        if not path.exists():
            raise FileError(
                f"{path}: no such file, but the settings name it; put it there, or name the "
                "pictures in the command line"
            )
        if known is not None and path.is_file() and files.digest(path) != known:
            note(f"{path} is not the file that was used then")


def announce_idle(names: Sequence[str], outputs: Sequence[Path], format: str | None) -> None:
    """Print a note about options that have no effect on any output."""
    formats = [place.format for place in places_of(outputs, format)]
    for name in (*SIZES, *PACE, "lossless"):
        if name in names and not any(name in kind.relevant_options for kind in formats):
            places = ", ".join(str(output) for output in outputs)
            note(f"--{name} makes no difference to {places}")
