"""Jobs on workers: sent a few ahead, done by the same steps as ``clmorph morph``, and recorded."""

from __future__ import annotations

import base64
import io
import math
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.validation import check_progress, shown
from clmorph.backends.select import get_backend
from clmorph.batch.extra import TURN, check_client, check_device
from clmorph.batch.jobs import Defaults, Job, from_pairs
from clmorph.batch.places import is_remote, local_copy, local_output
from clmorph.errors import (
    ClmorphError,
    ClmorphWarning,
    ConvergenceWarning,
    DeviceError,
    InputError,
    MemoryWarning,
)
from clmorph.images.detail import is_pixel_art
from clmorph.images.pixels import MAX_PIXELS, read_visible
from clmorph.output.playback import held_frames, motion_of
from clmorph.output.recording import Recording
from clmorph.output.save import Output, recorded_for, write_all
from clmorph.pipeline.budget import default_memory
from clmorph.pipeline.maps import read_maps
from clmorph.pipeline.morph import ImagePair
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.prepare import recognized
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.recipe import picture_entries, recipe
from clmorph.pipeline.result import Morph

Pairs = Iterable[tuple[Any, Any, Any]]

#: Jobs that wait at the scheduler for each thread of its workers, and at least.
AHEAD, LEAST = 2, 8
#: Height in pixels of the thumbnails, and their frames in parts of the playback.
HEIGHT, SHOWN = 56, (0.0, 0.5, 1.0)
#: What is said when the scheduler has gone; the reason is in parentheses.
GONE = (
    "the scheduler has gone, or has dropped the jobs{}; start the same command again: only what "
    "is missing is done"
)


def morph(
    pairs: Pairs, *, client: Any, backend: str = "auto", preset: str | None = None, **options: Any
) -> Iterator[dict[str, Any]]:
    """Write the morphs of many pairs of files on Dask's workers; yield each as it ends.

    Parameters
    ----------
    pairs : iterable of (source, target, output)
        Paths on a disk that the workers share, or paths that fsspec opens (``s3://…``). The
        ending of an output chooses its format, as for `clmorph.save`.
    client : distributed.Client
        The client of a running scheduler.
    backend : str
        The device of each worker, as `clmorph.get_backend` takes it. "auto" is each worker's
        own choice, or what its environment's ``CLMORPH_DEVICE`` says.
    preset : str, optional
        As in `clmorph.morph`; "auto" if not given.
    **options
        Options of `clmorph.MorphOptions`, for all pairs.

    Yields
    ------
    dict
        ``output``, ``source``, ``target``, ``status`` ("done" or "failed"), ``line`` (the error of
        a failed pair in one line, or notes), ``seconds``, and for a pair that is done ``solver``,
        ``residual`` (in units of epsilon), ``iterations``, ``particles``, ``frames``, ``bytes``
        and ``device``.

    Raises
    ------
    InputError
        If an argument cannot be used, two outputs are the same, or Dask is not installed.
    DeviceError
        If the scheduler ends.

    Examples
    --------
    >>> import clmorph.batch
    >>> try:
    ...     clmorph.batch.morph([("a.png", "b.png", "out.gif")], client=None)
    ... except clmorph.InputError:
    ...     print("a client is needed")
    a client is needed
    """
    check_device(backend)
    if preset is not None and (not isinstance(preset, str) or preset not in (AUTO, *PRESETS)):
        names = ", ".join(map(repr, (AUTO, *PRESETS)))
        raise InputError(f"preset={shown(preset)}: expected one of {names}")
    MorphOptions(**options)  # raises an error about the options themselves
    jobs = from_pairs(pairs, Defaults("", options, preset, MAX_PIXELS))
    check_client(client)
    return run_jobs(client, [(job, "") for job in jobs], backend)


def run_jobs(client: Any, jobs: Sequence[tuple[Job, str]], device: str) -> Iterator[dict[str, Any]]:
    """Yield the record of each job as it ends; what workers died of is tried again, alone."""
    from distributed import as_completed

    waiting = iter(jobs)
    suspects: list[tuple[Job, str]] = []
    known: dict[Any, tuple[Job, str]] = {}
    ended = as_completed(loop=client.loop)

    def send(more: Iterator[tuple[Job, str]]) -> bool:
        for job, key in more:
            # One key a submission: results of an earlier run that Dask remembers are not wanted.
            with _reaching_the_scheduler():
                future = client.submit(run_job, job, key, device, pure=False)
            known[future] = job, key
            ended.add(future)
            return True
        return False

    try:
        while len(known) < _ahead(client) and send(waiting):
            pass
        for future in ended:
            job, key = known.pop(future)
            if _was_given_up(future):
                suspects.append((job, key))
            else:
                yield _record(future, job, key)
            while len(known) < _ahead(client) and send(waiting):
                pass
        alone = iter(suspects)
        while send(alone):
            for future in ended:
                yield _record(future, *known.pop(future))
    finally:
        # A run that ends early takes its jobs back, unless the scheduler has gone.
        with suppress(Exception):
            client.cancel(list(known))


@contextmanager
def _reaching_the_scheduler() -> Iterator[None]:
    """Say that the scheduler has gone: the client notices it in errors of many classes."""
    try:
        yield
    except Exception as error:
        raise DeviceError(GONE.format(f" ({reason_of(error)})")) from None


def _ahead(client: Any) -> int:
    with _reaching_the_scheduler():
        workers = client.scheduler_info(n_workers=-1)["workers"].values()
    return max(LEAST, AHEAD * sum(worker["nthreads"] for worker in workers))


def _was_given_up(future: Any) -> bool:
    from distributed import KilledWorker

    return future.status == "error" and isinstance(future.exception(), KilledWorker)


def _record(future: Any, job: Job, key: str) -> dict[str, Any]:
    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise DeviceError(GONE.format(""))
    error = future.exception()
    if _was_given_up(future):
        line = "the workers that tried it ended: out of memory, perhaps; use a smaller size"
    else:
        line = f"{type(error).__name__}: {reason_of(error)}"
    return record_of(job, key, status="failed", line=line, seconds=None)


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
        pair = ImagePair.of(whole, options, maps)
        options, operations = pair.options, get_backend(device)
        morph = pair.morph(operations, check_progress(None))

        def metadata() -> dict[str, Any]:
            entries = picture_entries(images)
            return recipe(
                options, images=entries, device=operations.description,
                beside={kind: picture_entries(paths) for kind, paths in beside.items()},
            )  # fmt: skip

        with recorded_for(
            [place], [morph], motion, reverse=options.reverse,
            pixelated=all(map(is_pixel_art, pair.images)), parameters=metadata(),
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
