"""The command ``clmorph``."""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import rich_click as click
from click.core import ParameterSource

from clmorph._shared.signals import terminable
from clmorph._shared.version import __version__
from clmorph.cli import config as files
from clmorph.cli import options
from clmorph.cli.reporting import run
from clmorph.errors import InputError, OptionWarning
from clmorph.images.pixels import MAX_PIXELS
from clmorph.pipeline.maps import AUTO_LABELS
from clmorph.pipeline.options import MorphOptions, preset_options
from clmorph.pipeline.presets import AUTO, AUTO_HELP, PRESETS, drafted

#: Shells for which completion is supported.
SHELLS = ("bash", "zsh", "fish")
#: Meanings of the exit codes; the help shows them.
EXIT_CODES = """\
Exit codes: 0 done; 1 no device is usable (devices), one is out of tolerance (check), or a pair
has failed (batch);
2 a mistake in the command line, in a file or in the choice of device, reported in one line;
130 interrupted, 143 terminated (129 at a hangup): either nothing was written or all files
were, as the last line on standard error says.
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


#: One line about each preset.
_PRESETS = "Presets:\n\n" + "\n\n".join(
    f"{name}: {help}"
    for name, help in ((AUTO, AUTO_HELP), *((name, each.help) for name, each in PRESETS.items()))
)


@click.group(
    context_settings={"help_option_names": ["-h", "--help"]}, epilog=f"{_PRESETS}\n\n{EXIT_CODES}"
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Versions of clmorph, of what it builds on, and of the OpenCL drivers.",
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


Reader = Callable[[Path], files.Found]


def _config_option(read: Reader, *, preset: bool = False) -> Callable[[Any], Any]:
    """Return the option --config, whose file is read before any other option is processed.

    With `preset` the preset that the file names stands for that of the command line.
    """

    def settings(context: click.Context, parameter: click.Parameter, path: Any) -> Any:
        if path is None:
            return None
        found = read(path)
        named = {"preset": found.preset} if preset and found.preset is not None else {}
        context.default_map = found.own | named
        return found

    return click.option(
        "--config", type=options.FileName(), is_eager=True, callback=settings, panel="Settings",
        help="Read options from your own TOML, or repeat a recipe: .json, or a file that clmorph "
        "wrote; its pictures are sought beside it and in the current folder.",
    )  # fmt: skip


def _rearrange_settings(path: Path) -> files.Found:
    from clmorph.pipeline.rearrange_options import RearrangeOptions

    return files.read_settings(path, RearrangeOptions)


def _recolor_settings(path: Path) -> files.Found:
    from clmorph.pipeline.recolor_options import RecolorOptions

    return files.read_settings(path, RecolorOptions)


def _pictures(images: tuple[Path, ...], config: files.Found | None) -> tuple[Path, ...]:
    """Return the pictures of the command line or, if there are none, of the file of settings."""
    from clmorph.cli.morph import announce_changes

    if config is None or images:
        return images
    named = config.named.images()
    announce_changes(named)
    return tuple(path for path, _ in named)


@cli.command(epilog=_PRESETS, cls=options.LabeledCommand)
@click.argument("images", metavar="A B [C …]", nargs=-1, type=options.FileName())
@options.file_options
@options.preset_option
@options.draft_option
@_config_option(files.read_settings, preset=True)
@click.option(
    "--dump-config", is_flag=True, panel="Settings",
    help="Print all options as TOML, and do nothing else.",
)  # fmt: skip
@options.json_option
@options.morph_options
@options.map_options
@options.max_pixels_option
@options.device_options
@click.pass_context
def morph(
    context: click.RichContext,
    /,
    images: tuple[Path, ...],
    output: tuple[Path, ...],
    preset: str | None,
    draft: bool,
    config: files.Found | None,
    dump_config: bool,
    as_json: bool,
    device: str | None,
    backend: str | None,
    format: str | None,
    recipe: bool | None,
    labels: tuple[Path, ...] | None,
    features: tuple[Path, ...] | None,
    max_pixels: int | None,
    **given: Any,
) -> None:
    """Morph picture A into picture B, and on to C, D and so forth.

    \b
    clmorph morph a.png b.jpg -o out.gif                    a looping GIF
    clmorph morph a.png b.jpg -o out.html                   a page to play with
    clmorph morph a.png b.jpg -o out.mp4 --canvas 1280x720 --ease smooth
    clmorph morph cat.png dog.png -o out.webp --preset pixel-art --loop ping-pong
    clmorph morph a.png b.jpg -o frames --frames 100        a folder of PNG files
    clmorph morph --config out.gif -o again.gif             as that file was made

    Options that are not given are those of the preset.
    """  # noqa: D301
    from clmorph.cli.morph import Request, announce_changes, announce_idle, run_morph

    line = options.given_options(given)
    options_of = _options(context, draft, config, line)
    # Recipes hold all options, so nothing is left to a preset.
    foreign = config is not None and not config.named.own
    auto = preset == AUTO or (preset is None and not foreign)
    chosen = options_of(None if auto else preset)
    images = _pictures(images, config)
    beside = {"labels": labels or (), "features": features or ()}
    if config is not None:
        for name, files_of in config.beside.items():
            if not beside[name] and files_of.entries == [AUTO, AUTO]:
                beside[name] = AUTO_LABELS
            elif not beside[name]:
                named = files_of.images()
                beside[name] = tuple(path for path, _ in named)
                announce_changes(named)
    if context.get_parameter_source("output") is ParameterSource.COMMANDLINE and (
        context.get_parameter_source("format") is not ParameterSource.COMMANDLINE
    ):
        format = None  # the file's format applies only to the output that the file names
    most = MAX_PIXELS if max_pixels is None else max_pixels
    if dump_config:
        if auto and images and all(path.is_file() for path in images):
            from clmorph.cli.common import read_picture
            from clmorph.pipeline.prepare import as_images, recognized

            pictures = as_images([read_picture(path, most) for path in images])
            chosen = options_of(recognized(pictures))
        elif auto:
            from clmorph.cli.terminal import note

            note("these are the options for photographs: name pictures for those that they choose")
        own = {"format": format, "recipe": recipe, "max_pixels": most}
        settings = {name: value for name, value in own.items() if value is not None}
        # TOML is UTF-8, independent of the terminal's encoding.
        click.echo(
            files.as_toml(chosen.outside() | settings, images, beside).encode("utf-8"), nl=False
        )
        return
    if len(images) < 2:
        raise InputError(
            f"{_counted(images)}: expected two or more, as in clmorph morph a.png b.jpg -o out.gif"
        )
    if not output:
        raise InputError("no output given: expected -o with a name, such as -o out.gif")
    announce_idle(list(line), output, format)
    # A limit that the user repeats on the command line counts as the user's own.
    run_morph(
        Request(
            images, output, chosen, options_of if auto else None, format=format,
            recipe=bool(recipe), max_pixels=most, **beside,
            config=None if config is None else config.named.file,
            capped=foreign and "max_memory" not in line,
        ),
        device=device, backend=backend, as_json=as_json,
    )  # fmt: skip


def _options(
    context: click.Context,
    draft: bool,
    config: files.Found | None,
    line: dict[str, Any],
) -> Callable[[str | None], MorphOptions]:
    """Join a preset, the file of settings and the command line; the command line wins.

    The result is a function of the preset's name.
    """
    file = {} if config is None else config.options
    given = context.get_parameter_source("preset") is ParameterSource.COMMANDLINE

    def options_of(name: str | None) -> MorphOptions:
        chosen = preset_options(name)
        below = MorphOptions.layered((file, chosen) if given else (chosen, file))
        if draft:
            below |= drafted(below)
        return MorphOptions(**MorphOptions.layered((below, line)))

    return options_of


def _counted(images: Sequence[Path]) -> str:
    """Return the number of given pictures as the beginning of a message."""
    return f"{len(images) or 'no'} picture{'s' * (len(images) != 1)} given"


@cli.command()
@click.argument("images", metavar="A B [C …]", nargs=-1, type=options.FileName())
@options.file_options
@_config_option(_rearrange_settings)
@options.json_option
@options.rearrange_options
@options.max_pixels_option
@options.device_options
def rearrange(
    images: tuple[Path, ...],
    output: tuple[Path, ...],
    config: files.Found | None,
    as_json: bool,
    device: str | None,
    backend: str | None,
    format: str | None,
    recipe: bool | None,
    max_pixels: int | None,
    **given: Any,
) -> None:
    """Move the pixels of picture A so that they form picture B, and on to C, D and so forth.

    \b
    clmorph rearrange a.png b.jpg -o out.gif                 every pixel of a.png is kept
    clmorph rearrange a.png b.jpg -o out.mp4 --size 512      larger pictures
    clmorph rearrange a.png b.jpg -o out.gif --color-weight 1  shorter ways, poorer likeness
    """  # noqa: D301
    from clmorph.cli.rearrange import Request, run_rearrange
    from clmorph.pipeline.rearrange_options import RearrangeOptions

    chosen = RearrangeOptions(**({} if config is None else config.options)).replace(
        **options.given_options(given, RearrangeOptions)
    )
    images = _pictures(images, config)
    if len(images) < 2:
        raise InputError(
            f"{_counted(images)}: expected two or more, as in clmorph rearrange a.png b.jpg -o "
            "out.gif"
        )
    if not output:
        raise InputError("no output given: expected -o with a name, such as -o out.gif")
    run_rearrange(
        Request(
            images, output, chosen, format, bool(recipe),
            MAX_PIXELS if max_pixels is None else max_pixels,
            None if config is None else config.named.file,
        ),
        device=device, backend=backend, as_json=as_json,
    )  # fmt: skip


@cli.command()
@click.argument("images", metavar="PHOTO LIKE", nargs=-1, type=options.FileName())
@options.picture_options
@_config_option(_recolor_settings)
@options.json_option
@options.recolor_options
@click.option(
    "--mask", type=options.FileName(), panel="Color",
    help="A picture of the size of PHOTO: white where it is recolored, black where it stays.",
)  # fmt: skip
@options.max_pixels_option
@options.device_options
def recolor(
    images: tuple[Path, ...],
    output: tuple[Path, ...],
    config: files.Found | None,
    as_json: bool,
    device: str | None,
    backend: str | None,
    recipe: bool | None,
    mask: Path | None,
    max_pixels: int | None,
    **given: Any,
) -> None:
    """Give PHOTO the colors of LIKE; every pixel stays in its place.

    \b
    clmorph recolor a.jpg b.jpg -o out.png                    A with the colors of B
    clmorph recolor a.jpg b.jpg -o out.png --strength 0.6     part of the way
    clmorph recolor a.jpg b.jpg -o out.png --reach 0.3        rare colors stay
    clmorph recolor a.jpg b.jpg -o out.tif --mask sky.png     only where it is white
    """  # noqa: D301
    from clmorph.cli.morph import announce_changes
    from clmorph.cli.recolor import Request, run_recolor
    from clmorph.pipeline.recolor_options import RecolorOptions

    chosen = RecolorOptions(**({} if config is None else config.options)).replace(
        **options.given_options(given, RecolorOptions)
    )
    images = _pictures(images, config)
    if config is not None and mask is None and "mask" in config.beside:
        named = config.beside["mask"].images()
        mask = named[0][0]
        announce_changes(named)
    if len(images) != 2:
        raise InputError(
            f"{_counted(images)}: expected two, as in clmorph recolor photo.jpg like.jpg -o out.png"
        )
    if not output:
        raise InputError("no output given: expected -o with a name, such as -o out.png")
    run_recolor(
        Request(
            images, output, chosen, mask, bool(recipe),
            MAX_PIXELS if max_pixels is None else max_pixels,
            None if config is None else config.named.file,
        ),
        device=device, backend=backend, as_json=as_json,
    )  # fmt: skip


@cli.command(epilog=_PRESETS)
@click.argument("images", metavar="A B [C …]", nargs=-1, type=options.FileName())
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
@options.file_options
@options.preset_option
@options.draft_option
@_config_option(partial(files.read_settings, mixes=True))
@options.json_option
@options.mix_options
@options.max_pixels_option
@options.device_options
def mix(
    images: tuple[Path, ...],
    grid: str | None,
    weights: tuple[str, ...],
    path: str | None,
    output: tuple[Path, ...],
    preset: str | None,
    draft: bool,
    config: files.Found | None,
    as_json: bool,
    device: str | None,
    backend: str | None,
    format: str | None,
    recipe: bool | None,
    max_pixels: int | None,
    **given: Any,
) -> None:
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
    from clmorph.cli.mix import Request, run_mix, weights_of

    images = _pictures(images, config)
    listed = weights_of(weights, len(images)) if images else None
    what = {"grid": grid, "weights": listed, "path": path}
    shown = {name: value for name, value in what.items() if value}
    wins = preset is not None
    if config is not None:
        shown = shown or dict(config.mixes)
        preset = preset or config.preset
    if preset is None and (config is None or config.named.own):
        preset = AUTO
    run_mix(
        Request(
            images, output, options.given_options(given), preset, draft, shown, format,
            bool(recipe), MAX_PIXELS if max_pixels is None else max_pixels, config, wins,
        ),
        device=device, backend=backend, as_json=as_json,
    )  # fmt: skip


@cli.command(epilog=_PRESETS, cls=options.LabeledCommand)
@click.argument("images", metavar="A B", nargs=-1, type=options.FileName())
@click.option(
    "-o", "--output", type=options.OutputName(), panel="File",
    help="Draw a picture too: .png, .svg or .pdf.",
)  # fmt: skip
@click.option(
    "--json", "as_json", is_flag=True, panel="File", help="Print the numbers for programs."
)
@click.option(
    "--preset", type=click.Choice([AUTO, *PRESETS]), panel="Transport",
    help="Set of options for a kind of pictures; see below.  [default: auto]",
)  # fmt: skip
@options.inspect_options
@options.map_options
@options.max_pixels_option
@options.device_options
def inspect(
    images: tuple[Path, ...],
    output: Path | None,
    as_json: bool,
    preset: str | None,
    labels: tuple[Path, ...] | None,
    features: tuple[Path, ...] | None,
    max_pixels: int | None,
    device: str | None,
    backend: str | None,
    **given: Any,
) -> None:
    """Show what a morph would move: how far, how much, how well; how long it would take.

    \b
    clmorph inspect a.png b.jpg                  numbers
    clmorph inspect a.png b.jpg -o report.png    and a picture of where everything goes
    """  # noqa: D301
    from clmorph.cli.inspect import run_inspect

    if len(images) != 2:
        raise InputError(f"{_counted(images)}: expected two, as in clmorph inspect a.png b.jpg")
    run_inspect(
        images, output, preset, options.given_options(given),
        max_pixels=MAX_PIXELS if max_pixels is None else max_pixels, device=device,
        backend=backend, as_json=as_json, labels=labels or (), features=features or (),
    )  # fmt: skip


@cli.command()
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
@click.option("--json", "as_json", is_flag=True, panel="File", help="Print a summary for programs.")
@click.option(
    "--config", type=options.FileName(), panel="Settings",
    help="Options of all pairs, from your own TOML or a recipe; a row's own options win.",
)  # fmt: skip
@click.option(
    "--preset", type=click.Choice([AUTO, *PRESETS]), panel="Settings",
    help="Set of options of pairs that name none.  [default: auto, for each pair by itself]",
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
@options.max_pixels_option
@options.device_options
def batch(
    jobs: str | None,
    out: str,
    all_pairs: str | None,
    chain: str | None,
    ending: str,
    redo: bool,
    as_json: bool,
    config: Path | None,
    preset: str | None,
    scheduler: str | None,
    workers: int | None,
    memory: str | None,
    max_pixels: int | None,
    device: str | None,
    backend: str | None,
) -> int:
    """Morph thousands of pairs on the workers of Dask (extra "dask").

    \b
    clmorph batch jobs.csv -o folder           columns source, target, output, and any option
    clmorph batch jobs.json -o folder          a list of objects with these keys
    clmorph batch --all-pairs pictures -o folder
    clmorph batch --chain pictures -o folder --ending .webp

    Started again, it does only what is missing. Exit code 1: some pairs have failed.
    """  # noqa: D301
    from clmorph.cli.batch import batch_request, run_batch

    return run_batch(
        batch_request(
            jobs, out, all_pairs=all_pairs, chain=chain, ending=ending, config=config,
            preset=preset, scheduler=scheduler, workers=workers, memory=memory, device=device,
            backend=backend, max_pixels=max_pixels, redo=redo, as_json=as_json,
        )
    )  # fmt: skip


@cli.command()
@click.option(
    "--host", metavar="ADDRESS", default="127.0.0.1", show_default=True,
    help="Where to listen; any other than this machine's own address needs the token that is "
    "printed.",
)  # fmt: skip
@click.option(
    "--port", type=click.IntRange(0, 65535), help="Port; 0: a free one.  [default: 8017, or free]"
)
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser.")
@options.device_options
def studio(
    host: str, port: int | None, browser: bool, device: str | None, backend: str | None
) -> None:
    """Open a local web page to look rather than type (extra "studio").

    \b
    clmorph studio                       http://127.0.0.1:8017/, for this machine alone
    clmorph studio --port 0 --no-browser
    """  # noqa: D301
    from clmorph.cli.studio import run_studio

    run_studio(host, port, device, backend, browser)


@cli.command()
@options.device_options
def demo(device: str | None, backend: str | None) -> None:
    """Morph a bundled sprite into a photograph: clmorph-demo.gif, .html and .png."""
    from clmorph.cli.common import open_backend
    from clmorph.cli.demo import run_demo
    from clmorph.cli.terminal import Stages

    operations = open_backend(device, backend)
    with Stages() as stages:
        report = run_demo(operations, Path.cwd(), stages)
    for line in report:
        click.echo(line)


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="For programs.")
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


@cli.command()
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


@cli.command()
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


@cli.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes a shell complete commands and options.

    \b
    bash:  eval "$(clmorph completion bash)"           in ~/.bashrc
    zsh:   eval "$(clmorph completion zsh)"            in ~/.zshrc
    fish:  clmorph completion fish > ~/.config/fish/completions/clmorph.fish
    """  # noqa: D301
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None  # click has all of SHELLS
    click.echo(kind(cli, {}, "clmorph", "_CLMORPH_COMPLETE").source())


def _note(told: set[str], message: Warning | str, *others: Any, **more: Any) -> None:
    """Print a warning as a note, once; else the signature is that of `warnings.showwarning`."""
    from clmorph.cli.common import note_warning

    if str(message) not in told:
        told.add(str(message))
        note_warning([], message, *others, **more)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    names = {str(parameter.name): parameter.opts[-1] for parameter in (*morph.params, *mix.params)}
    with terminable() as ending, warnings.catch_warnings():
        warnings.simplefilter("always", OptionWarning)
        warnings.showwarning = partial(_note, set())
        return run(cli, arguments, names | options.names_outside(), ending)
