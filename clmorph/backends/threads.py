"""Compute results on several devices at the same time, one thread a device."""

import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from contextvars import copy_context
from typing import TypeVar

from clmorph.backends.cancellation import Cancellation, Cancelled, check_cancelled

T = TypeVar("T")

#: Seconds of one wait for a thread. On Windows, Ctrl-C takes effect only between waits.
PATIENCE = 0.2


def _join(threads: Sequence[threading.Thread]) -> None:
    for thread in threads:
        while thread.is_alive():  # not so if it was never started
            thread.join(PATIENCE)


def results_in_order(
    turns: Sequence[int], work: Callable[[int, int], T]
) -> Generator[T, None, None]:
    """Yield results in order: `work(worker, number)` by a thread for each worker of `turns`."""
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
                    # So at most two results of each worker are in memory.
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
        with suppress(Cancelled):
            try:
                for thread in threads:
                    thread.start()
                for number, worker in enumerate(turns):
                    yield take(number, worker)
            finally:
                with changed:
                    stop.request()
                    changed.notify_all()
                try:
                    _join(threads)
                except BaseException:  # Ctrl-C; they stop soon
                    _join(threads)
                    raise
        check_cancelled()
        if errors:
            # A task that was stopped because of another one is no cause.
            causes = [number for number, each in errors.items() if not isinstance(each, Cancelled)]
            raise errors[min(causes or errors)]
    finally:
        errors.clear()
