"""Run the work of several devices at the same time, one thread a device."""

import os
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import copy_context
from functools import partial
from queue import SimpleQueue
from typing import TypeAlias, TypeVar
from weakref import finalize

from clmorph.backends.cancellation import Cancellation, Cancelled, check_cancelled

T = TypeVar("T")
#: Tasks of threads; None ends one of them.
Queue: TypeAlias = "SimpleQueue[Callable[[], None] | None]"

#: Seconds of one wait for a thread. On Windows, Ctrl-C takes effect only between waits.
PATIENCE = 0.2


class Workers:
    """Threads that wait for work, because to start one takes as long as a small operation.

    They are started when they are first needed, and end with this object. They are daemons, like
    all threads of this module: a thread that waits must not keep the interpreter from its end.
    `opencl.devices.process` keeps daemons out of drivers then.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        #: The process that the threads belong to, as they do not survive a fork, and their queue.
        self._team: tuple[int, Queue] | None = None

    def run_at_once(self, tasks: Sequence[Callable[[], T]]) -> list[T]:
        """Run tasks at the same time, the first of them in the calling thread, and return results.

        If one fails, or the user interrupts the calling thread, the others stop at their next
        launch. All have ended when this method returns, or raises what the first task that failed
        has raised.
        """
        if len(tasks) == 1:
            return [tasks[0]()]
        stop = Cancellation()
        results: dict[int, T] = {}
        errors: dict[int, BaseException] = {}

        def run(number: int) -> None:
            try:
                with stop.applies():
                    check_cancelled()
                    results[number] = tasks[number]()
            except BaseException as error:
                errors[number] = error
                stop.request()

        ended: list[threading.Lock] = []
        try:
            with _waited_for(stop, lambda: _acquire(ended)):
                for number in range(1, len(tasks)):
                    ended.append(self._start(partial(run, number)))
                run(0)
            if errors:
                raise _first(errors)
        finally:
            errors.clear()  # an error refers to this function's variables, which refer to the error
        return [results[number] for number in range(len(tasks))]

    def _start(self, task: Callable[[], None]) -> threading.Lock:
        """Let a thread run a task, and return a lock that is released at the task's end."""
        team = self._team
        if team is None or team[0] != os.getpid():
            team = self._team = os.getpid(), self._engaged()
        running = threading.Lock()
        running.acquire()
        context = copy_context()  # settings of the caller, such as `numpy.errstate`

        def run() -> None:
            try:
                context.run(task)
            finally:
                running.release()

        team[1].put(run)
        return running

    def _engaged(self) -> Queue:
        """Start the threads, and return their queue."""
        queue: Queue = SimpleQueue()
        finalize(self, _dismiss, queue, self._count).atexit = False
        for _ in range(self._count):
            threading.Thread(target=_serve, args=(queue,), daemon=True).start()
        return queue


def _serve(queue: Queue) -> None:
    """Run the tasks of a queue, until there is a None."""
    while (task := queue.get()) is not None:
        task()
        del task  # it refers to clouds on the device


def _dismiss(queue: Queue, count: int) -> None:
    """End the threads that serve a queue."""
    for _ in range(count):
        queue.put(None)


@contextmanager
def _waited_for(stop: Cancellation, wait: Callable[[], None]) -> Iterator[None]:
    """Wait for other threads at the end of a `with` block; after an error in it they stop."""
    try:
        yield
    except BaseException:
        stop.request()
        raise
    finally:
        try:
            wait()
        except BaseException:
            stop.request()
            wait()
            raise


def _acquire(locks: Sequence[threading.Lock]) -> None:
    """Wait until all locks have been released once."""
    for lock in locks:
        while not lock.acquire(timeout=PATIENCE):
            pass
        lock.release()


def _join(threads: Sequence[threading.Thread]) -> None:
    for thread in threads:
        while thread.is_alive():  # not so if it was never started
            thread.join(PATIENCE)


def _first(errors: dict[int, BaseException]) -> BaseException:
    """Return the error to raise: a task that was stopped because of another one is no cause."""
    causes = [number for number, error in errors.items() if not isinstance(error, Cancelled)]
    return errors[min(causes or errors)]


def results_in_order(
    turns: Sequence[int], work: Callable[[int, int], T]
) -> Generator[T, None, None]:
    """Compute results in one thread a worker, and yield them in order.

    `turns` is the worker of each result, and `work` takes a worker and the number of a result. A
    worker waits with a finished result while the one before it has not been taken. So at most two
    results of each worker are in memory.
    """
    stop, changed = Cancellation(), threading.Condition()
    done: dict[int, T] = {}
    errors: dict[int, BaseException] = {}
    waiting = dict.fromkeys(turns, False)

    def run(worker: int) -> None:
        try:
            with stop.applies():
                for number in [place for place, turn in enumerate(turns) if turn == worker]:
                    check_cancelled()
                    result = work(worker, number)
                    with changed:
                        changed.wait_for(lambda: stop.requested or not waiting[worker])
                        done[number], waiting[worker] = result, True
                        changed.notify_all()
                    del result
        except BaseException as error:
            with changed:
                errors[worker] = error
                stop.request()
                changed.notify_all()

    def take(number: int, worker: int) -> T:
        with changed:
            while number not in done and not errors:
                changed.wait(PATIENCE)
                check_cancelled()
            if errors:
                raise Cancelled
            waiting[worker] = False
            changed.notify_all()
            return done.pop(number)

    threads = [
        threading.Thread(target=copy_context().run, args=(run, worker), daemon=True)
        for worker in waiting
    ]
    try:
        # With an error here `take` raises `Cancelled`, and so all threads end before the cause.
        with suppress(Cancelled), _waited_for(stop, lambda: _join(threads)):
            try:
                for thread in threads:
                    thread.start()
                for number, worker in enumerate(turns):
                    yield take(number, worker)
            finally:
                with changed:
                    stop.request()
                    changed.notify_all()
        check_cancelled()
        if errors:
            raise _first(errors)
    finally:
        errors.clear()
