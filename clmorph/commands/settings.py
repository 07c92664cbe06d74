"""Settings of a run: presets, files that hold some, and what the command line says."""

import difflib
import hashlib
import math
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clmorph.defaults import PRESETS
from clmorph.errors import InputError
from clmorph.formats.embedding import read_parameters

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


def read_settings(path: Path, names: Sequence[str]) -> Settings:
    """Read settings from TOML, from a recipe (JSON), or from a file that clmorph has written.

    Parameters
    ----------
    path : Path
    names : sequence of str
        Of the options that there are.

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
    if path.suffix.lower() == ".toml":
        try:
            with path.open("rb") as stream:
                found = tomllib.load(stream)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: not TOML ({' '.join(str(error).split())})") from None
    else:
        told = read_parameters(path)
        if "options" not in told:
            raise InputError(
                f"{path} was saved from Python, with what clmorph.morph was called with, and "
                "holds no settings of the command line"
            )
        found = {**told["options"], IMAGES: told.get(IMAGES, [])}
    settings: Settings = {}
    known = [*names, IMAGES, OUTPUT, PRESET]
    for key, value in found.items():
        name = key.replace("-", "_")
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"expected {', '.join(known)}"
            raise InputError(f"{path}: unknown setting {key!r}; {hint}")
        settings[name] = value
    images = settings.get(IMAGES, [])
    if not isinstance(images, list) or not all(isinstance(image, str | dict) for image in images):
        raise InputError(f"{path}: {IMAGES}: expected a list of file names")
    settings[IMAGES] = [_found_image(image, path.parent) for image in images]
    if OUTPUT in settings:
        outputs = settings[OUTPUT]
        outputs = outputs if isinstance(outputs, list) else [outputs]
        settings[OUTPUT] = [str(path.parent / str(output)) for output in outputs]
    return settings


def _found_image(entry: str | Mapping[str, Any], folder: Path) -> tuple[Path, str | None]:
    """Return where an image of a settings file lies, and its digest then if that is known."""
    name = entry if isinstance(entry, str) else str(entry.get("file", ""))
    digest = None if isinstance(entry, str) else entry.get("sha256")
    beside = folder / name
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
        "options": as_text(settings),
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
