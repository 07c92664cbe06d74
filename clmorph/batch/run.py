"""Send jobs to workers, a few ahead of what they do, and collect the records."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from clmorph._shared.printable import reason_of
from clmorph.batch.jobs import Job
from clmorph.batch.task import record_of, run_job
from clmorph.errors import DeviceError

#: Jobs that wait at the scheduler for each thread of its workers, and at least.
AHEAD, LEAST = 2, 8
#: What is said when the scheduler has gone; the reason is in parentheses.
GONE = (
    "the scheduler has gone, or has dropped the jobs{}; start the same command again: only what "
    "is missing is done"
)


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
