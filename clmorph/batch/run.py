"""Send jobs to workers, a few ahead of what they do, and collect the records."""

from collections.abc import Iterator, Sequence
from typing import Any

from clmorph._shared.printable import reason_of
from clmorph.batch.jobs import Job
from clmorph.batch.task import record_of, run_job
from clmorph.errors import DeviceError

#: Jobs that wait at the scheduler for each thread of its workers, and at least.
AHEAD, LEAST = 2, 8


def run_jobs(client: Any, jobs: Sequence[tuple[Job, str]], device: str) -> Iterator[dict[str, Any]]:
    """Yield the record of each job as it ends.

    A worker that dies has its job done by another one; a job during which several workers die
    is recorded as failed.

    Parameters
    ----------
    client : distributed.Client
    jobs : sequence of (Job, identity)
    device : str
        What `clmorph.get_backend` takes on the workers.

    Raises
    ------
    DeviceError
        If the scheduler has gone.
    """
    from distributed import as_completed

    waiting = iter(jobs)
    known: dict[Any, tuple[Job, str]] = {}
    ended = as_completed()

    def send() -> bool:
        for job, key in waiting:
            # One key a submission: results of an earlier run that Dask remembers are not wanted.
            future = client.submit(run_job, job, key, device, pure=False)
            known[future] = job, key
            ended.add(future)
            return True
        return False

    try:
        while len(known) < _ahead(client) and send():
            pass
        for future in ended:
            job, key = known.pop(future)
            yield _record(future, job, key)
            while len(known) < _ahead(client) and send():
                pass
    finally:
        # A run that ends early takes its jobs back.
        client.cancel(list(known))


def _ahead(client: Any) -> int:
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    return max(LEAST, AHEAD * sum(worker["nthreads"] for worker in workers))


def _record(future: Any, job: Job, key: str) -> dict[str, Any]:
    from distributed import KilledWorker

    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise DeviceError(
            "the scheduler has gone, or has dropped the jobs; start the same command again: only "
            "what is missing is done"
        )
    error = future.exception()
    if isinstance(error, KilledWorker):
        line = "the workers that tried it ended: out of memory, perhaps; use a smaller size"
    else:
        line = f"{type(error).__name__}: {reason_of(error)}"
    return record_of(job, key, status="failed", line=line, seconds=None)
