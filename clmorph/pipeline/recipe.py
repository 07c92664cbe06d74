"""Recipes: the options with which a file was made, which are stored in the file and can be read.

Python and the command line use the same format, so each reads the recipes of the other.
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from clmorph._shared.options import Options, by_outside_name, from_outside, unknown_option
from clmorph._shared.printable import reason_of
from clmorph._shared.validation import errors_about, is_path, shown
from clmorph._shared.version import __version__
from clmorph.errors import InputError
from clmorph.output.bounded import MAX_TEXT
from clmorph.output.provenance import read_parameters
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recolor_options import RecolorOptions

#: Keys beside options in a file of settings.
PRESET, IMAGES, OUTPUT = "preset", "images", "output"
#: Key of the command that made a file, if it is not ``morph``.
COMMAND = "command"
#: The value of `COMMAND` for mixes, which have the options of a morph.
MIX = "mix"
#: Keys of what mixes show: a grid, their weights, or the stops of a path, as letters or weights.
SHOWN = ("grid", "weights", "path", "stops")
#: The classes of options of the commands.
COMMANDS: dict[str, type[Options]] = {
    "morph": MorphOptions,
    "rearrange": RearrangeOptions,
    "recolor": RecolorOptions,
}
#: Keys of files beside the pictures, with their number, by the class of the command's options.
BESIDE: dict[type[Options], dict[str, int]] = {
    MorphOptions: {"labels": 2, "features": 2},
    RearrangeOptions: {},
    RecolorOptions: {"mask": 1, "lut": 1},
}
#: Keys that only the user decides, in the command line or in TOML; recipes do not contain them.
OWN = (OUTPUT, "format", "recipe", "max_pixels")


def recipe(
    options: Options,
    *,
    images: Sequence[Mapping[str, Any]] = (),
    device: str = "",
    arrays: Sequence[str] = (),
    beside: Mapping[str, Any] | None = None,
    mixes: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return a file's recipe; `images` and `beside` hold `picture_entries`, `mixes` of `SHOWN`."""
    found: dict[str, Any] = {"clmorph": __version__, "options": options.outside()}
    command = next((name for name, kind in COMMANDS.items() if isinstance(options, kind)), "morph")
    found |= {} if command == "morph" else {COMMAND: command}
    found |= {} if mixes is None else {COMMAND: MIX, **mixes}
    found |= {IMAGES: [dict(image) for image in images]} if images else {}
    for name, entries in (beside or {}).items():
        found[name] = entries if isinstance(entries, str) else [dict(entry) for entry in entries]
    found |= {"arrays": list(arrays)} if arrays else {}
    return found | ({"device": device} if device else {})


def options_of(
    settings: Mapping[str, Any], where: str, options: type[Options] = MorphOptions
) -> dict[str, Any]:
    """Return a file's options by their names in Python; `where` is its name in messages."""
    known = by_outside_name(options)
    presets = (PRESET,) if options is MorphOptions else ()
    found: dict[str, Any] = {}
    for key, value in settings.items():
        outside = key.replace("-", "_")
        if outside in presets:
            found[PRESET] = value
            continue
        if outside not in known:
            names = [*known, *presets, IMAGES, *BESIDE[options], *OWN]
            raise InputError(f"{where}: {unknown_option(key, dict.fromkeys(names))}")
        name, each = known[outside]
        with errors_about(where):
            found[name] = from_outside(each, key, value)
    return found


def read_toml(path: Path) -> dict[str, Any]:
    """Read a file of settings in TOML."""
    import tomllib

    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_TEXT + 1)
        if len(content) > MAX_TEXT:
            raise ValueError(f"more than {MAX_TEXT} bytes")
        return tomllib.loads(content.decode())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not TOML ({reason_of(error)})") from None


def read_recipe(path: Path) -> dict[str, Any]:
    """Read the recipe in a file that clmorph has written; one of several morphs is refused."""
    found = read_parameters(path)
    if not isinstance(found.get("options"), dict):
        several = "morphs that were made with different options" if "morphs" in found else "none"
        raise InputError(f"{path} holds the options of {several}: expected those of one morph")
    return found


def load_options(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the options with which a file was made, or those in a file of settings.

    Parameters
    ----------
    path : path
        Any file that `clmorph.save` or a command has written, a recipe (.json), or settings in
        TOML.

    Returns
    -------
    dict
        Keyword arguments for ``clmorph.morph(a, b, **options)``, or for `clmorph.rearrange` or
        `clmorph.recolor` if the file was made by one of them.

    Raises
    ------
    InputError
        If the file contains no options, or an invalid one.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import clmorph
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "mine.toml")
    ...     _ = file.write_text('preset = "pixel-art"')
    ...     clmorph.load_options(file)
    {'preset': 'pixel-art'}
    """
    if not is_path(path):
        raise InputError(
            f"path={shown(path)}: expected the path of a file that clmorph has written"
        )
    file = Path(path)
    try:
        exists = file.exists()
    except OSError as error:  # such as a name that is too long
        raise InputError(
            f"path={shown(path)}: expected the path of a file ({reason_of(error)})"
        ) from error
    if not exists:
        raise InputError(f"{file}: no such file")
    own = file.suffix.lower() == ".toml"
    found = {} if own else read_recipe(file)
    settings = read_toml(file) if own else found["options"]
    command = found.get(COMMAND, "morph")
    kind = COMMANDS.get(command, MorphOptions) if isinstance(command, str) else MorphOptions
    options = {
        name: value for name, value in settings.items()
        if name.replace("-", "_") not in (IMAGES, *BESIDE[kind], *OWN)
    }  # fmt: skip
    return options_of(options, str(file), kind)


def picture_entries(images: Sequence[Path], folder: Path | None = None) -> list[dict[str, Any]]:
    """Return a recipe's entries about pictures, with folders relative to `folder` if given."""
    return [
        {"file": path.name, "sha256": digest(path)}
        | ({} if folder is None else {"folder": _folder(path, folder)})
        for path in images
    ]


def _folder(path: Path, start: Path) -> str:
    try:
        return os.path.relpath(path.parent, start)
    except ValueError:  # on another drive
        return str(path.parent.absolute())


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
