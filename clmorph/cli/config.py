"""Settings of a run: presets, files of settings, and options of the command line.

A TOML file, which the user writes, may contain any setting. A recipe (in JSON, a GIF's comment, a
page) can come from anybody, so it controls only the options of the morph: no output paths and no
limit of pixels; it can lower the limit of memory but not raise it. It refers to pictures by bare
file names, which are searched beside the recipe and in the current folder.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clmorph._shared.options import Options
from clmorph._shared.printable import reason_of
from clmorph._shared.validation import errors_about, shown
from clmorph.cli.terminal import note, quiet_libraries
from clmorph.errors import FileError, InputError
from clmorph.pipeline import recipe as recipes
from clmorph.pipeline.maps import AUTO_LABELS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.recipe import IMAGES, OUTPUT, PRESET

Settings = dict[str, Any]

#: Names that Windows reserves for devices, with any ending.
DEVICES = re.compile(
    r"(con|prn|aux|nul|(com|lpt)[0-9¹²³]|conin\$|conout\$) *(\..*)?", re.IGNORECASE
)


@dataclass(frozen=True)
class Named:
    """The pictures that a file of settings names."""

    file: Path
    #: Whether the user wrote the file.
    own: bool
    #: File names, or tables with ``file`` and optionally ``sha256``.
    entries: Sequence[str | Mapping[str, Any]]

    def paths(self) -> tuple[Path, ...]:
        """Return the path of each picture, with notes about those that have changed since then."""
        found = []
        for entry in self.entries:
            name = entry if isinstance(entry, str) else str(entry["file"])
            known = None if isinstance(entry, str) else entry.get("sha256")
            if not (self.own or is_bare(name)):
                raise InputError(
                    f"{self.file} names the picture {shown(name)}: a recipe may name "
                    "pictures beside it or in the current folder, without a folder; name the "
                    "pictures in the command line"
                )
            try:
                beside = self.file.parent / name
                found.append(path := beside if beside.exists() else Path(name))
            except OSError as error:
                raise InputError(f"{self.file}: {shown(name)}: {reason_of(error)}") from None
            if not path.exists():
                raise FileError(
                    f"{path}: no such file, but the settings name it; put it there, or name the "
                    "pictures in the command line"
                )
            if known is not None and path.is_file() and recipes.digest(path) != known:
                note(f"{path} is not the file that was used then")
        return tuple(found)


def is_bare(name: str, *, windows: bool = os.name == "nt") -> bool:
    """Return whether a file name has no folder and, on Windows, no drive or device.

    By the rules of Windows backslashes separate folders, a colon ends a drive's name, some names
    are devices, and trailing dots and spaces are dropped. Elsewhere these are parts of names.
    """
    if len(name) >= 256 or re.search(r"[/\0]", name) or name in ("", ".", ".."):
        return False
    if not windows:
        return True
    return (
        not re.search(r"[\\:]", name) and name.rstrip(". ") == name and not DEVICES.fullmatch(name)
    )


@dataclass(frozen=True)
class Found:
    """The contents of a file of settings."""

    #: Options of the morph, by their names in Python.
    options: Settings
    #: The preset that the file names.
    preset: str | None
    #: The pictures that it names.
    named: Named
    #: The settings in `OWN`, which only the user decides, for the command line's own options.
    own: Settings
    #: The label images, the features and the mask that it names, by these words.
    beside: Mapping[str, Named]
    #: What of mixes it shows: one of `SHOWN` and its value.
    mixes: Mapping[str, Any] = field(default_factory=dict)


def read_settings(
    path: Path, command: type[Options] = MorphOptions, *, mixes: bool = False
) -> Found:
    """Read settings from TOML, from a recipe (JSON), or from a file that clmorph has written.

    `command` is the class of the command's options; with `mixes` the command is ``clmorph mix``,
    whose options are those of a morph.
    """
    if not path.exists():
        raise InputError(f"--config {path}: no such file")
    own = path.suffix.lower() == ".toml"
    found = recipes.read_toml(path) if own else _recipe(path, command, mixes)
    by_name = {key.replace("-", "_"): value for key, value in found.items()}
    refused = [name for name in recipes.BESIDE[command] if mixes and name in by_name]
    if refused:
        raise InputError(f"{path}: {refused[0]}: mixes take none; remove them or use morph")
    images = _entries(path, IMAGES, by_name.pop(IMAGES, []))
    beside = {
        name: _entries(path, name, by_name.pop(name), count)
        for name, count in recipes.BESIDE[command].items()
        if name in by_name
    }
    shows = {name: by_name.pop(name) for name in recipes.SHOWN if mixes and name in by_name}
    users = {name: by_name.pop(name) for name in recipes.OWN if name in by_name}
    if not own:
        for name in (OUTPUT, "format"):  # no recipe that clmorph writes contains these
            if name in users:
                note(f"{path} names its own {name}, which a recipe does not choose: give -o")
        users = {}
    options = recipes.options_of(by_name, str(path), command)
    chosen = options.pop(PRESET, None)
    names = (AUTO, *PRESETS)
    if chosen is not None and (not isinstance(chosen, str) or chosen not in names):
        raise InputError(
            f"{path}: preset = {shown(chosen)}: expected one of {', '.join(map(repr, names))}"
        )
    with errors_about(str(path), FileError):
        preset = {} if chosen in (None, AUTO) else {PRESET: chosen}
        command(**preset, **options)
    _check_own(path, users)
    others = {name: Named(path, own, entries) for name, entries in beside.items()}
    return Found(options, chosen, Named(path, own, images), users, others, shows)


#: What stands for a file of settings where none is given.
NOTHING = Found({}, None, Named(Path(), True, ()), {}, {})


def _entries(path: Path, name: str, value: Any, count: int | None = None) -> list[Any]:
    """Return a checked list of `count` file names, or of tables with one; labels may be "auto"."""
    if name == "labels" and value == AUTO:
        return [AUTO, AUTO]
    known = [
        isinstance(entry.get("file") if isinstance(entry, dict) else entry, str)
        for entry in (value if isinstance(value, list) else [None])
    ]
    if not all(known) or len(known) != (len(known) if count is None else count):
        number = {1: "one file name", 2: "two file names"}.get(count or 0, "file names")
        raise InputError(f"{path}: {name}: expected a list of {number}")
    return list(value)


def _check_own(path: Path, users: Settings) -> None:
    """Check the command line's own options, and resolve outputs relative to the file's folder."""
    words = {"format": "a text", "recipe": "true or false", "max_pixels": "a whole number"}
    for (name, expected), kind in zip(words.items(), (str, bool, int), strict=True):
        if name in users and type(users[name]) is not kind:
            raise InputError(f"{path}: {name} = {shown(users[name])}: expected {expected}")
    if OUTPUT in users:
        outputs = users[OUTPUT] if isinstance(users[OUTPUT], list) else [users[OUTPUT]]
        if not all(isinstance(name, str) and name for name in outputs):
            raise InputError(
                f"{path}: {OUTPUT} = {shown(users[OUTPUT])}: expected a file name, or several"
            )
        users[OUTPUT] = [
            output if output == "-" else str(path.parent / output) for output in outputs
        ]


def _recipe(path: Path, command: type[Options], mixes: bool) -> Settings:
    with quiet_libraries():  # notes of clmorph are printed later
        found = recipes.read_recipe(path)
    made_by = found.get(recipes.COMMAND, "morph")
    mixed = made_by == recipes.MIX
    if isinstance(made_by, str) and (
        mixed != mixes or recipes.COMMANDS.get(made_by, command) is not command
    ):
        raise InputError(
            f"{path} was made by clmorph {made_by}: repeat it by clmorph {made_by} --config {path}"
        )
    for name in found.get("arrays", []) if isinstance(found.get("arrays"), list) else []:
        note(f"{path} was made with an array of {shown(name)}, which it does not hold")
    others = (*recipes.BESIDE[command], *(recipes.SHOWN if mixes else ()))
    more = {name: found[name] for name in others if name in found}
    return {**found["options"], IMAGES: found.get(IMAGES, []), **more}


def as_toml(
    settings: Settings, images: Sequence[Path], beside: Mapping[str, Sequence[Path]] | None = None
) -> str:
    """Return settings, by their names outside, as the text of a file that ``--config`` reads."""
    import tomli_w

    files = {IMAGES: images, **(beside or {})}
    named: Settings = {
        name: AUTO if tuple(paths) == AUTO_LABELS else [str(path) for path in paths]
        for name, paths in files.items()
        if paths
    }
    return tomli_w.dumps(named | dict(sorted(settings.items())))
