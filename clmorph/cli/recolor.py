"""The command ``clmorph recolor``: one picture takes the colors of another one."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clmorph._shared.files import write_together
from clmorph.cli.request import Request
from clmorph.cli.terminal import noted_warnings, quiet_libraries, read_picture
from clmorph.clips.reading import is_clip
from clmorph.clips.writing import CONTAINERS
from clmorph.errors import FileError, InputError
from clmorph.images.looks import Lut, read_lut
from clmorph.images.resizing import as_unit
from clmorph.output.luts import check_lut_place, nodes_of, put_lut
from clmorph.output.picture import check_picture_place, write_picture
from clmorph.pipeline.clips import ClipRecoloring, check_clip_place, container_of
from clmorph.pipeline.luts import graded, lut_of
from clmorph.pipeline.recolor import check_for_picture, feathered, recolored


def run_recolor(request: Request, size: int | None) -> None:
    """Recolor the photo, write files and a summary; tables have `size` nodes, None: as usual."""
    options = request.options
    request.check_files()
    kinds = map(container_of, request.outputs, request.formats)
    if is_clip(request.images[0]) or any(kind in CONTAINERS for kind in kinds):
        _recolor_clip(request)
        return
    check_for_picture(options)
    places = list(map(check_picture_place, request.outputs, request.formats))
    tables = [(check_lut_place(lut), lut) for lut in request.tables]
    lut = _read_lut(request)
    photo, *others = map(as_unit, request.read())
    mask = _read_mask(request, photo.shape) if "mask" in request.beside else None
    operations = request.open()
    with request.stages() as stages, noted_warnings():
        look = None
        if lut is not None:
            mask = feathered(mask, options.feather)
            found = graded(photo, lut, mask, options.strength, operations)
        else:
            found, look = recolored(photo, others[0], options, mask, operations, stages)
        written = [
            (*each, partial(put_lut, lut_of(look, size or nodes_of(each[0]), stages)))
            for each in tables
        ]
        stages("files", 0.0)
        parameters = request.metadata(options, operations)
        pictures = [
            (place, path, partial(write_picture, found, parameters, format=format))
            for place, path, format in zip(places, request.outputs, request.formats, strict=True)
        ]
        write_together([*pictures, *written], request.texts(options, operations))
        stages("files", 1.0)
        summary = {
            "outputs": [str(path) for path in [*request.outputs, *request.tables]],
            "size": [photo.shape[1], photo.shape[0]],
            "mean_change": round(float(np.abs(found - photo)[..., :3].mean()), 6),
            **parameters,
        }
    changed = 255 * summary["mean_change"]
    request.finish(
        summary, stages,
        f"{photo.shape[1]} x {photo.shape[0]} pixels, colors changed by {changed:.0f} of 255 on "
        "average",
    )  # fmt: skip


def _recolor_clip(request: Request) -> None:
    """Recolor a clip, write the output files, and print a summary."""
    places = list(map(check_clip_place, request.outputs, request.formats))
    for name, given in (("mask", request.beside.get("mask")), ("export-lut", request.tables)):
        if given:
            raise InputError(f"--{name} is for pictures: leave it out for a clip")
    clip, options = request.images[0], request.options
    lut = _read_lut(request)
    like: Any = lut
    if lut is None:
        like = as_unit(read_picture(request.images[1], request.max_pixels))
    operations = request.open()
    with request.stages() as stages, noted_warnings():
        recoloring = ClipRecoloring(clip, like, options, operations, request.max_pixels, stages)
        parameters = request.metadata(options, operations)
        counts: list[int] = []

        def write(container: str, file: Path) -> None:
            counts.append(recoloring.write(file, container, parameters, stages))

        writers = [
            (place, path, partial(write, container_of(path, format)))
            for place, path, format in zip(places, request.outputs, request.formats, strict=True)
        ]
        write_together(writers, request.texts(options, operations))
        stages.count("files")
        summary = {
            "outputs": [str(path) for path in request.outputs],
            "size": list(recoloring.size),
            "frames": counts[0],
            **parameters,
        }
    width, height = recoloring.size
    request.finish(summary, stages, f"{counts[0]} frames of {width} x {height} pixels")


def _read_lut(request: Request) -> Lut | None:
    """Return the table that is given in place of a second picture, or None."""
    for path in request.beside.get("lut", ()):
        with quiet_libraries():
            return read_lut(path, request.max_pixels)
    return None


def _read_mask(request: Request, shape: Sequence[int]) -> Any:
    """Return the mask as an (H, W) array in [0, 1], by luminance and opacity."""
    from clmorph.images.color import LUMINANCE

    (path,) = request.beside["mask"]
    pixels = as_unit(read_picture(path, request.max_pixels))
    if pixels.shape[:2] != tuple(shape[:2]):
        raise FileError(
            f"{path} has {pixels.shape[1]} x {pixels.shape[0]} pixels: expected those of "
            f"{request.images[0]}, {shape[1]} x {shape[0]}"
        )
    gray = pixels[..., :3] @ LUMINANCE
    return np.clip(gray * (pixels[..., 3] if pixels.shape[2] == 4 else 1.0), 0.0, 1.0)
