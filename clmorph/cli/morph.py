"""The command ``clmorph morph``: pictures, or clips while both play, become one or more files."""

import itertools
import math
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from clmorph._shared.printable import size_text
from clmorph.backends.interface import Operations
from clmorph.cli.request import Prepared, Request
from clmorph.cli.terminal import Stages, note, noted_warnings, read_picture, say
from clmorph.clips.reading import is_clip
from clmorph.errors import ConvergenceWarning, InputError, MemoryWarning, PruningWarning
from clmorph.images.detail import is_pixel_art
from clmorph.images.resizing import as_unit
from clmorph.measures.pixel_blocks import block_side, solved_size
from clmorph.output.framing import enlargement_note
from clmorph.output.recording import Recording
from clmorph.output.save import PACE, SIZES, recorded_for, write_all
from clmorph.pipeline.budget import default_memory
from clmorph.pipeline.clip_morph import EVERY, ClipFilm
from clmorph.pipeline.clip_writing import check_clip_outputs, write_clip_film
from clmorph.pipeline.memory import expected, process_memory
from clmorph.pipeline.morph import ImagePair, shapes_of
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import fitted, lifted_shapes
from clmorph.pipeline.result import Morph
from clmorph.transport.potentials import Potentials


@dataclass
class _Run:
    """A chain of morphs that is prepared, and what is known of those that are solved."""

    request: Request
    ready: Prepared
    options: MorphOptions
    solved: list[Potentials] = field(default_factory=list)
    particles: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pictures = fitted(self.ready.pictures, self.options)
        self.several = len(self.pictures) > 2

    @property
    def metadata(self) -> dict[str, Any]:
        """The recipe of the film."""
        return self.request.metadata(self.options, self.ready.operations)

    def memory(self) -> str:
        """Return a text about the most memory of the process, and the sizes of what is solved."""
        options, maps, operations = self.options, self.ready.maps, self.ready.operations
        process = process_memory(operations)
        shapes = [(height, width, count) for height, width, count in map(np.shape, self.pictures)]
        pairs = list(itertools.pairwise(shapes))
        needs = [
            expected(pair, options, operations, maps, process=process, chained=self.several)
            for pair in pairs
        ]
        text = f"memory: about {size_text(max(need.ram for need in needs))}"
        if not needs[0].shared:
            text += f", {size_text(max(need.device for need in needs))} on the device"
        most = options.solve_size
        lifted = [shape[:2] for pair in pairs for shape in lifted_shapes(pair, options, maps)]
        taken = {solved_size(shape, most) for shape in lifted if block_side(shape, most) > 1}
        if taken:
            numbers = " and ".join(map(str, sorted(taken)))
            text += f"; solved at {numbers} blocks of pixels along the longer side"
        if all(a.shape == b.shape for a, b in zip(self.ready.pictures, self.pictures, strict=True)):
            return text
        if options.detail == "pixels":
            return f"{text}; blocks of the sprites are taken as pixels"
        return f"{text}; pictures reduced to {options.size} pixels (--size)"

    def morphs(self, stages: Stages) -> Iterator[Morph]:
        """Compute the morphs of successive pictures, one at a time."""
        shapes = shapes_of(self.ready.pictures)
        for number, pair in enumerate(itertools.pairwise(self.pictures)):
            options = self.ready.guide.of(number).replace(max_memory=self.options.max_memory)
            morph = ImagePair(pair, options, shapes[number : number + 2], self.ready.maps).morph(
                self.ready.operations, stages.marked(f" {number + 1}" if self.several else "")
            )
            _note_misses(morph)
            self.solved.append(morph.potentials)
            self.particles.append(len(morph.particles))
            yield morph
            del morph  # before the next one is computed


def run_morph(request: Request, line: Collection[str]) -> None:
    """Morph each picture into the next one; `line` names the options of the command line."""
    if any(map(is_clip, request.images)):
        _run_clips(request)
        return
    _announce_idle(line, request)
    places, count = request.places, len(request.images)
    request.check_files()
    motion = request.motion()
    for name in request.beside if count > 2 else ():
        raise InputError(
            f"--{name} is for two pictures, but {count} are given: morph them two at a time"
        )
    pairs = list(itertools.pairwise(range(count)))
    ready = request.prepared(pairs)
    options, operations = ready.guide.options, ready.operations
    options = _capped(options, operations) if request.capped else options
    run = _Run(request, ready, options)
    say(run.memory())

    with request.stages() as stages, noted_warnings() as notes:
        # The last line reports convergence instead.
        warnings.simplefilter("ignore", ConvergenceWarning)
        for kind in (MemoryWarning, PruningWarning):
            warnings.simplefilter("always", kind)
        with recorded_for(
            places, run.morphs(stages), motion, n_morphs=count - 1, reverse=options.reverse,
            pixelated=all(map(is_pixel_art, run.pictures)), parameters=run.metadata,
            progress=stages,
        ) as film:  # fmt: skip
            gave_way = any(isinstance(each, MemoryWarning) for each in notes)
            if gave_way and options.max_memory is None:
                # Particles were reduced to fit into memory. A larger device would not reduce them,
                # so the recipe must contain the limit.
                run.options = options.replace(max_memory=default_memory(operations))
                film = replace(film, parameters=run.metadata)
            enlarged = enlargement_note(options, film.shapes, film.pixelated, options.size)
            if enlarged and any("canvas" in place.format.relevant_options for place in places):
                note(enlarged)
            write_all(
                places, film, run.options, stages.writing, request.texts(run.options, operations)
            )
            summary = _summary(run, film, notes)
    if ready.preset is not None:
        summary["preset"] = ready.preset
    summary["found"] = ready.guide.found
    worst = max(run.solved, key=lambda potentials: potentials.residual)
    made = f"{len(film)} frames{request.round_text(film.duration)}"
    request.finish(summary, stages, made, f"; {worst.message}")


def _capped(options: MorphOptions, operations: Operations) -> MorphOptions:
    """Return options without a recipe's limit of memory that exceeds the device's default limit."""
    limit, given = default_memory(operations) or math.inf, options.max_memory or 0.0
    if given <= limit:
        return options
    note(f"the recipe's limit of {size_text(given)} is above the device's own, {size_text(limit)}")
    return options.replace(max_memory=None)


def _note_misses(morph: Morph) -> None:
    """Print a note about landmarks that are missed by a pixel or more."""
    far = np.flatnonzero(morph.misses >= 1.0)
    if len(far):
        worst = int(np.argmax(morph.misses))
        which = "landmark" if len(far) == 1 else f"{len(far)} landmarks, most of all landmark"
        note(
            f"the warp misses {which} {worst + 1} by {morph.misses[worst]:.2g} pixels: others "
            "nearby move otherwise"
        )


def _summary(run: _Run, film: Recording, notes: list[Warning]) -> dict[str, Any]:
    """Return the summary of the run for programs."""
    return {
        "outputs": run.request.written,
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


def _run_clips(request: Request) -> None:
    """Write a film in which one becomes the other, and print a summary."""
    options, places = request.options, request.places
    check_clip_outputs(places)
    request.check_files()
    if len(request.images) != 2:
        raise InputError(
            f"{len(request.images)} pictures and clips are given: expected two, of which one or "
            "both are clips"
        )
    if request.beside:
        raise InputError(f"--{next(iter(request.beside))} is for stills: leave it out for a clip")
    if "size" not in request.named:
        options = options.replace(size=None)
    ends = [
        path if is_clip(path) else as_unit(read_picture(path, request.max_pixels))
        for path in request.images
    ]
    with request.stages() as stages:
        operations = request.open()
        film = ClipFilm(
            ends[0], ends[1], options, options.fps if "fps" in request.named else None, EVERY,
            request.max_pixels, operations, stages,
        )  # fmt: skip
        if options.duration is None:  # the recipe has the rate of the film
            options = options.replace(fps=float(film.rate))
        parameters = request.metadata(options, operations)
        frames = write_clip_film(film, places, parameters, request.texts(options, operations))
        summary: dict[str, Any] = {
            "outputs": request.written,
            "frames": frames,
            "transition": film.count,
            "fps": float(film.rate),
            "sizes": [list(film.size)],
            **parameters,
        }
    request.finish(summary, stages, f"{frames} frames, {frames / summary['fps']:.3g} s")


def _announce_idle(names: Collection[str], request: Request) -> None:
    """Print a note about options that have no effect on any output."""
    known = {name for place in request.places for name in place.format.relevant_options}
    for name in (*SIZES, *PACE, "lossless"):
        if name in names and name not in known:
            note(f"--{name} makes no difference to {', '.join(map(str, request.outputs))}")
