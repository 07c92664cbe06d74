"""Send jobs to workers, a few ahead of what they do, and collect the records."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from clmorph._shared.printable import reason_of
from clmorph._shared.validation import shown
from clmorph.batch.extra import check_client, check_device
from clmorph.batch.jobs import Defaults, Job, from_pairs
from clmorph.batch.task import record_of, run_job
from clmorph.errors import DeviceError, InputError
from clmorph.images.pixels import MAX_PIXELS
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS

Pairs = Iterable[tuple[Any, Any, Any]]

#: Jobs that wait at the scheduler for each thread of its workers, and at least.
AHEAD, LEAST = 2, 8
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
