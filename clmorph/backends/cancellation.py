"""Stop the work of threads for Ctrl-C, which interrupts the main one alone."""

import contextlib
import threading
from collections.abc import Iterator
from contextvars import ContextVar


class Cancelled(BaseException):
    """The work of this thread is no longer wanted; no user sees this exception."""


class Cancellation:
    """A request to stop the work inside `applies` in any thread, as the request `outer` does."""

    def __init__(self, outer: "Cancellation | None" = None) -> None:
        self._outer = outer or _current.get()
        self._requested = threading.Event()

    def request(self) -> None:
        """Request that the work stops."""
        self._requested.set()

    @property
    def requested(self) -> bool:
        """Whether the work must stop."""
        if self._requested.is_set():
            return True
        return self._outer is not None and self._outer.requested

    @contextlib.contextmanager
    def applies(self) -> Iterator[None]:
        """Let the request hold for the work in a `with` block."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)


_current: ContextVar[Cancellation | None] = ContextVar("clmorph_cancellation", default=None)


def check_cancelled() -> None:
    """Raise `Cancelled` if the work of this thread must stop."""
    current = _current.get()
    if current is not None and current.requested:
        raise Cancelled
