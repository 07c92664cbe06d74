"""Restrict when a process uses OpenCL: not after a fork, not at exit, in one thread at a time."""

import atexit
import os
import threading
import weakref
from collections.abc import Callable
from functools import cache, update_wrapper
from typing import Generic, ParamSpec, TypeVar

from clmorph.errors import DeviceError

P = ParamSpec("P")
T = TypeVar("T")

#: The process that has started to use OpenCL; None before.
_owner: int | None = None
#: Locks, each of which is held while a thread is in a driver.
_device_locks: "weakref.WeakSet[threading.RLock]" = weakref.WeakSet()
#: Seconds for which the end of a process waits for one of these locks.
_PATIENCE = 10.0


def claim_opencl() -> None:
    """Record that this process uses OpenCL, or refuse it after a fork; before any lock is taken."""
    # A driver's threads and locks do not survive a fork, nor do locks that other threads held.
    global _owner
    process = os.getpid()
    if _owner == process:
        return
    if _owner is not None:
        raise DeviceError(
            "OpenCL cannot be used in a process that was forked from one that has used it: start "
            "processes with multiprocessing.get_context('spawn'), or use the backend 'numpy'"
        )
    _owner = process


def device_lock() -> "threading.RLock":
    """Return a new lock, which a thread must hold while it calls a driver."""
    lock = threading.RLock()
    _device_locks.add(lock)
    return lock


@atexit.register
def _leave_drivers() -> None:
    """Keep daemon threads out of drivers while the interpreter ends."""
    # A thread that is stopped while C++ code takes the interpreter's lock aborts the process; one
    # that waits for a lock of this module just keeps waiting.
    if _owner == os.getpid():  # a forked child has no thread that would release the locks
        for lock in list(_device_locks):
            lock.acquire(timeout=_PATIENCE)


class Once(Generic[P, T]):
    """A `functools.cache` for functions that use OpenCL; threads wait for the first result."""

    def __init__(self, function: Callable[P, T]) -> None:
        self.__wrapped__ = function
        self._cached = cache(function)
        self._lock = threading.RLock()
        update_wrapper(self, function)

    def __call__(self, *arguments: P.args, **options: P.kwargs) -> T:
        """Return the function's result for these arguments."""
        claim_opencl()
        with self._lock:
            return self._cached(*arguments, **options)  # type: ignore[arg-type]

    def cache_clear(self) -> None:
        """Forget all results."""
        self._cached.cache_clear()
