"""What a worker does for one job: the same steps, and so the same bytes, as ``clmorph morph``."""

import base64
import io
import math
import time
import warnings
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.validation import check_progress
from clmorph.backends.select import get_backend
from clmorph.batch.extra import TURN
from clmorph.batch.jobs import Job
from clmorph.batch.places import is_remote, local_copy, local_output
from clmorph.errors import ClmorphError, ClmorphWarning, ConvergenceWarning, MemoryWarning
from clmorph.images.detail import is_pixel_art
from clmorph.images.pixels import read_visible
from clmorph.output.playback import held_frames, motion_of
from clmorph.output.recording import Recording
from clmorph.output.save import Output, recorded_for, write_all
from clmorph.pipeline.budget import default_memory
from clmorph.pipeline.guides import guides
from clmorph.pipeline.maps import read_maps
from clmorph.pipeline.morph import ImagePair, shapes_of
from clmorph.pipeline.prepare import fitted, recognized
from clmorph.pipeline.recipe import picture_entries, recipe
from clmorph.pipeline.result import Morph

#: Height in pixels of the thumbnails, and their frames in parts of the playback.
HEIGHT, SHOWN = 56, (0.0, 0.5, 1.0)


def run_job(job: Job, key: str, device: str) -> dict[str, Any]:
    """Do one job whose identity is `key`, and return its record; an error becomes one, too."""
    began = time.perf_counter()
    try:
        with TURN, warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", ClmorphWarning)
            warnings.simplefilter("ignore", ConvergenceWarning)
            known = _done(job, device, found)
        line = "; ".join(str(each.message) for each in found)
        more = {"status": "done", "line": line, **known}
    except ClmorphError as error:
        more = {"status": "failed", "line": str(error)}
    except MemoryError:
        more = {"status": "failed", "line": "not enough memory; use a smaller size"}
    except Exception as error:  # one job must not end the others, whatever a driver raises
        more = {"status": "failed", "line": f"{type(error).__name__}: {reason_of(error)}"}
    seconds = round(time.perf_counter() - began, 3)
    return record_of(job, key, seconds=seconds, **more)


def record_of(job: Job, key: str, **more: Any) -> dict[str, Any]:
    """Return the record of a job for the journal."""
    more["line"] = printable(more.get("line", ""), MESSAGE)
    return {
        "output": job.output, "source": job.source, "target": job.target, "where": job.where,
        "key": key, **more,
    }  # fmt: skip


def _done(job: Job, device: str, notes: list[warnings.WarningMessage]) -> dict[str, Any]:
    with ExitStack() as stack:
        images = [stack.enter_context(local_copy(place)) for place in (job.source, job.target)]
        beside = {
            kind: [stack.enter_context(local_copy(place)) for place in two]
            for kind, two in job.beside.items()
        }
        path = stack.enter_context(local_output(job.output))
        place = Output(path)
        most = job.defaults.max_pixels
        whole = [read_visible(image, most) for image in images]
        options = job.settled(recognized(whole) if job.preset is None else job.preset)
        motion = motion_of(options, held_frames(2, options.n_frames))
        place.check_motion(motion)
        maps = read_maps(beside.get("labels", ()), beside.get("features", ()), most)
        options = guides(whole, [(0, 1)], options, maps).of(0)
        pictures = fitted(whole, options)
        operations = get_backend(device)
        morph = ImagePair(pictures, options, shapes_of(whole), maps).morph(
            operations, check_progress(None)
        )

        def metadata() -> dict[str, Any]:
            entries = picture_entries(images)
            return recipe(
                options, images=entries, device=operations.description,
                beside={kind: picture_entries(paths) for kind, paths in beside.items()},
            )  # fmt: skip

        with recorded_for(
            [place], [morph], motion, reverse=options.reverse,
            pixelated=all(map(is_pixel_art, pictures)), parameters=metadata(),
        ) as film:  # fmt: skip
            gave_way = any(isinstance(each.message, MemoryWarning) for each in notes)
            if gave_way and options.max_memory is None:
                # As in `clmorph morph`: the recipe contains the limit that reduced the particles.
                options = options.replace(max_memory=default_memory(operations))
                film = replace(film, parameters=metadata())
            write_all([place], film, options)
            files = [each for each in (path, *path.rglob("*")) if each.is_file()]
            return _figures(morph, film) | {
                "device": operations.description,
                "bytes": sum(each.stat().st_size for each in files),
                "remote": is_remote(job.output),
            }


def _figures(morph: Morph, film: Recording) -> dict[str, Any]:
    """Return the figures and the thumbnail of a morph for the index."""
    potentials = morph.potentials
    residual = float(potentials.residual)
    return {
        "solver": potentials.status,
        "residual": residual if math.isfinite(residual) else None,
        "iterations": int(potentials.n_iter),
        "particles": len(morph.particles),
        "frames": len(film),
        "thumbnail": _thumbnail(film),
    }


def _thumbnail(film: Recording) -> str:
    """Return three frames side by side as a data URI."""
    parts = []
    for share in SHOWN:
        image = Image.fromarray(_visible(film.picture(round(share * (len(film) - 1)))))
        width = max(1, min(3 * HEIGHT, round(image.width * HEIGHT / image.height)))
        small = image.height < HEIGHT
        way = Image.Resampling.NEAREST if small else Image.Resampling.BOX
        parts.append(image.resize((width, HEIGHT), way))
    strip = Image.new("RGB", (sum(part.width for part in parts) + 4, HEIGHT), "white")
    left = 0
    for part in parts:
        strip.paste(part, (left, 0))
        left += part.width + 2
    file = io.BytesIO()
    strip.save(file, "JPEG", quality=80)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode()


def _visible(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture without opacity, before white."""
    if picture.shape[2] == 3:
        return picture
    opacity = picture[..., 3:] / 255.0
    return np.asarray(np.rint(picture[..., :3] * opacity + 255 * (1 - opacity)), np.uint8)
