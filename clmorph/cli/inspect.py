"""The command ``clmorph inspect``: statistics and a picture of the transport, without frames."""

import json
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from clmorph._shared.files import check_apart
from clmorph._shared.printable import printable
from clmorph.analysis.figures import check_plotting, draw_inspection
from clmorph.analysis.inspect import inspect
from clmorph.cli.common import (
    chosen_preset,
    found_guides,
    found_labels,
    note_thin,
    note_warning,
    open_backend,
    read_beside,
    read_picture,
)
from clmorph.cli.terminal import Stages, say
from clmorph.errors import ConvergenceWarning
from clmorph.images.pixels import MAX_PIXELS
from clmorph.pipeline.maps import AUTO_LABELS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import as_images, recognized
from clmorph.pipeline.presets import AUTO


def run_inspect(images: Sequence[Path], line: Mapping[str, Any], given: dict[str, Any]) -> None:
    """Print the statistics of a transport, and draw it; `given` are the options in `line`."""
    output, preset = line["output"], line["preset"]
    labels, features = line["labels"] or (), line["features"] or ()
    max_pixels = MAX_PIXELS if line["max_pixels"] is None else line["max_pixels"]
    auto = preset is None or preset == AUTO
    options = MorphOptions(preset=None if auto else preset, **given)
    if output is not None:
        check_plotting(output)
        files = () if tuple(labels) == AUTO_LABELS else labels
        check_apart([output], [*images, *files, *features])
    pictures = [read_picture(path, max_pixels) for path in images]
    maps = read_beside(labels, features, max_pixels)
    operations = open_backend(line["device"], line["backend"])
    if auto:
        preset = recognized(as_images(pictures))
        options = MorphOptions(preset=preset, **given)
        say(chosen_preset(preset, options))
    note_thin(images, pictures, options)
    maps = found_labels(as_images(pictures), maps)
    options = found_guides(as_images(pictures), [(0, 1)], options, maps).of(0)
    with Stages() as stages, warnings.catch_warnings():
        # The printed statistics report convergence instead.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.showwarning = partial(note_warning, [])
        found = inspect(
            pictures[0], pictures[1], options, backend=operations, labels=maps.labels,
            features=maps.features, progress=stages,
        )  # fmt: skip
        if output is not None:
            stages("picture", 0.0)
            draw_inspection(found, output)
            stages("picture", 1.0)
    if line["as_json"]:
        click.echo(json.dumps(found.summary()))
        return
    for text in found.lines():
        click.echo(text)
    if output is not None:
        click.echo(f"wrote {printable(click.format_filename(output))}")
