"""Settings of a run: presets, files that hold some, and what the command line says.

Settings in TOML are the user's own words and may name any of them. A recipe, in whichever file it
came (JSON, a GIF's comment, a page), may be anybody's: it decides about the picture alone. Where
something is written and how large pictures may be is not read from it; of memory it may take less
than the run would, never more; pictures it names by bare names, sought beside it and in the
current folder.
"""

import difflib
import hashlib
import inspect
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from clmorph._shared.printable import reason_of
from clmorph._shared.validation import as_float, shown
from clmorph.cli.common import quiet_libraries
from clmorph.cli.options import RELATIVE
from clmorph.cli.terminal import note
from clmorph.errors import InputError
from clmorph.images.pixels import MAX_PIXELS
from clmorph.output.bounded import MAX_TEXT
from clmorph.output.provenance import read_parameters
from clmorph.pipeline import presets as defaults
from clmorph.pipeline.morph import check_options
from clmorph.pipeline.presets import PRESETS

Settings = dict[str, Any]

#: Of each of these only one can hold: a later layer's takes the place of an earlier one's.
ALTERNATIVES = (
    ("blur", "epsilon"),
    ("reach", "rho"),
    ("fps", "duration"),
    ("sample", "barycentric"),
    ("log_threshold", "sample"),
    ("log_threshold", "barycentric"),
)
#: Values that choose nothing, so that alternatives of an earlier layer stay.
OFF = (False, RELATIVE)
#: What a file of settings may hold beside options.
IMAGES, OUTPUT, PRESET = "images", "output", "preset"
#: What only the user decides, in the command line or in TOML; in recipes it stands for nothing.
OWN = (OUTPUT, "format", "recipe", "max_pixels")
#: Names that Windows gives to devices, whatever ending follows.
DEVICES = re.compile(
    r"(con|prn|aux|nul|(com|lpt)[0-9¹²³]|conin\$|conout\$) *(\..*)?", re.IGNORECASE
)


@dataclass(frozen=True)
class Named:
    """The pictures that a file of settings names.

    Attributes
    ----------
    file : Path
        The file of settings.
    own : bool
        Whether the user wrote it.
    entries : list
        File names, or tables with ``file`` and perhaps ``sha256``.
    """

    file: Path
    own: bool
    entries: Sequence[str | Mapping[str, Any]]

    def images(self) -> list[tuple[Path, str | None]]:
        """Return where the pictures lie, each with its digest then if that is known.

        Raises
        ------
        InputError
            If a recipe names one in another folder.
        """
        found = []
        for entry in self.entries:
            name = entry if isinstance(entry, str) else str(entry["file"])
            digest = None if isinstance(entry, str) else entry.get("sha256")
            if not (self.own or is_bare(name)):
                raise InputError(
                    f"{self.file} names the picture {shown(name)}: a recipe may name "
                    "pictures beside it or in the current folder, without any folder; name the "
                    "pictures in the command line"
                )
            found.append((self._sought(name), digest))
        return found

    def _sought(self, name: str) -> Path:
        try:
            beside = self.file.parent / name
            return beside if beside.exists() else Path(name)
        except OSError as error:
            raise InputError(f"{self.file}: {shown(name)}: {reason_of(error)}") from None


def is_bare(name: str, *, windows: bool = os.name == "nt") -> bool:
    """Whether a file name is no more than that: no folder and, on Windows, no drive or device.

    Parameters
    ----------
    name : str
    windows : bool
        Whether the name is judged as Windows reads it, where backslashes separate folders, a
        colon ends a drive's name, some names are devices, and dots and spaces at the end are
        dropped. Elsewhere all of these are parts of names like others.
    """
    if len(name) >= 256 or re.search(r"[/\0]", name) or name in ("", ".", ".."):
        return False
    if not windows:
        return True
    return (
        not re.search(r"[\\:]", name) and name.rstrip(". ") == name and not DEVICES.fullmatch(name)
    )


def layered(layers: Iterable[Mapping[str, Any]]) -> Settings:
    """Return the settings of all layers; later ones win.

    Raises
    ------
    InputError
        If one layer contradicts itself.
    """
    settings: Settings = {}
    for layer in layers:
        for pair in ALTERNATIVES:
            for name, other in (pair, pair[::-1]):
                if name in layer and other not in layer and not _is_off(layer[name]):
                    settings.pop(other, None)
        settings |= layer
        if "gamma" in layer:
            splatting = layer.get("splatting", "adaptive")
            if splatting != "adaptive":
                raise InputError(
                    f"--gamma belongs to adaptive splatting, not to {splatting!r}: leave one out"
                )
            settings["splatting"] = "adaptive"
        elif "splatting" in layer and layer["splatting"] != "adaptive":
            settings.pop("gamma", None)
    return settings


def _is_off(value: Any) -> bool:
    return any(type(value) is type(off) and value == off for off in OFF)


def preset(name: str) -> Settings:
    """Return a preset's settings."""
    return dict(PRESETS[name])


def usual() -> Settings:
    """Return what holds without a preset: written down, so that runs can be repeated."""
    options = inspect.signature(check_options).parameters
    settings = {name: option.default for name, option in options.items() if name != "n_frames"}
    settings |= {"frames": options["n_frames"].default, "loop": "loop", "canvas": "dynamic"}
    settings |= {"fps": defaults.FPS, "hold": defaults.HOLD, "scaling": "auto"}
    settings |= {"max_pixels": MAX_PIXELS}
    return {
        name: value for name, value in settings.items() if value is not None and value is not False
    }


def read_settings(path: Path, parameters: Sequence[click.Parameter]) -> Settings:
    """Read settings from TOML, from a recipe (JSON), or from a file that clmorph has written.

    Parameters
    ----------
    path : Path
    parameters : sequence of click.Parameter
        Options that a file may set.

    Returns
    -------
    dict
        By option names with underscores, with `OUTPUT` and `PRESET` if they are there, and with
        a `Named` as `IMAGES`. Of a recipe without what is the user's own (`OWN`).

    Raises
    ------
    InputError
        If it cannot be read or holds something unknown.
    """
    if not path.exists():
        raise InputError(f"--config {path}: no such file")
    own = path.suffix.lower() == ".toml"
    found = _toml(path) if own else _told(path)
    known = {str(parameter.name): parameter for parameter in parameters}
    settings: Settings = {}
    for key, value in found.items():
        name = key.replace("-", "_")
        if name in OWN and not own:
            if name in (OUTPUT, "format"):  # none that clmorph wrote does
                note(f"{path} names its own {name}, which a recipe does not choose: give -o")
            continue
        if name not in known and name != IMAGES:
            near = difflib.get_close_matches(name[:99], [*known, IMAGES], 1)
            hint = f"did you mean {near[0]!r}?" if near else "clmorph morph --help lists them"
            raise InputError(f"{path}: unknown setting {shown(key)}; {hint}")
        if name != IMAGES:
            _check_kind(path, key, value, known[name])
        settings[name] = value
    images = settings.get(IMAGES, [])
    named = isinstance(images, list) and all(
        isinstance(entry.get("file") if isinstance(entry, dict) else entry, str) for entry in images
    )
    if not named:
        raise InputError(f"{path}: {IMAGES}: expected a list of file names")
    settings[IMAGES] = Named(path, own, images)
    if OUTPUT in settings:
        outputs = settings[OUTPUT]
        outputs = outputs if isinstance(outputs, list) else [outputs]
        settings[OUTPUT] = [str(path.parent / output) for output in outputs]
    return settings


def _toml(path: Path) -> Settings:
    try:
        with path.open("rb") as stream:
            text = stream.read(MAX_TEXT + 1)
        if len(text) > MAX_TEXT:
            raise ValueError(f"more than {MAX_TEXT} bytes")
        return tomllib.loads(text.decode())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not TOML ({reason_of(error)})") from None


def _told(path: Path) -> Settings:
    with quiet_libraries():  # notes of ours, which are printed, come later
        told = read_parameters(path)
    options = told.get("options")
    if not isinstance(options, dict):
        raise InputError(
            f"{path} was saved from Python, with what clmorph.morph was called with, and "
            "holds no settings of the command line"
        )
    return {**options, IMAGES: told.get(IMAGES, [])}


def _check_kind(path: Path, key: str, value: Any, parameter: click.Parameter) -> None:
    """Refuse values that would be converted in silence: 4.7 frames, or a blur of true."""
    kind, number = parameter.type, as_float(value)
    if getattr(parameter, "is_flag", False):
        good, expected = isinstance(value, bool), "true or false"
    elif kind is click.INT:
        good, expected = number is not None and number.is_integer(), "a whole number"
    elif kind is click.FLOAT:
        good, expected = number is not None and math.isfinite(number), "a finite number"
    elif parameter.name == OUTPUT:
        names = value if isinstance(value, list) else [value]
        good = all(isinstance(name, str) and name for name in names)
        expected = "a file name, or several"
    elif isinstance(kind, click.Choice) or kind is click.STRING:
        good, expected = isinstance(value, str), "a text"
    else:  # numbers with words of their own, pairs of them
        parts = value if isinstance(value, list) else [value]
        good = bool(parts) and all(
            isinstance(part, int | float | str) and not isinstance(part, bool) for part in parts
        )
        expected = "a number"
    if not good:
        raise InputError(f"{path}: {key} = {shown(value)}: expected {expected}")


def as_text(settings: Settings) -> Settings:
    """Return settings as files hold them: sorted, nothing unset, "balanced" for infinity."""
    return {name: _plain(settings[name]) for name in sorted(settings)}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    if isinstance(value, Path):
        return str(value)
    return "balanced" if isinstance(value, float) and math.isinf(value) else value


def as_toml(settings: Settings, images: Sequence[Path]) -> str:
    """Return settings as the text of a file that ``--config`` reads."""
    import tomli_w

    named = {IMAGES: [str(path) for path in images]} if images else {}
    return tomli_w.dumps(named | as_text(settings))


def recipe(
    settings: Settings, images: Sequence[Path], device: str, folder: Path | None = None
) -> dict[str, Any]:
    """Return what a file tells of its making: enough to make it again.

    Parameters
    ----------
    settings : dict
    images : sequence of Path
    device : str
    folder : Path, optional
        From where it is told in which folders the images lie, for people: `Named.images` looks
        for the names alone. Without it no folder is told, for files that get around.
    """
    from clmorph._shared.version import __version__

    return {
        "clmorph": __version__,
        # What does not change the picture is another run's own affair.
        "options": as_text({name: settings[name] for name in settings if name not in OWN}),
        IMAGES: [
            {"file": path.name, "sha256": digest(path)}
            | ({} if folder is None else {"folder": _folder(path, folder)})
            for path in images
        ],
        "device": device,
    }  # fmt: skip


def _folder(path: Path, start: Path) -> str:
    try:
        return os.path.relpath(path.parent, start)
    except ValueError:  # on another drive
        return str(path.parent.absolute())


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
