"""When a process may use OpenCL: not after a fork, not while it ends, one thread at a time."""

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

#: The process that has turned to OpenCL; None before.
_owner: int | None = None
#: Locks that are held while a thread is in a driver.
_device_locks: "weakref.WeakSet[threading.RLock]" = weakref.WeakSet()
#: Seconds that the end of a process waits for one of them.
_PATIENCE = 10.0


def claim_opencl() -> None:
    """Note that this process uses OpenCL; cheap enough for every operation.

    A driver's threads and locks do not survive ``fork``: in the child PoCL waits for ever, and
    other drivers may, even if the parent has only listed its platforms. To be called before
    any lock of this package is taken: a child also inherits locks that another thread of its
    parent held.

    Raises
    ------
    DeviceError
        If a parent of this process used OpenCL before the fork.
    """
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
    """Return a new lock, to be held by whoever calls a driver."""
    lock = threading.RLock()
    _device_locks.add(lock)
    return lock


@atexit.register
def _leave_drivers() -> None:
    """Keep daemon threads out of drivers while the interpreter ends.

    It stops such a thread where that next takes the interpreter's lock; if C++ called it
    there, as pyopencl does, the whole process aborts. A thread that waits for a lock of ours
    just stays there.
    """
    if _owner == os.getpid():  # a forked child has no thread that would release them
        for lock in list(_device_locks):
            lock.acquire(timeout=_PATIENCE)


class Once(Generic[P, T]):
    """A function that uses OpenCL and remembers its results: a `functools.cache` for threads.

    Threads that ask at the same time wait for the first one's result instead of working it
    out as well. An error is not remembered.

    Parameters
    ----------
    function : callable
        Its arguments are hashable.
    """

    def __init__(self, function: Callable[P, T]) -> None:
        self.__wrapped__ = function
        self._cached = cache(function)
        self._lock = threading.RLock()
        update_wrapper(self, function)

    def __call__(self, *arguments: P.args, **options: P.kwargs) -> T:
        """Return what the function returned for these arguments."""
        claim_opencl()
        with self._lock:
            return self._cached(*arguments, **options)  # type: ignore[arg-type]

    def cache_clear(self) -> None:
        """Forget all results."""
        self._cached.cache_clear()
