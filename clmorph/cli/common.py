"""Common steps of several commands: reading pictures, choosing presets and opening a device."""

import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.files import check_place, is_standard_output
from clmorph._shared.validation import check_max_pixels
from clmorph.cli.terminal import NOTES, note, say
from clmorph.errors import ImageWarning, InputError, OutputError
from clmorph.pipeline.guides import Guided, guides, labeled
from clmorph.pipeline.maps import AUTO_LABELS, Maps, read_maps
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.recipe import picture_entries
from clmorph.pipeline.result import Morph

#: Pixels of the shorter side of a reduced picture below which little of it is left.
THIN = 8
#: A handler that keeps Python from printing log records without another handler.
SILENT = logging.NullHandler()


@contextmanager
def quiet_libraries() -> Iterator[list[warnings.WarningMessage]]:
    """Hide messages of Pillow about unusual metadata, and yield the warnings of clmorph itself.

    Such messages do not help the user, because clmorph itself checks pixels and recipes. Only the
    command line may use this function, because it changes the global state of the process.
    """
    log = logging.getLogger("PIL")
    log.addHandler(SILENT)
    try:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", ImageWarning)
            yield found
    finally:
        log.removeHandler(SILENT)


def read_picture(path: Path, max_pixels: int) -> Any:
    """Read an image as `clmorph.images.pixels.as_samples` has it; print its warnings as notes."""
    from clmorph.images.pixels import read_visible

    check_max_pixels(max_pixels)  # so that an error concerns the option, not the file
    with quiet_libraries() as found:
        pixels = read_visible(path, max_pixels)
    for remark in found:
        note(remark.message)
    return pixels


def note_thin(paths: Sequence[Path], pictures: Sequence[Any], options: Any) -> None:
    """Print a note about each picture whose shorter side is nearly lost when it is reduced."""
    from clmorph.images.pixels import reduced_shape

    if getattr(options, "detail", "") == "pixels":
        return  # blocks of sprites become pixels
    size = options.size
    for path, picture in zip(paths, pictures, strict=True):
        height, width = picture.shape[:2]
        down, across = reduced_shape((height, width), size or max(height, width))
        if min(down, across) < min(THIN, height, width):
            note(
                f"{path} of {width} x {height} pixels is reduced to {across} x {down} (--size), "
                "which leaves little of its shorter side; give a larger --size, or cut it"
            )


def note_warning(notes: list[Warning], message: Any, *others: Any, **more: Any) -> None:
    """Print a warning as a note and store it; the signature is that of `warnings.showwarning`."""
    from clmorph.cli.options import in_option_names

    notes.append(message)
    note(in_option_names(str(message)))


def device_name(device: str | None, backend: str | None) -> str:
    """Return the device that ``--device`` or ``--backend`` names; both may not differ."""
    if device is not None and backend not in (None, "auto", "opencl"):
        raise InputError(f"--device {device} and --backend {backend} contradict: give one of them")
    return device or backend or "auto"


def open_backend(device: str | None, backend: str | None) -> Any:
    """Choose the device and print its name."""
    name = device_name(device, backend)
    from clmorph.backends.multi_device import sharing_notes
    from clmorph.backends.select import get_backend

    with NOTES.status("looking for OpenCL devices (the first time takes some seconds)"):
        operations = get_backend(name)
    say(f"device: {operations.description}")
    for each in sharing_notes(operations):
        note(each)
    return operations


def found_guides(
    pictures: Sequence[Any], pairs: Sequence[tuple[int, int]], options: MorphOptions, maps: Maps
) -> Guided:
    """Return the landmarks of morphs between pictures, and print what was found."""
    with quiet_libraries():
        guide = guides(pictures, pairs, options, maps)
    if guide.found:
        say(f"landmarks: {guide.found}")
    return guide


def found_labels(pictures: Sequence[Any], maps: Maps) -> Maps:
    """Return maps whose labels are arrays, and print what was found if they were "auto"."""
    with quiet_libraries():
        found, text = labeled(pictures, maps)
    if text:
        say(f"labels: {text}")
    return found


def beside_entries(beside: Mapping[str, Sequence[Path]], folder: Path | None) -> dict[str, Any]:
    """Return what a recipe says of files beside the pictures."""
    return {
        name: AUTO if tuple(paths) == AUTO_LABELS else picture_entries(paths, folder)
        for name, paths in beside.items()
    }


def note_misses(morph: Morph, names: str = "") -> None:
    """Print a note about landmarks that are missed by a pixel or more."""
    far = np.flatnonzero(morph.misses >= 1.0)
    if len(far):
        worst = int(np.argmax(morph.misses))
        which = "landmark" if len(far) == 1 else f"{len(far)} landmarks, most of all landmark"
        note(
            f"the warp misses {which} {worst + 1} by {morph.misses[worst]:.2g} pixels{names}: "
            "others nearby move otherwise"
        )


def chosen_preset(preset: str, options: MorphOptions) -> str:
    """Return a line about the preset of the pictures, and which options differ from it."""
    usual = MorphOptions(preset=preset)
    given = [
        name for name in PRESETS[preset].options if getattr(options, name) != getattr(usual, name)
    ]
    other = f"; given otherwise: {', '.join(given)}" if given else " (--preset takes another)"
    return f"preset: {preset}, for what the pictures show{other}"


def recipe_places(outputs: Sequence[Path]) -> list[Path]:
    """Return the paths of the recipes beside outputs, or raise OutputError if one is a folder."""
    found = []
    for output in outputs:
        if is_standard_output(output):
            raise OutputError(
                "--recipe writes a file beside the output, and standard output is not a file: "
                "leave it out, or name a file"
            )
        # Paths without a name, such as ``.``, are resolved.
        named = output if output.name not in ("", "..") else output.resolve()
        found.append(named.with_name(f"{named.name}.json") if named.name else named / ".json")
        if check_place(found[-1]).is_dir():
            raise OutputError(f"{found[-1]} is a folder; choose another name for the output")
    return found


def read_beside(labels: Sequence[Path], features: Sequence[Path], max_pixels: int) -> Maps:
    """Read label images and features as `read_maps` does, and print warnings as notes."""
    check_max_pixels(max_pixels)
    with quiet_libraries() as found:
        maps = read_maps(labels, features, max_pixels)
    for remark in found:
        note(remark.message)
    return maps
