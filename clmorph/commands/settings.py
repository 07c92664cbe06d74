"""Settings of a run: presets, files that hold some, and what the command line says."""

import difflib
import hashlib
import inspect
import math
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from clmorph import defaults
from clmorph.checks import shown
from clmorph.defaults import PRESETS
from clmorph.errors import InputError
from clmorph.formats.embedding import read_parameters
from clmorph.images import MAX_PIXELS
from clmorph.morph import check_options

Settings = dict[str, Any]

#: Of each of these only one can hold: a later layer's takes the place of an earlier one's.
ALTERNATIVES = (
    ("blur", "epsilon"),
    ("reach", "rho"),
    ("fps", "duration"),
    ("sample", "barycentric"),
)
#: What a file of settings may hold beside options.
IMAGES, OUTPUT, PRESET = "images", "output", "preset"


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
                if name in layer and other not in layer:
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
        By option names with underscores, with `IMAGES`, `OUTPUT` and `PRESET` if they are there.

    Raises
    ------
    InputError
        If it cannot be read or holds something unknown.
    """
    if not path.exists():
        raise InputError(f"--config {path}: no such file")
    found = _toml(path) if path.suffix.lower() == ".toml" else _told(path)
    known = {str(parameter.name): parameter for parameter in parameters}
    settings: Settings = {}
    for key, value in found.items():
        name = key.replace("-", "_")
        if name not in known and name != IMAGES:
            near = difflib.get_close_matches(name, [*known, IMAGES], 1)
            hint = f"did you mean {near[0]!r}?" if near else "clmorph morph --help lists them"
            raise InputError(f"{path}: unknown setting {key!r}; {hint}")
        if name != IMAGES:
            _check_kind(path, key, value, known[name])
        settings[name] = value
    images = settings.get(IMAGES, [])
    named = isinstance(images, list) and all(
        isinstance(entry.get("file") if isinstance(entry, dict) else entry, str) for entry in images
    )
    if not named:
        raise InputError(f"{path}: {IMAGES}: expected a list of file names")
    settings[IMAGES] = [_found_image(image, path) for image in images]
    if OUTPUT in settings:
        outputs = settings[OUTPUT]
        outputs = outputs if isinstance(outputs, list) else [outputs]
        settings[OUTPUT] = [str(path.parent / output) for output in outputs]
    return settings


def _toml(path: Path) -> Settings:
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not TOML ({' '.join(str(error).split())})") from None


def _told(path: Path) -> Settings:
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
    kind = parameter.type
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if getattr(parameter, "is_flag", False):
        good, expected = isinstance(value, bool), "true or false"
    elif kind is click.INT:
        whole = isinstance(value, int) or (isinstance(value, float) and value.is_integer())
        good, expected = number and whole, "a whole number"
    elif kind is click.FLOAT:
        good, expected = number and _is_finite(value), "a number, a finite one"
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


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond what floats hold
        return False


def _found_image(entry: str | Mapping[str, Any], config: Path) -> tuple[Path, str | None]:
    """Return where an image of a settings file lies, and its digest then if that is known."""
    name = entry if isinstance(entry, str) else str(entry["file"])
    digest = None if isinstance(entry, str) else entry.get("sha256")
    beside = config.parent / name
    return (beside if beside.exists() else Path(name)), digest


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
        Where the images' places are seen from; without one only their names are told, for
        files that get around.
    """
    from clmorph.release import __version__

    return {
        "clmorph": __version__,
        # The format is the output's own: another run can have another.
        "options": as_text({name: settings[name] for name in settings if name != "format"}),
        IMAGES: [
            {
                "file": path.name if folder is None else os.path.relpath(path, folder),
                "sha256": digest(path),
            }
            for path in images
        ],
        "device": device,
    }  # fmt: skip


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
