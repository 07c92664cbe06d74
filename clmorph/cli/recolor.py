"""The command ``clmorph recolor``: one picture takes the colors of another one."""

import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from clmorph._shared.printable import printable
from clmorph.cli.common import note_warning, read_picture
from clmorph.cli.request import Request
from clmorph.errors import FileError
from clmorph.images.resizing import as_unit
from clmorph.output.cube import check_cube_place, write_cube
from clmorph.output.picture import check_picture_place, write_picture
from clmorph.output.together import write_together
from clmorph.pipeline.recolor import lattice, recolored


def run_recolor(request: Request, size: int) -> None:
    """Recolor the photo, write the output files, and print a summary.

    Tables of colors have `size` levels a channel.
    """
    options = request.options
    request.check_files()
    places = list(map(check_picture_place, request.outputs, request.formats()))
    luts = request.tables
    tables = [(check_cube_place(lut), lut) for lut in luts]
    photo, like = map(as_unit, request.read())
    mask = _read_mask(request, photo.shape) if request.beside else None
    operations = request.open()
    with request.stages() as stages, warnings.catch_warnings():
        warnings.showwarning = partial(note_warning, [])
        stages.count("preparation")
        table = lattice(size) if luts else None
        found = recolored(photo, like, options, mask, operations, stages, table)
        stages("files", 0.0)
        parameters = request.metadata(options, operations)
        write_together(
            [
                *(
                    (place, path, partial(write_picture, found, parameters, format=format))
                    for place, path, format in zip(
                        places, request.outputs, request.formats(), strict=True
                    )
                ),
                *(
                    (*each, partial(write_cube, table.reshape(size, size, size, 3)))
                    for each in tables
                    if table is not None
                ),
            ],
            request.texts(options, operations),
        )
        stages("files", 1.0)
        summary = {
            "outputs": [str(path) for path in [*request.outputs, *luts]],
            "size": [photo.shape[1], photo.shape[0]],
            "mean_change": round(float(np.abs(found - photo)[..., :3].mean()), 6),
            **parameters,
        }
    request.finish(summary, stages, partial(_last_line, request))


def _read_mask(request: Request, shape: Sequence[int]) -> Any:
    """Return the mask as an (H, W) array in [0, 1], by luminance and opacity."""
    from clmorph.images.gamut import LUMINANCE

    (path,) = request.beside["mask"]
    pixels = as_unit(read_picture(path, request.max_pixels))
    if pixels.shape[:2] != tuple(shape[:2]):
        raise FileError(
            f"{path} has {pixels.shape[1]} x {pixels.shape[0]} pixels: expected those of "
            f"{request.images[0]}, {shape[1]} x {shape[0]}"
        )
    gray = pixels[..., :3] @ LUMINANCE
    return np.clip(gray * (pixels[..., 3] if pixels.shape[2] == 4 else 1.0), 0.0, 1.0)


def _last_line(request: Request, summary: dict[str, Any]) -> str:
    """Return the summary of the run for people."""
    names = ", ".join(printable(path) for path in summary["outputs"])
    width, height = summary["size"]
    return (
        f"{names}: {width} x {height} pixels, colors changed by {255 * summary['mean_change']:.0f} "
        f"of 255 on average, made in {summary['seconds']['total']:.1f} s"
    )
