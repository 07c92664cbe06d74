"""The command ``clmorph morph`` with a clip: one becomes the other while both play."""

from typing import Any

from clmorph.cli.common import read_picture
from clmorph.cli.request import Request
from clmorph.clips.reading import is_clip
from clmorph.errors import InputError
from clmorph.images.resizing import as_unit
from clmorph.pipeline.clip_morph import EVERY, clip_film
from clmorph.pipeline.clip_writing import check_clip_outputs, write_clip_film


def has_clip(request: Request) -> bool:
    """Return whether one of the pictures is a clip."""
    return any(map(is_clip, request.images))


def run_clips(request: Request) -> None:
    """Write a film in which one becomes the other, and print a summary."""
    options, places = request.options, request.places
    check_clip_outputs(places)
    request.check_files()
    if len(request.images) != 2:
        raise InputError(
            f"{len(request.images)} pictures and clips are given: expected two, of which one or "
            "both are clips"
        )
    if request.beside:
        raise InputError(f"--{next(iter(request.beside))} is for stills: leave it out for a clip")
    if "size" not in request.named:
        options = options.replace(size=None)
    ends = [
        path if is_clip(path) else as_unit(read_picture(path, request.max_pixels))
        for path in request.images
    ]
    with request.stages() as stages:
        operations = request.open()
        film = clip_film(
            ends[0], ends[1], options, options.fps if "fps" in request.named else None, EVERY,
            request.max_pixels, operations, stages,
        )  # fmt: skip
        if options.duration is None:  # the recipe has the rate of the film
            options = options.replace(fps=float(film.rate))
        parameters = request.metadata(options, operations)
        frames = write_clip_film(film, places, parameters, request.texts(options, operations))
        summary: dict[str, Any] = {
            "outputs": request.written,
            "frames": frames,
            "transition": film.count,
            "fps": float(film.rate),
            "sizes": [list(film.size)],
            **parameters,
        }
    request.finish(summary, stages, f"{frames} frames, {frames / summary['fps']:.3g} s")
