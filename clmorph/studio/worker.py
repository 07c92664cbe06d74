"""One thread does the work of all tabs, because a device is one."""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

from clmorph.backends.cancellation import Cancellation, Cancelled

#: What a job is for: a preview gives way to everything newer of its tab.
Kind = Literal["preview", "run", "save"]


@dataclass(eq=False)
class Job:
    """A piece of work."""

    #: The tab.
    owner: str
    kind: Kind
    #: It reports its result and its errors itself.
    work: Callable[[], None]
    #: Called once if the job was cancelled, before it began or in the middle.
    dropped: Callable[[], None] = lambda: None
    cancellation: Cancellation = field(default_factory=Cancellation)


class Worker:
    """A thread that does jobs in the order in which they came."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: list[Job] = []
        self._current: Job | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="clmorph-studio", daemon=True)
        self._thread.start()

    def submit(self, job: Job, replaces: Iterable[Kind] = ()) -> int:
        """Add a job, cancel those it replaces; return the number of other tabs' jobs before it."""
        self.cancel(job.owner, replaces)
        with self._changed:
            self._waiting.append(job)
            before = [*self._waiting, *([self._current] if self._current else [])]
            self._changed.notify()
        return sum(other.owner != job.owner for other in before)

    def cancel(self, owner: str, kinds: Iterable[Kind]) -> None:
        """Request that a tab's jobs of some kinds stop; those that wait are dropped at once."""
        chosen = set(kinds)
        with self._changed:
            gone = [job for job in self._waiting if job.owner == owner and job.kind in chosen]
            self._waiting = [job for job in self._waiting if job not in gone]
            current = self._current
            if current is not None and current.owner == owner and current.kind in chosen:
                current.cancellation.request()
        for job in gone:
            job.dropped()

    def close(self, seconds: float) -> None:
        """Cancel everything, and wait for the thread to end, but no longer than `seconds`."""
        with self._changed:
            self._ended = True
            gone, self._waiting = self._waiting, []
            if self._current is not None:
                self._current.cancellation.request()
            self._changed.notify()
        for job in gone:
            job.dropped()
        self._thread.join(seconds)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or self._waiting)
                if self._ended:
                    return
                job = self._current = self._waiting.pop(0)
            try:
                with job.cancellation.applies():
                    job.work()
            except Cancelled:
                job.dropped()
            finally:
                with self._changed:
                    self._current = None
