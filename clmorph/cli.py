"""The command ``clmorph``.

Exit codes: 0 done; 1 a device is out of tolerance, or none is usable (``check``,
``devices``); 2 a mistake in the command line, a file or the choice of device, told
in one line; 130 interrupted.
"""

import math
import os
import re
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from clmorph import __version__
from clmorph.colors import COLOR_SPACES
from clmorph.defaults import N_FRAMES, PRESETS
from clmorph.endpoints import ENDPOINTS
from clmorph.errors import ClmorphError, ConvergenceWarning, InputError
from clmorph.images import MAX_PIXELS
from clmorph.interpolation import UNMATCHED
from clmorph.measures import EXTENTS, MASSES
from clmorph.terminal import NOTES, Stages
from clmorph.widths import SPLATTING

#: Value of ``--reach`` that stands for no creation or destruction of mass.
BALANCED = "balanced"


class _Reach(click.ParamType):
    """A number, or "balanced", or two of them with a comma."""

    name = "number|balanced"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        parts = [self._one(part, param, ctx) for part in str(value).split(",")]
        return parts[0] if len(parts) == 1 else tuple(parts)

    def _one(self, value: str, param: Any, ctx: Any) -> float:
        if value == BALANCED:
            return math.inf
        try:
            number = float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor {BALANCED!r}.", param, ctx)
        if number == math.inf:
            self.fail(f"{value!r}: expected a finite number, or {BALANCED!r}.", param, ctx)
        return number


class _Sigma(click.ParamType):
    """A number, or "auto"."""

    name = "number|auto"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "auto":
            return value
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor 'auto'.", param, ctx)


def _print_version(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if not wanted:
        return
    import platform
    from importlib.metadata import version

    from clmorph.opencl.device import raw_devices

    click.echo(f"clmorph {__version__}")
    libraries = ", ".join(f"{name} {version(name)}" for name in ("pyopencl", "numpy"))
    click.echo(f"Python {platform.python_version()}, {libraries}")
    for index, device in raw_devices():
        driver = f"{device.platform.name.strip()}, driver {device.driver_version.strip()}"
        click.echo(f"[{index}] {' '.join(device.name.split())} ({driver})")
    context.exit()


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Versions of clmorph, of what it builds on, and of the OpenCL drivers.",
)
def cli() -> None:
    """Morph one image into another by unbalanced optimal transport.

    \b
    clmorph demo                            a first look: a sprite becomes a photograph
    clmorph morph a.png b.jpg -o out.gif    your own two pictures
    """  # noqa: D301 (click wants the character itself)


def _device_options(command: Any) -> Any:
    command = click.option(
        "--device", metavar="NAME", help="OpenCL device: an index (0:1) or part of a name."
    )(command)
    return click.option(
        "--backend",
        metavar="NAME",
        help="auto, opencl, numpy, or what --device takes.  [default: auto]",
    )(command)


def _read(path: Path, max_pixels: int) -> Any:
    """Read an image and print what is to be noted."""
    from clmorph.images import read_image

    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        pixels = read_image(path, max_pixels=max_pixels)
    for note in notes:
        NOTES.print(f"note: {note.message}", markup=False)
    return pixels


def _open_backend(device: str | None, backend: str | None) -> Any:
    """Choose the device and say which it is."""
    if device is not None and backend not in (None, "auto", "opencl"):
        raise InputError(f"--device {device} and --backend {backend} contradict: give one of them")
    from clmorph.backends import get_backend

    with NOTES.status("looking for OpenCL devices (the first time takes some seconds)"):
        operations = get_backend(device or backend or "auto")
    NOTES.print(f"device: {operations.description}", markup=False)
    return operations


@cli.command()
@click.argument("image_a", metavar="A", type=click.Path(path_type=Path))
@click.argument("image_b", metavar="B", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="out.gif; out.png for a contact sheet; no ending for a folder of PNG frames.",
)
@click.option("--preset", default="photo", show_default=True, type=click.Choice(list(PRESETS)))
@click.option("--frames", type=int, default=N_FRAMES, show_default=True, help="Number of frames.")
@click.option("--size", type=int, help="Reduce images to this longer side, in pixels.")
@click.option(
    "--max-pixels", type=int, default=MAX_PIXELS, show_default=True, help="Refuse larger files."
)
@click.option("--blur", type=float, help="Entropic length scale, in image sides.")
@click.option(
    "--reach",
    type=_Reach(),
    help="How far mass moves before it rather fades; two (source,target) may differ.",
)
@click.option("--epsilon", type=float, help="The square of blur, in its place.")
@click.option("--rho", type=_Reach(), help="The square of reach, in its place.")
@click.option("--color-weight", type=float, help="Weight of color against position.")
@click.option("--color-space", type=click.Choice(COLOR_SPACES), help="In which colors compare.")
@click.option("--path-space", type=click.Choice(COLOR_SPACES), help="In which colors change.")
@click.option("--mass", type=click.Choice(MASSES), help="What a pixel weighs.")
@click.option(
    "--splatting",
    type=click.Choice(SPLATTING),
    help="Kernel width: the paper's, each particle's own, fixed, or none.",
)
@click.option("--sigma-start", type=_Sigma(), help="Kernel width at the start, in pixels.")
@click.option("--sigma-end", type=_Sigma(), help="Kernel width at the end, in pixels.")
@click.option("--gamma", type=float, help="Its bulge in between (adaptive splatting).")
@click.option("--sigma", type=click.Choice(["optimal"]), help="Find the widths instead; slow.")
@click.option("--endpoints", type=click.Choice(ENDPOINTS), help="Ends as the images, or blurred.")
@click.option("--unmatched", type=click.Choice(UNMATCHED), help="Mass that does not move.")
@click.option("--extent", type=click.Choice(EXTENTS), help="True aspect ratio, or unit square.")
@click.option("--barycentric", is_flag=True, default=None, help="One particle a pixel.")
@click.option("--sample", type=int, help="So many particles a pixel, drawn from the plan.")
@click.option("--seed", type=int, help="Of these draws.")
@click.option("--tol", type=float, help="Residual at which the solver stops, in epsilons.")
@click.option("--max-iter", type=int, help="Iterations after which it stops all the same.")
@_device_options
def morph(
    image_a: Path,
    image_b: Path,
    output: Path,
    preset: str,
    frames: int,
    max_pixels: int,
    device: str | None,
    backend: str | None,
    **options: Any,
) -> None:
    """Morph image A into image B.

    Options that are not given are those of the preset.
    """
    from clmorph.export import output_writer
    from clmorph.images import fit
    from clmorph.morph import check_options
    from clmorph.morph import morph as run

    began = time.perf_counter()
    for path in (image_a, image_b):
        if output.exists() and path.exists() and output.samefile(path):
            raise InputError(f"-o {output} would overwrite an input; choose another name")
    writer = output_writer(output)
    given = {name: value for name, value in options.items() if value is not None}
    parameters: dict[str, Any] = PRESETS[preset] | given
    for name, other in (("blur", "epsilon"), ("reach", "rho")):
        if other in given and name not in given:
            del parameters[name]  # the preset's gives way
    if "gamma" in given:
        if given.get("splatting", "adaptive") != "adaptive":
            raise InputError(
                "--gamma belongs to adaptive splatting, not to "
                f"{given['splatting']!r}: leave one out"
            )
        parameters["splatting"] = "adaptive"
    size = parameters.pop("size")
    check_options(n_frames=frames, **parameters)
    source, target = (fit(_read(path, max_pixels), size) for path in (image_a, image_b))
    operations = _open_backend(device, backend)
    with Stages() as stages, warnings.catch_warnings():
        # Said in the last line.
        warnings.simplefilter("ignore", ConvergenceWarning)
        result = run(source, target, frames, backend=operations, progress=stages, **parameters)
        pictures = []
        for number, picture in enumerate(result.iter_frames()):
            pictures.append(picture)
            stages("frames", (number + 1) / frames)
        writer(pictures, result.times)
    click.echo(
        f"{output}: {len(pictures)} frames in {time.perf_counter() - began:.1f} s, "
        f"{result.potentials.message}"
    )


@cli.command()
@_device_options
def demo(device: str | None, backend: str | None) -> None:
    """Morph a bundled sprite into a photograph: clmorph-demo.gif and clmorph-demo.png."""
    from clmorph.demo import run_demo

    operations = _open_backend(device, backend)
    with Stages() as stages:
        report = run_demo(operations, Path.cwd(), stages)
    for line in report:
        click.echo(line)


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="For programs.")
@click.option("--again", is_flag=True, help="Try every device anew.")
def devices(as_json: bool, again: bool) -> int:
    """List OpenCL devices: which work, why others do not, which one "auto" takes."""
    from clmorph.device_commands import list_devices

    return list_devices(as_json, again)


@cli.command()
@click.option("--device", metavar="NAME", help="The device to check.  [default: auto's]")
@click.option("--all", "every", is_flag=True, help="Check every usable device.")
@click.option("--report", type=click.Path(path_type=Path), help="Write a JSON file to share.")
def check(device: str | None, every: bool, report: Path | None) -> int:
    """Compare a device with NumPy: every operation and one whole morph.

    Ends with 0 if all is within tolerance, else with 1.
    """
    from clmorph.device_commands import check_devices

    if device is not None and every:
        raise InputError(f"--device {device} and --all contradict: give one of them")
    return check_devices(device, every, report)


@cli.command()
@click.option("--device", metavar="NAME", help="The device to tune.  [default: auto's]")
@click.option("--all", "every", is_flag=True, help="Tune every usable device.")
@click.option("--reset", is_flag=True, help="Forget what tuning found.")
def tune(device: str | None, every: bool, reset: bool) -> None:
    """Find the fastest kernel constants for a device, and use them from now on.

    Takes a minute or so, mostly for building kernels; without it they are chosen by the
    kind of device.
    """
    from clmorph.device_commands import tune_devices

    if device is not None and every:
        raise InputError(f"--device {device} and --all contradict: give one of them")
    tune_devices(device, every, reset)


def _in_option_names(message: str) -> str:
    """Name options as they are written on the command line: n_frames=1 becomes --frames 1."""
    options = {parameter.name: parameter.opts[0] for parameter in morph.params}
    options["n_frames"] = "--frames"
    message = message.replace("or None for balanced transport", f"or {BALANCED!r}")
    return re.sub(
        r"\b(\w+)=",
        lambda found: f"{options[found[1]]} " if found[1] in options else found[0],
        message,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    try:
        code = cli.main(arguments, prog_name="clmorph", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help())
        return 2
    except click.ClickException as error:
        message = " ".join(error.format_message().split())
        click.echo(f"clmorph: error: {message} (clmorph --help shows the usage)", err=True)
        return 2
    except ClmorphError as error:
        click.echo(f"clmorph: error: {_in_option_names(str(error))}", err=True)
        return 2
    except MemoryError:
        click.echo("clmorph: error: not enough memory; use a smaller --size", err=True)
        return 2
    except (click.Abort, KeyboardInterrupt):
        click.echo("clmorph: interrupted, nothing was written", err=True)
        return 130
    except OSError as error:
        # Nobody reads on, or nothing more can be written: keep Python from trying at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0
        click.echo(f"clmorph: error: {' '.join(str(error).split())}", err=True)
        return 2
    return code if isinstance(code, int) else 0
