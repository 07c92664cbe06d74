"""What was chosen on the page: its options, the command line and the Python code that do the same.

The page sends texts as the command line takes them, by the options' names outside.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from clmorph._shared.options import (
    Option,
    from_line,
    outside_name,
    specifications,
    to_outside,
    unknown_option,
)
from clmorph._shared.validation import as_float, shown
from clmorph.errors import InputError
from clmorph.measures.landmark_options import check_landmarks
from clmorph.pipeline.mixing.weights import grid_sides
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.studio.kinds import KINDS, PAINTED, Kind, painted_name

#: What the page sends in place of landmarks that are those that were found.
LANDMARKS_FOUND = "auto"


@dataclass(frozen=True)
class Choices:
    """What is chosen on the page."""

    kind: Kind
    preset: str = AUTO
    #: Values by names in Python.
    given: Mapping[str, Any] = field(default_factory=dict)
    #: What `clmorph.get_backend` takes.
    device: str = "auto"
    #: Sides of the grid, as the command line takes them; "" for the usual ones, or without a grid.
    grid: str = ""
    #: Whether painted regions count.
    painted: bool = False

    def options(self, recognized: str) -> Any:
        """Return all options; `recognized` is the preset that the pictures choose."""
        preset = {"preset": self.named(recognized)} if self.kind.presets else {}
        return self.kind.options(**preset, **self.given)

    def named(self, recognized: str) -> str:
        """Return the name of the preset."""
        return recognized if self.preset == AUTO else self.preset

    @property
    def sides(self) -> int | tuple[int, ...] | None:
        """The sides of the grid; None for the usual ones."""
        return grid_sides("grid", self.grid) if self.grid else None

    @property
    def mixes(self) -> dict[str, str] | None:
        """What a recipe says of the mixes; None for other kinds."""
        if not self.kind.grid:
            return None
        return {"grid": self.grid} if self.grid else {}

    def beside(self, names: Sequence[str]) -> list[str]:
        """Return the names of the files that hold painted regions, by those of the pictures."""
        if not self.painted:
            return []
        painted = self.kind.painted
        return [painted_name(painted, name) for name in names[: PAINTED[painted]]]


def read_choices(asked: Any) -> Choices:
    """Return the choices that the page has sent, or raise InputError.

    It sends ``kind``, ``preset``, ``device``, ``settings`` (texts by names outside, truth values
    for flags), ``grid``, ``painted`` and ``landmarks`` (pairs of points, or "auto"). The names of
    files are no values here, unlike on the command line.
    """
    if not isinstance(asked, Mapping) or not isinstance(asked.get("settings", {}), Mapping):
        raise InputError("settings: expected texts by the names of options")
    name = asked.get("kind", "morph")
    if not isinstance(name, str) or name not in KINDS:
        raise InputError(f"kind={shown(name)}: expected one of {', '.join(KINDS)}")
    kind = KINDS[name]
    preset, device = asked.get("preset", AUTO), asked.get("device", "auto")
    if not isinstance(preset, str) or preset not in (AUTO, *PRESETS):
        raise InputError(f"preset={shown(preset)}: expected one of {', '.join((AUTO, *PRESETS))}")
    if not isinstance(device, str):
        raise InputError(f"device={shown(device)}: expected the name of a device")
    known = {
        outside_name(name, each): (name, each)
        for name, each in specifications(kind.options).items()
        if not each.kind.several
    }
    given: dict[str, Any] = {}
    for key, value in asked.get("settings", {}).items():
        if key not in known:
            raise InputError(unknown_option(key, known))
        name, each = known[key]
        given[name] = _value(key, each, value)
    marks = asked.get("landmarks", LANDMARKS_FOUND)
    if marks != LANDMARKS_FOUND and kind.landmarks:
        given["landmarks"] = check_landmarks("landmarks", marks) or None
    grid = str(asked.get("grid") or "").strip()[:20] if kind.grid else ""
    painted = bool(kind.painted) and asked.get("painted") is True
    found = Choices(kind, preset, given, device, grid, painted)
    _ = found.sides  # raises an error if it is no grid
    return found


def _value(key: str, known: Option, value: Any) -> Any:
    flag = not known.kind.metavar
    if flag and isinstance(value, bool):
        return value
    if flag or not isinstance(value, str):
        raise InputError(f"{key}={shown(value)}: expected {known.kind.expected}")
    try:
        return from_line(known, value)
    except InputError as error:
        line = key.replace("_", "-")
        raise InputError(f"Invalid value for '--{line}': {error}") from None


def command_line(choices: Choices, recognized: str, names: Sequence[str]) -> str:
    """Return the command that writes the same file, in the folder of the pictures."""
    kind = choices.kind
    known = specifications(kind.options)
    output = f"{kind.output}.{kind.downloads[0]}"
    words = ["clmorph", kind.name, *map(_as_path, names), "-o", output]
    words += ["--preset", choices.named(recognized)] if kind.presets else []
    words += ["--grid", choices.grid] if choices.grid else []
    beside = choices.beside(names)
    words += [f"--{kind.painted}", *map(_as_path, beside)] if beside else []
    for name, value in choices.given.items():
        line = "--" + outside_name(name, known[name]).replace("_", "-")
        if isinstance(value, bool):
            words.append(line if value else f"--no-{line[2:]}")
            continue
        if name == "landmarks":
            for (x, y), (u, v) in value or ():
                words += [line, f"{x!r},{y!r}:{u!r},{v!r}"]
            words += [] if value else [line, known[name].word]
            continue
        text = _text(to_outside(known[name], value), name)
        words += [f"{line}={text}"] if text.startswith("-") else [line, text]
    if choices.device == "numpy":
        words += ["--backend", "numpy"]
    elif choices.device != "auto":
        words += ["--device", choices.device]
    return shlex.join(words)


def _as_path(name: str) -> str:
    return f"./{name}" if name[0] == "-" else name


def _text(value: Any, name: str) -> str:
    if isinstance(value, list):
        return ("x" if name == "canvas" else ",").join(_text(part, name) for part in value)
    number = as_float(value) if not isinstance(value, str) else None
    return str(value) if number is None else repr(value)


#: The lines of Python code after the pictures are read, by kind. `given` are the options,
#: `beside` the files with painted regions.
_CODE = {
    "morph": """\
labels = tuple(clmorph.read_labels(file) for file in beside) or None
chain = [clmorph.morph(a, b, labels=labels, **given) for a, b in pairwise(pictures)]
more = {"labels": picture_entries(beside)} if beside else {}
options = chain[0].options
marks = [each.options.landmarks or () for each in chain]
if len(chain) > 1 and any(marks):
    options = options.replace(landmarks=marks)
known = recipe(options, images=picture_entries(files), beside=more, device=device)
clmorph.save(chain, OUTPUT, parameters=known)
""",
    "rearrange": """\
chain, pixels = [], pictures[0]
for picture in pictures[1:]:
    chain.append(clmorph.rearrange(pixels, picture, **given))
    pixels = chain[-1][-1]
known = recipe(chain[0].options, images=picture_entries(files), device=device)
clmorph.save(chain, OUTPUT, parameters=known)
""",
    "recolor": """\
mask = clmorph.read_labels(beside[0]) > 0 if beside else None
picture = clmorph.recolor(*pictures, mask=mask, **given)
del given["backend"]
more = {"mask": picture_entries(beside)} if beside else {}
options = clmorph.RecolorOptions(**given)
known = recipe(options, images=picture_entries(files), beside=more, device=device)
clmorph.write_image(OUTPUT, picture, parameters=known)
""",
    "mix": """\
mixes = clmorph.mix(pictures, grid=GRID, **given)
known = recipe(
    mixes.options, images=picture_entries(files), device=device, mixes=MIXES
)
write_sheet([Output(OUTPUT)], mixes.sheet(mixes.options.background), known)
""",
}  # fmt: skip


def python_code(choices: Choices, recognized: str, names: Sequence[str]) -> str:
    """Return the Python code that writes the same file, in the folder of the pictures."""
    kind = choices.kind
    given = [f"preset={choices.named(recognized)!r}"] if kind.presets else []
    given += [f"{name}={value!r}" for name, value in choices.given.items()]
    code = _CODE[kind.name].replace("OUTPUT", repr(f"{kind.output}.{kind.downloads[0]}"))
    if kind.grid:
        code = code.replace("GRID", repr(choices.sides)).replace("MIXES", repr(choices.mixes))
    painted = choices.beside(names)
    mix = kind.name == "mix"
    return "\n".join(
        (
            *(["from itertools import pairwise"] if kind.name == "morph" else []),
            "from pathlib import Path",
            "",
            "import clmorph",
            *(["from clmorph.output.save import Output"] if mix else []),
            *(["from clmorph.pipeline.mixing.writing import write_sheet"] if mix else []),
            "from clmorph.pipeline.recipe import picture_entries, recipe",
            "",
            f"files = [Path(name) for name in {list(names)!r}]",
            *([f"beside = [Path(name) for name in {painted!r}]"] if kind.painted else []),
            "pictures = [clmorph.read_image(file) for file in files]",
            f"operations = clmorph.get_backend({choices.device!r})",
            "device = operations.description",
            f"given = dict({', '.join([*given, 'backend=operations'])})",
            code,
        )
    )


def with_reach(choices: Choices, recognized: str) -> Choices:
    """Return choices in which regions of different sizes can go into each other.

    In balanced problems the masses of each region must be equal. Where a preset is balanced,
    painted regions therefore bring the usual reach with them.
    """
    named = {"reach", "rho"} & set(choices.given)
    if choices.kind.painted != "labels" or not choices.painted or named:
        return choices
    if choices.options(recognized).reach is not None:
        return choices
    return replace(choices, given={**choices.given, "reach": MorphOptions.reach})
