"""The command ``clmorph inspect``: statistics and a picture of the transport, without frames."""

import json
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from clmorph._shared.files import check_apart
from clmorph._shared.printable import printable
from clmorph.analysis.figures import check_plotting, draw_inspection
from clmorph.analysis.inspect import inspect
from clmorph.cli.common import note_warning, open_backend, read_picture
from clmorph.cli.terminal import Stages
from clmorph.errors import ConvergenceWarning
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import as_images, as_options
from clmorph.pipeline.presets import AUTO


def run_inspect(
    images: Sequence[Path],
    output: Path | None,
    preset: str | None,
    given: dict[str, Any],
    *,
    max_pixels: int,
    device: str | None,
    backend: str | None,
    as_json: bool,
) -> None:
    """Solve the transport between two pictures, print its statistics, and optionally draw it.

    Parameters
    ----------
    images : (A, B)
    output : Path, optional
        Path of the drawing: .png, .svg or .pdf.
    preset : str, optional
    given : dict
        Options by their names in Python.
    max_pixels, device, backend, as_json
        As for ``clmorph morph``.
    """
    if preset not in (None, AUTO):
        MorphOptions(preset=preset, **given)  # raises an error before the pictures are read
    if output is not None:
        check_plotting(output)
        check_apart([output], images)
    pictures = [read_picture(path, max_pixels) for path in images]
    options = as_options(None, preset, False, given, as_images(pictures))
    operations = open_backend(device, backend)
    with Stages() as stages, warnings.catch_warnings():
        # The printed statistics report convergence instead.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.showwarning = partial(note_warning, [])
        found = inspect(pictures[0], pictures[1], options, backend=operations, progress=stages)
        if output is not None:
            stages("picture", 0.0)
            draw_inspection(found, output)
            stages("picture", 1.0)
    if as_json:
        click.echo(json.dumps(found.summary()))
        return
    for line in found.lines():
        click.echo(line)
    if output is not None:
        click.echo(f"wrote {printable(click.format_filename(output))}")
