"""The command ``clmorph inspect``: statistics and a picture of the transport, without frames."""

import json
import warnings

import click

from clmorph._shared.printable import printable
from clmorph.analysis.figures import check_plotting, draw_inspection
from clmorph.analysis.inspect import inspect
from clmorph.cli.request import Request
from clmorph.cli.terminal import noted_warnings
from clmorph.errors import ConvergenceWarning


def run_inspect(request: Request) -> None:
    """Print the statistics of a transport, and draw it."""
    for output in request.outputs:
        check_plotting(output)
    request.check_files()
    pictures, maps, guide, _, operations = request.prepared([(0, 1)])
    with request.stages() as stages, noted_warnings():
        # The printed statistics report convergence instead.
        warnings.simplefilter("ignore", ConvergenceWarning)
        found = inspect(
            pictures[0], pictures[1], guide.of(0), backend=operations, labels=maps.labels,
            features=maps.features, progress=stages,
        )  # fmt: skip
        for output in request.outputs:
            stages("picture", 0.0)
            draw_inspection(found, output)
            stages("picture", 1.0)
    if request.as_json:
        click.echo(json.dumps(found.summary()))
        return
    for text in found.lines():
        click.echo(text)
    for output in request.outputs:
        click.echo(f"wrote {printable(click.format_filename(output))}")
