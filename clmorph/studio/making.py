"""Make what the page asks for, by the same steps as the command line: films, pictures, sheets."""

import base64
import io
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from clmorph._shared.files import atomic_path
from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import AnyArray, Array
from clmorph.backends.interface import Operations
from clmorph.frames.sequence import FrameSequence
from clmorph.images.label_maps import read_labels, reduced_labels
from clmorph.images.pixels import fit
from clmorph.images.resizing import as_unit
from clmorph.output.picture import write_picture
from clmorph.output.save import Output, save
from clmorph.pipeline.guides import guides
from clmorph.pipeline.mixing.mix import mix
from clmorph.pipeline.mixing.writing import write_sheet
from clmorph.pipeline.morph import morph
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import DRAFT_TOL
from clmorph.pipeline.rearrange import arranged
from clmorph.pipeline.recolor import recolored
from clmorph.pipeline.result import Morph, keep_frames

#: Largest number of blocks and of particles of a preview.
BLOCKS, PARTICLES = 48, 40_000
#: Size and number of frames of each step of a preview of a morph: first fast, then finer; of a
#: rearrangement; size of mixes; and the longer sides of both pictures where one is recolored.
MORPH_STEPS, REARRANGE_STEPS = ((40, 5), (96, 12)), ((32, 6), (64, 16))
MIX_STEPS, RECOLOR_SIDES = (24, 48), (320, 128)
#: Largest number of bytes of the frames of a film that are kept in memory.
MOST_KEPT = 1 << 30
#: Colors of destroyed and of created mass, and the opacity where all mass is such.
DESTROYED, CREATED, OPACITY = (255, 80, 0), (0, 130, 255), 0.85
#: Longest side of these pictures, pixels.
LONGEST = 256
#: Shares below this are rounding.
LEAST = 1e-3


@dataclass(frozen=True)
class Made:
    """What was made; it can be written to a file."""

    #: How the computation ended, in a line.
    message: str
    #: Writes it, with its recipe, to a file in the format of its ending.
    write: Callable[[Path, dict[str, Any], StageProgress], None]
    #: Morphs, or rearrangements, one after the other, if it is a film.
    parts: Sequence[FrameSequence] = ()

    @property
    def unmatched(self) -> list[tuple[str, str]]:
        """Pictures of destroyed and of created mass for each part; none if all mass moves."""
        shares = [unmatched_shares(part) for part in self.parts]
        if not any(np.any(share > 0) for both in shares for share in both):
            return []
        return [
            (tinted(destroyed, DESTROYED), tinted(created, CREATED))
            for destroyed, created in shares
        ]

    def still(self, time: float) -> Array:
        """Return a film's frame at a time, from 0 to the number of parts: (H, W, C) in [0, 1]."""
        part = min(int(time), len(self.parts) - 1)
        return np.asarray(self.parts[part].frame(min(time - part, 1.0)), np.float64)


def film_of(parts: Sequence[FrameSequence]) -> Made:
    """Return morphs, or rearrangements, as a film; the worst solve says how it ended."""

    def write(path: Path, parameters: dict[str, Any], report: StageProgress) -> None:
        """Write it, and keep the frames for the next file."""
        morphs = [part for part in parts if isinstance(part, Morph)]
        need = sum(4 * len(part) * np.prod(part.canvas(0.5).shape) * 4 for part in morphs)
        if need <= MOST_KEPT:
            for number, part in enumerate(morphs, 1):
                keep_frames(part, _marked(report, number, len(morphs) + 1))
        save(parts, path, parameters=parameters, progress=report)

    worst = max((part.potentials for part in parts), key=lambda each: each.residual)
    return Made(worst.message, write, parts)


@dataclass(frozen=True)
class Task:
    """What is to be made."""

    #: See `clmorph.images.pixels.as_samples`.
    pictures: Sequence[AnyArray]
    #: Files with painted regions, by what `clmorph.studio.kinds.Kind.painted` says.
    painted: Sequence[Path]
    options: Any
    operations: Operations
    grid: Any = None


def make_morphs(task: Task, report: StageProgress) -> Made:
    """Morph each picture into the next one."""
    labels = tuple(read_labels(path) for path in task.painted)
    found = []
    pairs = list(itertools.pairwise(range(len(task.pictures))))
    guide = guides(task.pictures, pairs, task.options)
    for number, (one, other) in enumerate(itertools.pairwise(task.pictures), 1):
        found.append(
            morph(
                one, other, guide.of(number - 1), backend=task.operations,
                labels=(labels[0], labels[1]) if labels else None,
                progress=_marked(report, number, len(task.pictures)),
            )
        )  # fmt: skip
    return film_of(found)


def make_rearrangements(task: Task, report: StageProgress) -> Made:
    """Move the pixels of the first picture so that they form each next one."""
    pixels, found = task.pictures[0], []
    for number, picture in enumerate(task.pictures[1:], 1):
        marked = _marked(report, number, len(task.pictures))
        found.append(arranged((pixels, picture), task.options, task.operations, marked))
        pixels = found[-1][-1].astype(float)
    return film_of(found)


def make_recolored(task: Task, report: StageProgress) -> Made:
    """Give the first picture the colors of the second one."""
    mask = None
    if task.painted:
        mask = (read_labels(task.painted[0]) > 0).astype(float)
        if mask.shape != task.pictures[0].shape[:2]:  # of a preview
            shape = task.pictures[0].shape
            mask = reduced_labels(mask.astype(np.int64), (shape[0], shape[1])).astype(float)
    photo, like = map(as_unit, task.pictures)
    found, _ = recolored(photo, like, task.options, mask, task.operations, report)
    changed = 255 * float(np.abs(found - photo)[..., :3].mean())

    def write(path: Path, parameters: dict[str, Any], report: StageProgress) -> None:
        with atomic_path(path) as file:
            write_picture(found, parameters, file)

    return Made(f"colors changed by {changed:.0f} of 255 on average", write)


def make_mixes(task: Task, report: StageProgress) -> Made:
    """Mix pictures on a sheet."""
    mixes = mix(
        list(task.pictures), None, task.options, grid=task.grid, backend=task.operations,
        progress=report,
    )  # fmt: skip
    sheet = mixes.sheet(task.options.background)

    def write(path: Path, parameters: dict[str, Any], report: StageProgress) -> None:
        write_sheet([Output(path)], sheet, parameters)

    return Made(f"{len(mixes)} mixes", write)


def _marked(report: StageProgress, number: int, count: int) -> StageProgress:
    mark = f" {number}" if count > 2 else ""
    return lambda stage, share: report(f"{stage}{mark}", share)


#: What makes the result of each kind.
MAKERS: dict[str, Callable[[Task, StageProgress], Made]] = {
    "morph": make_morphs,
    "rearrange": make_rearrangements,
    "recolor": make_recolored,
    "mix": make_mixes,
}


def small_tasks(kind: str, task: Task) -> list[Task]:
    """Return tasks for previews of a task, each finer than the one before."""
    options, pictures = task.options, task.pictures
    steps: list[dict[str, Any]]
    if kind == "morph":
        steps = [_quick(options, size) | _slower(options, frames) for size, frames in MORPH_STEPS]
    elif kind == "rearrange":
        steps = [
            {"size": _least(options.size, size), **_slower(options, frames)}
            for size, frames in REARRANGE_STEPS
        ]
    elif kind == "mix":
        steps = [_quick(options, size) for size in MIX_STEPS]
    else:  # neither the picture nor the colors that it takes need all pixels
        pictures = [fit(each, side) for each, side in zip(pictures, RECOLOR_SIDES, strict=True)]
        shrunk = max(pictures[0].shape[:2]) / max(task.pictures[0].shape[:2])
        steps = [{"feather": options.feather * shrunk}]
    found: list[Task] = []
    for step in steps:
        small = replace(task, pictures=pictures, options=options.replace(**step))
        if not found or small.options != found[-1].options:
            found.append(small)
    return found


def _least(value: int | None, most: int) -> int:
    return most if value is None else min(value, most)


def _slower(options: Any, frames: int) -> dict[str, Any]:
    """Return the number of frames of a preview, which plays as long as the whole film."""
    pace = (options.fps or 20.0) * min(frames, options.n_frames) / options.n_frames
    fps = None if options.fps is None else max(pace, 0.1)
    return {"n_frames": min(options.n_frames, frames), "fps": fps}


def _quick(options: MorphOptions, size: int) -> dict[str, Any]:
    """Return options for a small and rough solve."""
    return {
        "size": _least(options.size, size), "solve_size": _least(options.solve_size, BLOCKS),
        "tol": max(options.tol, DRAFT_TOL),
        "max_particles": _least(options.max_particles, PARTICLES),
    }  # fmt: skip


def unmatched_shares(morph: FrameSequence) -> tuple[Array, Array]:
    """Return the shares in [0, 1] of each pixel's mass that is destroyed, and created.

    Destroyed is 1 - (pi 1)_i / a_i at each pixel (H, W) of the first picture, 0 without mass;
    created (H', W') is the same for the columns of the plan and the second picture.
    """
    found = []
    rho = morph.potentials.rho
    sides = zip(
        (morph.source, morph.target), morph.plan.marginals,
        rho if isinstance(rho, tuple) else (rho, rho), strict=True,
    )  # fmt: skip
    for measure, moved, penalty in sides:
        if np.isinf(penalty):  # differences are residuals
            found.append(np.zeros(measure.shape))
            continue
        share = 1.0 - np.divide(
            moved, measure.weights, out=np.ones(len(measure)), where=measure.weights > 0
        )
        found.append(np.where(share > LEAST, np.clip(share, 0.0, 1.0), 0.0).reshape(measure.shape))
    return found[0], found[1]


def tinted(share: Array, color: tuple[int, int, int]) -> str:
    """Return a picture in one color, whose opacity is the share, as the address of its data."""
    pixels: Any = np.empty((*share.shape, 4), np.uint8)
    pixels[..., :3] = color
    pixels[..., 3] = np.rint(255 * OPACITY * share)
    image = Image.fromarray(pixels)
    if max(image.size) > LONGEST:
        image.thumbnail((LONGEST, LONGEST))
    file = io.BytesIO()
    image.save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
