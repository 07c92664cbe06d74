"""Options of the command line: those of the option classes, which define them, and its own."""

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from pathlib import Path
from typing import Any

import rich_click as click

from clmorph._shared.files import STANDARD_OUTPUT, errors_as_output
from clmorph._shared.options import (
    Option,
    Options,
    from_line,
    outside_name,
    specifications,
    to_outside,
)
from clmorph._shared.staging import staging_folder
from clmorph.clips.writing import CONTAINERS
from clmorph.errors import InputError
from clmorph.frames.options import RenderOptions
from clmorph.images.pixels import MAX_PIXELS
from clmorph.measures.landmark_options import GuideOptions
from clmorph.measures.options import LiftOptions
from clmorph.output.options import FrameStyle, PlaybackOptions
from clmorph.output.picture import ENCODERS
from clmorph.output.save import FORMATS
from clmorph.pipeline.options import BudgetOptions, MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recolor_options import RecolorOptions
from clmorph.transport.options import PlanOptions, SolverOptions

Decorator = Callable[[Any], Any]

#: The options of all commands, and their names on the command line, by their names in Python.
KNOWN: dict[str, Option] = {
    name: known
    for kind in (RecolorOptions, RearrangeOptions, MorphOptions)
    for name, known in specifications(kind).items()
}
NAMES = {name: "--" + outside_name(name, known).replace("_", "-") for name, known in KNOWN.items()}


class FileName(click.Path):
    """The name of a file or a folder; an empty name, which means the current folder, is refused."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: D102 (click's)
        if not str(value) or "\0" in str(value):
            self.fail(
                f"{str(value)!r} is an invalid file name; expected a name such as out.gif",
                param,
                ctx,
            )
        return super().convert(value, param, ctx)


class InputName(FileName):
    """The name of a file that is read; ``-`` stands for standard input."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: D102 (click's)
        path = super().convert(value, param, ctx)
        if not ctx or ctx.resilient_parsing or not _is_stream(str(value)):
            return path
        if str(value) == "-" and sys.stdin.isatty():
            self.fail("- is a terminal here; pipe a file into it, or name one.", param, ctx)
        # Files are opened several times, and their readers seek.
        home = Path(tempfile.gettempdir())
        with errors_as_output(home):
            folder = ctx.find_root().with_resource(staging_folder(home))
            copy = folder / ("standard-input" if str(value) == "-" else path.name)
            source = sys.stdin.fileno() if str(value) == "-" else path
            with open(source, "rb", closefd=source is path) as stream, copy.open("wb") as file:
                shutil.copyfileobj(stream, file)
        if not copy.stat().st_size:
            self.fail(f"{value} is empty, or was read already; expected a file.", param, ctx)
        return copy


def _is_stream(name: str) -> bool:
    """Return whether a name stands for standard input or another open pipe of this process."""
    if name == "-":
        return True
    opened = re.fullmatch(r"/dev/stdin|/(dev|proc/self)/fd/\d+", name)
    return opened is not None and Path(name).is_fifo()


class OutputName(FileName):
    """The name of an output file or folder; ``-`` stands for standard output."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: D102 (click's)
        path = super().convert(value, param, ctx)
        if path == Path("-"):
            return STANDARD_OUTPUT if str(value) == "-" else path.absolute()
        ends = tuple(separator for separator in (os.sep, os.altsep) if separator)
        files = {ending for format in FORMATS.values() for ending in format.endings if ending}
        if str(value).endswith(ends) and path.suffix.lower() in files:
            self.fail(
                f"{str(value)!r} names a folder, but {path.suffix} is the ending of a file; leave "
                f"out the {str(value)[-1]!r} or the ending.",
                param,
                ctx,
            )
        return path


class LabeledCommand(click.RichCommand):
    """A command whose option ``--labels`` takes two files, or the one word auto."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: D102 (click's)
        found = []
        for k, text in enumerate(args):
            found.append(text)
            if text == "--labels=auto" or (text == "auto" and k and args[k - 1] == "--labels"):
                found.append("auto")
        return super().parse_args(ctx, found)


class Value(click.ParamType):
    """A text of the command line that an option accepts; `given_options` converts it.

    Click interprets None as "not given", but some texts stand for None.
    """

    def __init__(self, name: str, known: Option) -> None:
        self.option, self.known = name, known
        words = [known.word] if known.word and known.word not in known.kind.metavar else []
        self.name = "|".join([known.kind.metavar, *words])

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:  # noqa: D102 (click's)
        try:
            from_line(self.known, str(value))
        except InputError as error:
            self.fail(str(error), param, ctx)
        return str(value)

    def shell_complete(self, ctx: Any, param: Any, incomplete: str) -> Any:  # noqa: D102
        from click.shell_completion import CompletionItem

        words = [word for word in self.name.split("|") if word not in ("number", "integer")]
        return [CompletionItem(word) for word in words if word.startswith(incomplete)]


def given_options(
    given: Mapping[str, Any], options: type[Options] = MorphOptions
) -> dict[str, Any]:
    """Return the options that the command line gives, by their names in Python."""
    known = specifications(options)
    found: dict[str, Any] = {}
    for name, value in given.items():
        if name in known and known[name].kind.several and isinstance(value, tuple):
            parts = [from_line(known[name], text) for text in value]
            if parts:  # the last word, such as "none", drops what came before it
                words = [k for k, part in enumerate(parts) if not isinstance(part, tuple)]
                last = words[-1] if words else -1
                found[name] = sum(parts[last + 1 :], ()) or parts[last]
        elif name in known and value is not None:
            found[name] = value if isinstance(value, bool) else from_line(known[name], value)
    return found


def in_option_names(message: str, more: Mapping[str, str] | None = None) -> str:
    """Return a message in which options are written as on the command line.

    ``n_frames=1`` becomes ``--frames 1``, and None the option's word. `more` names further
    arguments on the command line, by their names in Python.
    """
    first = re.match(r"(\w+)=", message)
    word = KNOWN[first[1]].word if first and first[1] in KNOWN else ""
    for end in (", or None for balanced transport", ", or None"):
        message = message.replace(end, f", or {word!r}" if word else end)

    def named(found: re.Match[str]) -> str:
        name, value = found[1], found[2]
        if name not in NAMES:
            return f"{more[name]} {value}" if more and name in more else found[0]
        if value == "True":
            return NAMES[name]
        return f"{NAMES[name]} {KNOWN[name].word if value == 'None' else value}"

    return re.sub(r"\b(\w+)=(None\b|True\b|)", named, message)


def _together(*decorators: Decorator) -> Decorator:
    """Combine decorators into one; the first one is the outermost."""
    return lambda command: reduce(lambda done, each: each(done), reversed(decorators), command)


def _of(options: type[Options], *names: str, usual: type[Options] = MorphOptions) -> Decorator:
    """Return the decorator for all options of a class, or for the named ones."""
    known = specifications(options)
    return _together(*(_one(name, known[name], getattr(usual, name)) for name in names or known))


def _one(name: str, known: Option, default: Any) -> Decorator:
    """Return the decorator for one option of the command line."""
    line, text = NAMES[name], known.help
    if not known.kind.metavar:
        both = f"{line}/--no-{line[2:]}"
        return click.option(both, name, is_flag=True, default=None, panel=known.panel, help=text)
    # The default of `MorphOptions` can differ from that of the stage's own class.
    usual = to_outside(known, default)
    shown = f"{usual:g}" if isinstance(usual, float) else str(usual)
    if known.unit and isinstance(usual, str):
        text += f"  [unit: {known.unit}]"
    elif known.unit:
        shown += f" {known.unit}"
    text += "" if usual == "none" else f"  [default: {shown}]"
    kind = Value(name, known)
    return click.option(
        line, name, type=kind, metavar=kind.name, panel=known.panel, help=text,
        multiple=known.kind.several,
    )  # fmt: skip


def _transport(*guides: str) -> Decorator:
    """Return the decorator for the options of the transport, with the named guides or all."""
    return _together(
        _of(BudgetOptions),
        _of(SolverOptions, "blur"),
        _of(MorphOptions, "reach"),
        _of(SolverOptions, "epsilon", "rho"),
        _of(LiftOptions),
        _of(GuideOptions, *guides),
        _of(SolverOptions, "tol", "max_iter"),
    )


def _outputs(help: str, formats: Iterable[str], *style: Decorator) -> Decorator:
    """Return the decorator for the options of output files."""
    return _together(
        click.option("-o", "--output", panel="File", type=OutputName(), multiple=True, help=help),
        click.option(
            "--format", panel="File", type=click.Choice(list(formats)),
            help="Format of the output, where its ending does not choose it.",
        ),
        *style,
        click.option(
            "--recipe/--no-recipe", panel="File", is_flag=True, default=None,
            help="Write OUTPUT.json beside the file; --config repeats the run from it.",
        ),
    )  # fmt: skip


file_options = _outputs(
    "Name of an output; its ending chooses the format: .gif .webp .apng .mp4 .webm .html, "
    ".png (contact sheet), .npz (NumPy), .tif; a name without an ending is a folder of PNG "
    "frames, and - with --format is standard output. Can be repeated.",
    FORMATS,
    _of(FrameStyle),
)
picture_options = _outputs(
    f"Name of an output: {', '.join(ENCODERS)} (TIFF: 16 bits), .mp4 or .webm for clips; "
    "- with --format is standard output. Can be repeated.",
    [*(ending[1:] for ending in ENCODERS), *CONTAINERS],
)

preset_option = click.option(
    "--preset", panel="Settings", type=click.Choice([AUTO, *PRESETS]),
    help="Set of options for a kind of pictures, described below.  [default: auto]",
)  # fmt: skip
draft_option = click.option(
    "--draft", panel="Settings", is_flag=True,
    help="A first look in a few seconds (without an OpenCL device up to a minute): smaller, "
    "with fewer frames and less accuracy.",
)  # fmt: skip
json_option = click.option(
    "--json", "as_json", panel="Settings", is_flag=True, help="Print the result as JSON."
)

device_options = _together(
    click.option(
        "--device", panel="Device", metavar="NAME",
        help="OpenCL device: an index (0:1) or part of a name; several, joined by commas, share "
        "the work.",
    ),
    click.option(
        "--backend", panel="Device", metavar="NAME",
        help="auto, opencl, numpy, or what --device takes.  [default: auto]",
    ),
)  # fmt: skip

map_options = _together(
    click.option(
        "--labels", panel="Transport", type=InputName(), nargs=2, metavar="A B|auto",
        help="Label images of both pictures, of their sizes: gray levels, indices of a palette or "
        "colors of PNG files, or .npy. Mass never changes its label. auto: people, or what is not "
        "transparent.",
    ),
    click.option(
        "--features", panel="Transport", type=InputName(), nargs=2, metavar="A B",
        help="Additional coordinates of each pixel in the cost, such as depth: .npy or pictures. "
        "--feature-weight scales them.",
    ),
)  # fmt: skip

input_options = _together(
    click.option(
        "--max-pixels", panel="Transport", type=int,
        help=f"Refuse picture files with more pixels.  [default: {MAX_PIXELS}]",
    ),
    device_options,
)  # fmt: skip

film_options = _together(file_options, preset_option, draft_option)
_frames = _together(_of(PlanOptions), _of(RenderOptions))
morph_options = _together(
    json_option, _of(PlaybackOptions), _transport(), _frames, map_options, input_options
)
mix_options = _together(
    json_option, _of(PlaybackOptions), _transport("landmarks"), _frames, input_options
)
inspect_options = _together(
    preset_option, json_option, _transport(), _of(PlanOptions, "log_threshold"),
    _of(PlaybackOptions, "n_frames"), map_options, input_options,
)  # fmt: skip
rearrange_options = _together(
    json_option,
    _of(PlaybackOptions),
    _of(
        RearrangeOptions, "size", "color_weight", "color_space", "extent", "gap", "seed",
        usual=RearrangeOptions,
    ),
    input_options,
)  # fmt: skip
recolor_options = _together(json_option, _of(RecolorOptions, usual=RecolorOptions))
