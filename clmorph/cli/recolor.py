"""The command ``clmorph recolor``: one picture takes the colors of another one."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from clmorph._shared.files import check_apart
from clmorph._shared.printable import printable
from clmorph.cli.common import note_warning, open_backend, read_picture, recipe_places
from clmorph.cli.terminal import Stages
from clmorph.errors import FileError
from clmorph.images.resizing import as_unit
from clmorph.output.picture import check_picture_place, write_picture
from clmorph.output.together import write_together
from clmorph.pipeline.recipe import picture_entries, recipe
from clmorph.pipeline.recolor import recolored
from clmorph.pipeline.recolor_options import RecolorOptions


@dataclass(frozen=True)
class Request:
    """The request of the command line."""

    #: The photo and the picture whose colors it gets.
    images: Sequence[Path]
    outputs: Sequence[Path]
    options: RecolorOptions
    #: A picture of the size of the photo: white where it is recolored.
    mask: Path | None
    #: Whether a recipe is written beside each output.
    recipe: bool
    max_pixels: int
    #: The file of settings, which must not be overwritten.
    config: Path | None


def run_recolor(
    request: Request, *, device: str | None, backend: str | None, as_json: bool
) -> None:
    """Recolor the photo, write the output files, and print a summary."""
    began = time.perf_counter()
    images, options = request.images, request.options
    masks = [] if request.mask is None else [request.mask]
    beside = recipe_places(request.outputs) if request.recipe else []
    own = [request.config] if request.config else []
    check_apart([*request.outputs, *beside], [*images, *masks, *own])
    places = [check_picture_place(output) for output in request.outputs]
    photo, like = (as_unit(read_picture(path, request.max_pixels)) for path in images)
    mask = None if request.mask is None else _read_mask(request, photo.shape)
    operations = open_backend(device, backend)

    def metadata(folder: Path | None = None) -> dict[str, Any]:
        more = {"mask": picture_entries(masks, folder)} if masks else {}
        entries = picture_entries(images, folder)
        return recipe(options, images=entries, beside=more, device=operations.description)

    with Stages(began) as stages, warnings.catch_warnings():
        warnings.showwarning = partial(note_warning, [])
        stages.count("preparation")
        found = recolored(photo, like, options, mask, operations, stages)
        stages("files", 0.0)
        write = partial(write_picture, found, metadata())
        texts = {
            path: json.dumps(metadata(path.resolve().parent), indent=2) + "\n" for path in beside
        }
        write_together(
            [(*each, write) for each in zip(places, request.outputs, strict=True)], texts
        )
        stages("files", 1.0)
        summary = {
            "outputs": [str(path) for path in request.outputs],
            "size": [photo.shape[1], photo.shape[0]],
            "mean_change": round(float(np.abs(found - photo)[..., :3].mean()), 6),
            "seconds": {name: round(value, 3) for name, value in stages.seconds.items()},
            **metadata(),
        }
    summary["seconds"]["total"] = round(time.perf_counter() - began, 3)
    click.echo(json.dumps(summary) if as_json else _last_line(request, summary))


def _read_mask(request: Request, shape: Sequence[int]) -> Any:
    """Return the mask as an (H, W) array in [0, 1], by luminance and opacity."""
    from clmorph.images.gamut import LUMINANCE

    assert request.mask is not None
    pixels = as_unit(read_picture(request.mask, request.max_pixels))
    if pixels.shape[:2] != tuple(shape[:2]):
        raise FileError(
            f"{request.mask} has {pixels.shape[1]} x {pixels.shape[0]} pixels: expected those of "
            f"{request.images[0]}, {shape[1]} x {shape[0]}"
        )
    gray = pixels[..., :3] @ LUMINANCE
    return np.clip(gray * (pixels[..., 3] if pixels.shape[2] == 4 else 1.0), 0.0, 1.0)


def _last_line(request: Request, summary: dict[str, Any]) -> str:
    """Return the summary of the run for people."""
    names = ", ".join(printable(path) for path in request.outputs)
    width, height = summary["size"]
    return (
        f"{names}: {width} x {height} pixels, colors changed by {255 * summary['mean_change']:.0f} "
        f"of 255 on average, made in {summary['seconds']['total']:.1f} s"
    )
