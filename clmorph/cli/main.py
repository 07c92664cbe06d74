"""The command ``clmorph``."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click
from click.core import ParameterSource

from clmorph._shared.options import Options
from clmorph._shared.signals import terminable
from clmorph._shared.version import __version__
from clmorph.cli import config as files
from clmorph.cli import options
from clmorph.cli.more_commands import MORE_COMMANDS
from clmorph.cli.reporting import run
from clmorph.cli.terminal import device_name, note, read_picture
from clmorph.errors import InputError, OptionWarning
from clmorph.images.pixels import MAX_PIXELS
from clmorph.pipeline.maps import AUTO_LABELS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, AUTO_HELP, PRESETS
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recolor_options import RecolorOptions

if TYPE_CHECKING:
    from clmorph.cli.request import Request

#: One line about each preset.
PRESET_LINES = "Presets:\n\n" + "\n\n".join(
    f"{name}: {help}"
    for name, help in ((AUTO, AUTO_HELP), *((name, each.help) for name, each in PRESETS.items()))
)
#: Meanings of the exit codes; the help shows them.
EXIT_CODES = """\
Exit codes: 0: the command has done its work; 1: no device is usable (devices), a device is out of
tolerance (check), or a pair has failed (batch); 2: the command line, a file or the choice of
device has a mistake, which one line reports; 130: interrupted, 143: terminated, 129: hung up.
An interrupted command has written either nothing or all files, as its last line on standard error
says.
"""


def _print_version(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if not wanted:
        return
    import platform
    from importlib.metadata import version

    from clmorph.backends.opencl.devices.find import raw_devices

    click.echo(f"clmorph {__version__}")
    libraries = ", ".join(f"{name} {version(name)}" for name in ("pyopencl", "numpy"))
    click.echo(f"Python {platform.python_version()}, {libraries}")
    for index, device in raw_devices():
        driver = f"{device.platform.name.strip()}, driver {device.driver_version.strip()}"
        click.echo(f"[{index}] {' '.join(device.name.split())} ({driver})")
    context.exit()


@click.group(
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"{PRESET_LINES}\n\n{EXIT_CODES}",
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the versions of clmorph, of its libraries, and of the OpenCL drivers.",
)
def cli() -> None:
    """Morph one picture into another by unbalanced optimal transport.

    \b
    clmorph demo                             a first look: a sprite becomes a photograph
    clmorph morph a.png b.jpg -o out.gif     your own two pictures
    clmorph morph a.png b.jpg -o out.html    a page to play with: scrub, zoom, look inside
    clmorph morph a.png b.jpg c.png d.jpg -o tour.mp4 --loop ping-pong
    clmorph rearrange a.png b.jpg -o out.gif the pixels of one picture form the other one
    clmorph mix a.png b.png c.png d.png -o grid.png   pictures between several pictures
    clmorph recolor a.png b.jpg -o out.png   picture A with the colors of B
    clmorph inspect a.png b.jpg              what would move, how far, how long it takes
    clmorph studio                           a local web page for all of this
    clmorph devices                          what it can run on
    """  # noqa: D301 (click wants the character itself)


def _config_option(command: type[Options] = MorphOptions, **how: Any) -> Callable[[Any], Any]:
    """Return the option --config, whose file is read before any other option is processed."""

    def settings(context: click.Context, parameter: click.Parameter, path: Any) -> Any:
        if path is None:
            return files.NOTHING
        found = files.read_settings(path, command, **how)
        named = {} if found.preset is None else {"preset": found.preset}
        context.default_map = found.own | named
        return found

    return click.option(
        "--config", type=options.InputName(), is_eager=True, callback=settings, panel="Settings",
        help="Read options from a TOML file, or repeat a run from its recipe (.json) or a file "
        "that clmorph wrote; the pictures are searched for beside it and in the current folder.",
    )  # fmt: skip


def _chosen(kind: type[Options], given: Mapping[str, Any]) -> Options:
    """Return the options of the file of settings, replaced by those of the command line."""
    return kind(**given["config"].options).replace(**options.given_options(given, kind))


def _pictures(given: Mapping[str, Any]) -> tuple[Path, ...]:
    """Return the pictures of the command line or, if there are none, of the file of settings."""
    return given["images"] or given["config"].named.paths()


@cli.command(epilog=PRESET_LINES, cls=options.LabeledCommand)
@click.argument("images", metavar="A B [C …]", nargs=-1, type=options.InputName())
@options.film_options
@_config_option()
@click.option(
    "--dump-config", is_flag=True, panel="Settings",
    help="Print all options as TOML, and do nothing else.",
)  # fmt: skip
@options.morph_options
@click.pass_context
def morph(context: click.RichContext, /, **given: Any) -> None:
    """Morph picture A into picture B, and on to C, D and so forth.

    \b
    clmorph morph a.png b.jpg -o out.gif                    a looping GIF
    clmorph morph a.png b.jpg -o out.html                   a page to play with
    clmorph morph a.png b.jpg -o out.mp4 --canvas 1280x720 --ease smooth
    clmorph morph cat.png dog.png -o out.webp --preset pixel-art --loop ping-pong
    clmorph morph a.png b.jpg -o frames --frames 100        a folder of PNG files
    clmorph morph --config out.gif -o again.gif             as that file was made
    clmorph morph a.mp4 b.mp4 -o out.mp4 --duration 2       clips, while both play

    Options that are not given are those of the preset.
    """  # noqa: D301
    from clmorph.cli.morph import run_morph

    config, line = given["config"], options.given_options(given)
    chosen = _chosen_by_preset(context, given, line)
    images, beside = _pictures(given), _beside(given)
    if given["dump_config"]:
        _dump(given, images, beside, **chosen)
        return
    if context.get_parameter_source("output") is ParameterSource.COMMANDLINE and (
        context.get_parameter_source("format") is not ParameterSource.COMMANDLINE
    ):
        given["format"] = None  # the file's format applies only to the output that it names
    request = _request(
        given, images, "morph a.png b.jpg -o out.gif", beside=beside, **chosen,
        # A limit that the user repeats on the command line counts as the user's own.
        capped=not config.named.own and "max_memory" not in line,
        named=frozenset((*line, *config.options)),
    )  # fmt: skip
    run_morph(request, line)


def _dump(
    given: dict[str, Any], images: Sequence[Path], beside: dict[str, Sequence[Path]], **chosen: Any
) -> None:
    """Print all options as TOML."""
    options, options_of = chosen["options"], chosen["options_of"]
    most = given["max_pixels"] or MAX_PIXELS
    if options_of is not None and images and all(path.is_file() for path in images):
        from clmorph.pipeline.prepare import recognized

        options = options_of(recognized(read_picture(path, most) for path in images))
    elif options_of is not None:
        note("these are the options for photographs: name pictures for those that they choose")
    own = {"format": given["format"], "recipe": given["recipe"], "max_pixels": most}
    settings = {name: value for name, value in own.items() if value is not None}
    text = files.as_toml(options.outside() | settings, images, beside)
    # TOML is UTF-8, independent of the terminal's encoding.
    click.echo(text.encode("utf-8"), nl=False)


def _chosen_by_preset(
    context: click.Context, given: dict[str, Any], line: dict[str, Any]
) -> dict[str, Any]:
    """Return `options` and `options_of` of a `Request`; the command line wins over the file."""
    config, preset, draft = given["config"], given["preset"], given["draft"]
    wins = context.get_parameter_source("preset") is ParameterSource.COMMANDLINE

    def options_of(name: str | None) -> MorphOptions:
        return MorphOptions.joined(line, name, config.options, preset_wins=wins, draft=draft)

    # Recipes hold all options, so nothing is left to a preset.
    auto = preset == AUTO or (preset is None and config.named.own)
    return {
        "options": options_of(None if auto else preset),
        "options_of": options_of if auto else None,
    }


def _beside(given: dict[str, Any]) -> dict[str, Sequence[Path]]:
    """Return the files beside the pictures, of the command line or else of the settings."""
    found: dict[str, Sequence[Path]] = {}
    for name in ("labels", "features", "mask", "lut"):
        line, file = given.get(name), given["config"].beside.get(name)
        if line:
            found[name] = (line,) if name in ("mask", "lut") else line
        elif file is not None and file.entries == [AUTO, AUTO]:
            found[name] = AUTO_LABELS
        elif file is not None:
            found[name] = file.paths()
    return found


def _request(
    given: dict[str, Any],
    images: tuple[Path, ...],
    example: str,
    counts: tuple[int, float] = (2, math.inf),
    **more: Any,
) -> "Request":
    """Return the request of a command, whose number of pictures and of outputs is checked."""
    from clmorph.cli.request import Request

    least, most = counts
    if not least <= len(images) <= most:
        number = {least: "one" if least == 1 else "two", math.inf: "two or more"}.get(
            most, f"{least} to {most}"
        )
        pictures = f"{len(images) or 'no'} picture{'s' * (len(images) != 1)}"
        raise InputError(f"{pictures} given: expected {number}, as in clmorph {example}")
    if not given["output"] and " -o " in example:
        name = example.split()[-1]
        raise InputError(f"no output given: expected -o with a name, such as -o {name}")
    config, most_pixels = given["config"], given["max_pixels"]
    return Request(
        images, given["output"], max_pixels=MAX_PIXELS if most_pixels is None else most_pixels,
        format=given.get("format"), recipe=bool(given.get("recipe")),
        config=None if config is files.NOTHING else config.named.file,
        device=device_name(given["device"], given["backend"]), as_json=given["as_json"], **more,
    )  # fmt: skip


@cli.command()
@click.argument("images", metavar="A B [C …]", nargs=-1, type=options.InputName())
@options.file_options
@_config_option(RearrangeOptions)
@options.rearrange_options
def rearrange(**given: Any) -> None:
    """Move the pixels of picture A so that they form picture B, and on to C, D and so forth.

    \b
    clmorph rearrange a.png b.jpg -o out.gif                 every pixel of a.png is kept
    clmorph rearrange a.png b.jpg -o out.mp4 --size 512      larger pictures
    clmorph rearrange a.png b.jpg -o out.gif --color-weight 1  shorter ways, poorer likeness
    """  # noqa: D301
    from clmorph.cli.rearrange import run_rearrange

    chosen = _chosen(RearrangeOptions, given)
    images = _pictures(given)
    run_rearrange(_request(given, images, "rearrange a.png b.jpg -o out.gif", options=chosen))


@cli.command()
@click.argument("images", metavar="PHOTO LIKE", nargs=-1, type=options.InputName())
@options.picture_options
@_config_option(RecolorOptions)
@options.recolor_options
@click.option(
    "--mask", type=options.InputName(), panel="Color",
    help="A picture of the size of PHOTO: white where it is recolored, black where it stays.",
)  # fmt: skip
@click.option(
    "--lut", type=options.FileName(), panel="Color",
    help="A table of colors in place of LIKE: .cube, or a HALD picture.",
)  # fmt: skip
@click.option(
    "--export-lut", type=options.FileName(), multiple=True, panel="Output",
    help="Also write the change of colors as a table for other programs: .cube, or .png for a HALD "
    "picture of 512 x 512 pixels. Can be repeated.",
)  # fmt: skip
@click.option(
    "--lut-size", type=click.Choice(["17", "33", "65"]), panel="Output",
    help="Nodes of a .cube along each axis, by default 33.",
)  # fmt: skip
@options.input_options
def recolor(**given: Any) -> None:
    """Give PHOTO the colors of LIKE; every pixel stays in its place.

    \b
    clmorph recolor a.jpg b.jpg -o out.png                    A with the colors of B
    clmorph recolor a.jpg b.jpg -o out.png --strength 0.6     part of the way
    clmorph recolor a.jpg b.jpg -o out.png --reach 0.3        rare colors stay
    clmorph recolor a.jpg b.jpg -o out.tif --mask sky.png     only where it is white
    clmorph recolor a.jpg b.jpg -o out.png --export-lut look.cube   the change as a table
    clmorph recolor c.jpg --lut look.cube -o out.png          by a table
    """  # noqa: D301
    from clmorph.cli.recolor import run_recolor

    chosen = _chosen(RecolorOptions, given)
    images, beside = _pictures(given), _beside(given)
    export_lut, lut_size = given["export_lut"], given["lut_size"]
    if lut_size is not None and not any(path.suffix.lower() == ".cube" for path in export_lut):
        raise InputError("--lut-size without a table: expected --export-lut look.cube as well")
    if "lut" in beside:
        for name in ("color_space", "blur", "reach", "export_lut", "lut_size"):
            if given[name]:
                raise InputError(
                    f"--{name.replace('_', '-')} and --lut contradict: the table says what becomes "
                    "of each color; give one of them"
                )
        example, count = "recolor photo.jpg --lut look.cube -o out.png", 1
    else:
        example, count = "recolor photo.jpg like.jpg -o out.png", 2
    request = _request(
        given, images, example, (count, count), options=chosen, beside=beside, tables=export_lut
    )
    run_recolor(request, None if lut_size is None else int(lut_size))


@cli.command(epilog=PRESET_LINES)
@click.argument("images", metavar="A B [C …]", nargs=-1, type=options.InputName())
@click.option(
    "--grid", metavar="ROWSxCOLUMNS", panel="Mixes",
    help="Number of mixes along the sides: a row between two pictures (7), a triangle between "
    "three (5), a rectangle between four (5x5), which stand in its corners.  [default: 5]",
)  # fmt: skip
@click.option(
    "--weights", metavar="W,W,…", multiple=True, panel="Mixes",
    help="In place of a grid, one mix: a weight for each picture, such as 2,1,1. Can be repeated.",
)  # fmt: skip
@click.option(
    "--path", metavar="LETTERS", panel="Mixes",
    help="A film in place of a picture: the stops of a path through the mixes, a for the first "
    "picture, b for the second one, and + for the even mix of all, such as ab+dca.",
)  # fmt: skip
@options.film_options
@_config_option(mixes=True)
@options.mix_options
@click.pass_context
def mix(context: click.RichContext, /, **given: Any) -> None:
    """Mix several pictures: a grid of pictures between them, or a film.

    \b
    clmorph mix a.png b.png c.png d.png -o grid.png      25 pictures, yours in the corners
    clmorph mix a.png b.png c.png d.png --grid 7x9 --size 128 -o grid.png
    clmorph mix a.png b.png c.png -o triangle.png        between three: a triangle
    clmorph mix a.png b.png c.png --weights 2,1,1 -o one.png
    clmorph mix a.png b.png c.png d.png --path abdca -o tour.gif

    A picture with a single weight is that picture itself, and one with two is a frame of their
    morph. The presets and most options are those of clmorph morph.
    """  # noqa: D301
    from clmorph.cli.mix import run_mix, weights_of
    from clmorph.pipeline.mixing.weights import MOST_IMAGES

    chosen = _chosen_by_preset(context, given, options.given_options(given))
    images = _pictures(given)
    listed = weights_of(given["weights"], len(images)) if images else None
    what = {"grid": given["grid"], "weights": listed, "path": given["path"]}
    shown = {name: value for name, value in what.items() if value} or dict(given["config"].mixes)
    example = "mix a.png b.png c.png d.png -o grid.png"
    run_mix(_request(given, images, example, (2, MOST_IMAGES), shown=shown, **chosen))


@cli.command(epilog=PRESET_LINES, cls=options.LabeledCommand)
@click.argument("images", metavar="A B", nargs=-1, type=options.InputName())
@click.option(
    "-o", "--output", type=options.OutputName(), panel="File",
    help="Draw a picture too: .png, .svg or .pdf.",
)  # fmt: skip
@options.inspect_options
@click.pass_context
def inspect(context: click.RichContext, /, **given: Any) -> None:
    """Show what a morph would move: how far, how much, how well; how long it would take.

    \b
    clmorph inspect a.png b.jpg                  numbers
    clmorph inspect a.png b.jpg -o report.png    and a picture of where everything goes
    """  # noqa: D301
    from clmorph.cli.inspect import run_inspect

    given |= {"config": files.NOTHING, "draft": False}
    given["output"] = () if given["output"] is None else (given["output"],)
    chosen = _chosen_by_preset(context, given, options.given_options(given))
    example, beside = "inspect a.png b.jpg", _beside(given)
    run_inspect(_request(given, given["images"], example, (2, 2), beside=beside, **chosen))


def _note(told: set[str], message: Warning | str, *others: Any, **more: Any) -> None:
    """Print a warning as a note, once; else the signature is that of `warnings.showwarning`."""
    if str(message) not in told:
        told.add(str(message))
        note(options.in_option_names(str(message)))


for command in MORE_COMMANDS:
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    names = {str(parameter.name): parameter.opts[-1] for parameter in (*morph.params, *mix.params)}
    with terminable() as ending, warnings.catch_warnings():
        warnings.simplefilter("always", OptionWarning)
        warnings.showwarning = partial(_note, set())
        return run(cli, arguments, names | options.NAMES, ending)
