"""The command ``clmorph mix``: pictures between several pictures, as a grid or as a film."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click

from clmorph._shared.files import check_apart
from clmorph._shared.printable import printable
from clmorph.cli import config as files
from clmorph.cli.common import (
    chosen_preset,
    found_guides,
    note_thin,
    open_backend,
    read_picture,
    recipe_places,
)
from clmorph.cli.terminal import Stages, say
from clmorph.errors import InputError
from clmorph.output.save import Output
from clmorph.pipeline.maps import NO_MAPS
from clmorph.pipeline.mixing.mix import check_images, mixes_of
from clmorph.pipeline.mixing.mixes import pairs_of
from clmorph.pipeline.mixing.weights import (
    MOST_IMAGES,
    check_mix_weights,
    grid_layout,
    grid_sides,
    path_weights,
)
from clmorph.pipeline.mixing.writing import check_outputs, write_film, write_sheet
from clmorph.pipeline.options import MorphOptions, preset_options
from clmorph.pipeline.prepare import recognized
from clmorph.pipeline.presets import AUTO, drafted
from clmorph.pipeline.recipe import picture_entries, recipe


@dataclass(frozen=True)
class Request:
    """The request of the command line."""

    images: Sequence[Path]
    outputs: Sequence[Path]
    #: Options of the command line, by their names in Python.
    given: dict[str, Any]
    preset: str | None
    draft: bool
    #: At most one of "grid" (the number of mixes along a side, or rows x columns, such as "5x5"),
    #: "weights" (of each mix), "path" (letters) and "stops" (weights), see
    #: `clmorph.pipeline.mixing.weights`.
    shown: dict[str, Any]
    #: The output format, in place of the format of the output's ending.
    format: str | None
    #: Whether a recipe is written beside each output.
    recipe: bool
    max_pixels: int
    #: The file of settings.
    config: files.Found | None = None
    #: Whether the preset replaces options of the file, because the command line names it.
    preset_wins: bool = False


def run_mix(request: Request, *, device: str | None, backend: str | None, as_json: bool) -> None:
    """Mix pictures, write the output files, and print a summary (`as_json`: for programs)."""
    began = time.perf_counter()
    images = request.images
    count = len(images)
    if not 2 <= count <= MOST_IMAGES:
        raise InputError(
            f"{count or 'no'} picture{'s' * (count != 1)} given: expected 2 to {MOST_IMAGES}, as "
            "in clmorph mix a.png b.png c.png d.png -o grid.png"
        )
    if not request.outputs:
        raise InputError("no output given: expected -o with a name, such as -o grid.png")
    shown = request.shown
    if len(shown) > 1:
        first, second = list(shown)[:2]
        raise InputError(f"--{first} and --{second} contradict: give one of them")
    route = shown.get("path", shown.get("stops"))
    stops = None if route is None else path_weights(route, count)
    weights = check_mix_weights(shown["weights"], count) if "weights" in shown else stops
    grid = grid_sides("--grid", shown["grid"]) if "grid" in shown else None
    if weights is None:
        grid_layout(count, grid)  # raises an error before pictures are read
    places = [Output(output, request.format) for output in request.outputs]
    beside = recipe_places(request.outputs) if request.recipe else []
    own = [] if request.config is None else [request.config.named.file]
    check_apart([*request.outputs, *beside], [*images, *own])
    n_stops = 0 if stops is None else len(stops)
    options_of = partial(_options, request)
    check_outputs(places, n_stops, options_of(request.preset))
    pictures = check_images([read_picture(path, request.max_pixels) for path in images])
    preset = request.preset
    if preset == AUTO:
        preset = recognized(pictures)
    chosen = options_of(preset)
    if request.preset == AUTO:
        say(chosen_preset(str(preset), chosen))
    note_thin(images, pictures, chosen)
    guide = found_guides(pictures, pairs_of(count), chosen, NO_MAPS)
    chosen = guide.options
    operations = open_backend(device, backend)

    def metadata(folder: Path | None = None) -> dict[str, Any]:
        return recipe(
            chosen, images=picture_entries(images, folder), device=operations.description,
            mixes=shown,
        )  # fmt: skip

    with Stages(began) as stages:
        stages.count("preparation")
        mixes = mixes_of(
            pictures, weights, chosen, grid=grid, preset=None, draft=False, backend=operations,
            progress=stages, given={},
        )  # fmt: skip
        texts = {
            path: json.dumps(metadata(path.resolve().parent), indent=2) + "\n" for path in beside
        }
        summary: dict[str, Any] = {
            "outputs": [{"path": str(each.path), "format": each.name} for each in places],
            "mixes": len(mixes),
            "preset": preset,
            "found": guide.found,
        }
        if stops is None:
            write_sheet(places, mixes.sheet(chosen.background), metadata(), texts)
        else:
            legs = mixes.path(list(stops))
            frames, seconds = write_film(
                places, legs, chosen, mixes.pixelated, metadata(), texts, stages
            )
            summary |= {"frames": frames, "duration": round(seconds, 6)}
        summary |= {
            "seconds": {name: round(value, 3) for name, value in stages.seconds.items()},
            **metadata(),
        }
    summary["seconds"]["total"] = round(time.perf_counter() - began, 3)
    click.echo(json.dumps(summary) if as_json else _last_line(places, summary))


def _options(request: Request, preset: str | None) -> MorphOptions:
    """Join the file of settings, a preset and the command line; the command line wins.

    Recipes hold all options, so with one of them the preset is None.
    """
    layers = [] if request.config is None else [request.config.options]
    if preset is not None:
        usual = preset_options(None if preset == AUTO else preset)
        layers = [*layers, usual] if request.preset_wins else [usual, *layers]
    below = MorphOptions.layered(layers)
    if request.draft:
        below |= drafted(below)
    return MorphOptions(**MorphOptions.layered((below, request.given)))


def weights_of(texts: Sequence[str], count: int) -> list[list[float]]:
    """Return the weights of each mix from texts such as 1,2,1 of `count` numbers each."""
    found = []
    for text in texts:
        try:
            found.append([float(part) for part in text.split(",")])
        except ValueError:
            found.append([])
        if len(found[-1]) != count:
            raise InputError(
                f"--weights {printable(text, 40)}: expected {count} numbers with commas, one for "
                "each picture, such as " + ",".join("1" * count)
            )
    return found


def _last_line(places: Sequence[Output], summary: dict[str, Any]) -> str:
    """Return the summary of the run for people."""
    names = ", ".join(printable(place.path) for place in places)
    number = summary.get("frames")
    what = f"{summary['mixes']} mixes" if number is None else f"{number} frames"
    if number is not None and any(place.format.animated for place in places):
        what += f", {summary['duration']:.3g} s a round"
    return f"{names}: {what}, made in {summary['seconds']['total']:.1f} s"
