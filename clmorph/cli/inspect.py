"""``clmorph inspect``: a look at the transport alone."""

import json
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from clmorph._shared.files import check_apart
from clmorph._shared.printable import printable
from clmorph.analysis.figures import check_plotting, draw_inspection
from clmorph.analysis.inspect import inspect
from clmorph.cli.common import note_warning, open_backend, read_picture
from clmorph.cli.config import Settings, layered, preset
from clmorph.cli.options import for_library
from clmorph.cli.terminal import Stages
from clmorph.errors import ConvergenceWarning
from clmorph.images.pixels import MAX_PIXELS, fit

#: Settings of a preset that decide about the transport.
TRANSPORT = (
    "blur", "reach", "epsilon", "rho", "color_weight", "color_space", "mass", "extent", "tol",
    "max_iter", "solve_size", "max_particles", "max_memory", "log_threshold",
)  # fmt: skip


def run_inspect(
    images: Sequence[Path],
    output: Path | None,
    chosen: str,
    given: Settings,
    *,
    n_frames: int,
    max_pixels: int | None,
    device: str | None,
    backend: str | None,
    as_json: bool,
) -> None:
    """Solve the transport between two pictures, print its numbers, and draw it if asked to.

    Parameters
    ----------
    images : (A, B)
    output : Path, optional
        Of the picture: .png, .svg or .pdf.
    chosen : str
        A preset.
    given : dict
        Options of the transport, in place of the preset's.
    n_frames : int
        For how many frames time is estimated.
    max_pixels, device, backend, as_json
        As for ``clmorph morph``.
    """
    if output is not None:
        check_plotting(output)
        check_apart([output], images)
    settings = layered((preset(chosen), given))
    size = settings.get("size")
    options = for_library({name: settings[name] for name in TRANSPORT if name in settings})
    most = MAX_PIXELS if max_pixels is None else max_pixels
    pictures = [read_picture(path, most) for path in images]
    if size is not None:
        pictures = [fit(picture, size) for picture in pictures]
    operations = open_backend(device, backend)
    with Stages() as stages, warnings.catch_warnings():
        # Said among the numbers.
        warnings.simplefilter("ignore", ConvergenceWarning)
        warnings.showwarning = partial(note_warning, [])
        found = inspect(
            *pictures, n_frames=n_frames, backend=operations, progress=stages, **options
        )
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
