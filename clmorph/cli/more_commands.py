"""The commands for many pairs, for the page, for ComfyUI, and for devices."""

from pathlib import Path
from typing import Any

import rich_click as click

from clmorph.cli import options
from clmorph.cli.terminal import Stages, device_name, open_backend, say
from clmorph.errors import InputError
from clmorph.pipeline.presets import AUTO, PRESETS

#: Shells for which completion is supported.
SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("jobs", metavar="[JOBS]", required=False)
@click.option(
    "-o", "--out", metavar="FOLDER", required=True, panel="File",
    help="Folder of the outputs, the journal and the index; may be any that fsspec opens.",
)  # fmt: skip
@click.option(
    "--all-pairs", metavar="FOLDER", panel="File",
    help="Morph each picture of a folder into each later one, in the order of names.",
)  # fmt: skip
@click.option(
    "--chain", metavar="FOLDER", panel="File",
    help="Morph each picture of a folder into the next one.",
)  # fmt: skip
@click.option(
    "--ending", metavar="TEXT", default=".gif", show_default=True, panel="File",
    help="Ending of the outputs of --all-pairs and --chain.",
)  # fmt: skip
@click.option(
    "--redo", is_flag=True, panel="File",
    help="Make outputs again that were made with other options, pictures or devices.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, panel="File", help="Print the result as JSON.")
@click.option(
    "--config", type=options.FileName(), panel="Settings",
    help="Options of all pairs, from a TOML file or a recipe; options of a row take precedence.",
)  # fmt: skip
@click.option(
    "--preset", type=click.Choice([AUTO, *PRESETS]), panel="Settings",
    help="Preset of pairs that name none.  [default: auto, for each pair by itself]",
)  # fmt: skip
@click.option(
    "--scheduler", metavar="ADDRESS", panel="Workers",
    help="A running scheduler of Dask, such as tcp://host:8786, in place of local workers.",
)  # fmt: skip
@click.option(
    "--workers", type=click.IntRange(1, 256), panel="Workers",
    help="Number of local workers.  [default: one for each physical device]",
)  # fmt: skip
@click.option(
    "--memory", metavar="SIZE", panel="Workers",
    help="Memory of a local worker, such as 4GB; one that takes more is started again, and its "
    "pair fails.  [default: equal shares]",
)  # fmt: skip
@options.input_options
def batch(**given: Any) -> int:
    """Morph thousands of pairs on the workers of Dask (extra "dask").

    \b
    clmorph batch jobs.csv -o folder           columns source, target, output, and any option
    clmorph batch jobs.json -o folder          a list of objects with these keys
    clmorph batch --all-pairs pictures -o folder
    clmorph batch --chain pictures -o folder --ending .webp

    Started again, it does only what is missing. Exit code 1: some pairs have failed.
    """  # noqa: D301
    from clmorph.cli.batch import run_batch

    return run_batch(given)


@click.command()
@click.option(
    "--host", metavar="ADDRESS", default="127.0.0.1", show_default=True,
    help="Address to listen on; from other machines the page needs the token that is printed.",
)  # fmt: skip
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Port to listen on; 0: a free one.  [default: 8017, or a free one]",
)
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser.")
@options.device_options
def studio(
    host: str, port: int | None, browser: bool, device: str | None, backend: str | None
) -> None:
    """Open a local web page that does the work of these commands (extra "studio").

    \b
    clmorph studio                       http://127.0.0.1:8017/, for this machine alone
    clmorph studio --port 0 --no-browser
    """  # noqa: D301
    from clmorph.cli.demo import write_samples
    from clmorph.cli.reporting import line_of
    from clmorph.studio.serve import serve

    serve(
        host, port, device=device_name(device, backend), browser=browser, samples=write_samples,
        line_of=line_of, say=say,
    )  # fmt: skip


@click.command()
@click.argument("folder", metavar="PATH_TO_COMFYUI", type=options.FileName())
def comfyui(folder: Path) -> None:
    """Add clmorph's nodes to ComfyUI, by a folder in its custom_nodes.

    \b
    clmorph comfyui ~/ComfyUI

    The Python that runs ComfyUI needs clmorph too: pip install clmorph there.
    """  # noqa: D301
    from clmorph._shared.printable import printable
    from clmorph.adapters.comfyui.install import install_nodes

    file = install_nodes(folder)
    click.echo(f"wrote {printable(file)}: start ComfyUI again, and search its nodes for clmorph")


@click.command()
@options.device_options
def demo(device: str | None, backend: str | None) -> None:
    """Morph a bundled sprite into a photograph: clmorph-demo.gif, .html and .png."""
    from clmorph.cli.demo import run_demo

    operations = open_backend(device_name(device, backend))
    with Stages() as stages:
        report = run_demo(operations, Path.cwd(), stages)
    for line in report:
        click.echo(line)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the list for programs, as JSON.")
@click.option("--again", is_flag=True, help="Try every device anew, and forget what is remembered.")
def devices(as_json: bool, again: bool) -> int:
    """List OpenCL devices: which work, why others do not, which one "auto" takes.

    A device that is new is tried in two processes of its own: the programs that most morphs use are
    built and compared with NumPy, each within 60 s or what CLMORPH_PROBE_SECONDS says (1 to 3600).
    What the trial says of the device is remembered: that it works, that it crashes, computes
    wrong results or is refused. What it says of the moment is not (a lack of time or of memory):
    the device is tried again the next time. "auto" tries devices only up to the first that works.
    """
    from clmorph.cli.devices import list_devices

    return list_devices(as_json, again)


@click.command()
@click.option("--device", metavar="NAME", help="The device to check.  [default: auto's]")
@click.option("--all", "every", is_flag=True, help="Check every usable device.")
@click.option(
    "--kernel",
    "kernels",
    metavar="NAME",
    multiple=True,
    help="Check only operations that use this kernel or kernel file. Can be repeated.",
)
@click.option("--report", type=options.FileName(), help="Write a JSON file to share.")
def check(device: str | None, every: bool, kernels: tuple[str, ...], report: Path | None) -> int:
    """Compare a device with NumPy: every operation and one whole morph.

    Ends with 0 if all is within tolerance, else with 1. A device that fails is unusable from then
    on. With --device it can be checked again, and is tried anew once it passes.
    """
    from clmorph.cli.devices import check_devices

    if device is not None and every:
        raise InputError(f"--device {device} and --all contradict: give one of them")
    return check_devices(device, every, report, kernels)


@click.command()
@click.option("--device", metavar="NAME", help="The device to tune.  [default: auto's]")
@click.option("--all", "every", is_flag=True, help="Tune every usable device.")
@click.option("--reset", is_flag=True, help="Forget what tuning found.")
def tune(device: str | None, every: bool, reset: bool) -> None:
    """Find the fastest kernel constants for a device, and use them from now on.

    Takes a minute or so, mostly for building kernels; without it they are chosen by the
    kind of device.
    """
    from clmorph.cli.devices import tune_devices

    if device is not None and every:
        raise InputError(f"--device {device} and --all contradict: give one of them")
    tune_devices(device, every, reset)


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.RichContext, /, shell: str) -> None:
    """Print a script by which a shell completes commands and options.

    \b
    bash:  eval "$(clmorph completion bash)"           in ~/.bashrc
    zsh:   eval "$(clmorph completion zsh)"            in ~/.zshrc
    fish:  clmorph completion fish > ~/.config/fish/completions/clmorph.fish
    """  # noqa: D301
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None  # click has all of SHELLS
    root = context.find_root().command
    click.echo(kind(root, {}, "clmorph", "_CLMORPH_COMPLETE").source())


#: The commands of this module, in the order of the help.
MORE_COMMANDS = batch, studio, comfyui, demo, devices, check, tune, completion
