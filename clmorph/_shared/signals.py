"""SIGTERM and SIGHUP end the command line as Ctrl-C does: nothing half-written is left.

Handlers are installed by the command line alone, in the main thread alone, and only in place of
the system's own: what a caller has set, or ignores (``nohup``), stays. The library never installs
any; `undisturbed` does nothing there.
"""

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from types import FrameType
from typing import Any

#: Signals that end a run; SIGHUP is not known everywhere.
ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
#: Seconds for which further signals are ignored, so that they do not interrupt the clearing up.
PATIENCE = 5.0
#: Seconds after which a signal is given again that arrived where nothing can be raised.
SOON = 0.02
#: Handlers that may be replaced.
USUAL = (signal.SIG_DFL, signal.default_int_handler)


class Terminated(BaseException):
    """The user (Ctrl-C), the system or another program wants this one to end.

    Ctrl-C is no KeyboardInterrupt here. Where that one passes through compiled text (as
    `dataclasses` and other modules run while they are imported), the interpreter takes it for
    unhandled and ends itself by the signal, not with an exit code; and click prints an empty line.

    Attributes
    ----------
    number : int
        Of the signal; the exit code is 128 more.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class Ending:
    """What a run knows about its end.

    Attributes
    ----------
    written : bool
        Whether all of its files have taken their places.
    """

    def __init__(self) -> None:
        self.written = False
        self._depth = 0
        self._waiting: int | None = None
        self._last = -PATIENCE

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raise what ends the run, or remember that something did."""
        now = time.monotonic()
        if _current is not self or now - self._last < PATIENCE:
            return  # at the very end, or while it is cleared up
        self._last = now
        if self._depth:
            self._waiting = number
        else:
            raise Terminated(number)

    def unraised(self, usual: Callable[[Any], object], what: Any) -> None:
        """Stand in for `sys.unraisablehook`: where no exception can be raised, try again soon.

        A signal can arrive while Python calls a destructor or a callback of a weak reference, which
        would print the exception and go on.
        """
        if what.exc_type is not Terminated:
            usual(what)
            return
        self._last = -PATIENCE
        timer = threading.Timer(SOON, self._again, (what.exc_value.number,))
        timer.daemon = True
        timer.start()

    def _again(self, number: int) -> None:
        if _current is self:
            _thread.interrupt_main(signal.Signals(number))

    @contextmanager
    def put_off(self) -> Iterator[None]:
        """Raise only after the block what arrives meanwhile."""
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            # Also where the block fails: else the next one, whatever it is for, would end the run.
            if self._waiting is not None and not self._depth:
                number, self._waiting = self._waiting, None
                raise Terminated(number)


def farewell(ending: Ending, number: int) -> int:
    """Say on standard error why the run ends, and return its exit code: 128 and the signal."""
    what = "interrupted" if number == signal.SIGINT else "terminated"
    left = "after the files were written" if ending.written else "nothing was written"
    with suppress(OSError, ValueError):  # whoever hung up does not read on
        print(f"clmorph: {what}, {left}", file=sys.stderr, flush=True)
    return 128 + number


_current: Ending | None = None


@contextmanager
def terminable() -> Iterator[Ending]:
    """Turn signals that end a program into exceptions while the block runs.

    Inside another such block, and in other threads than the main one, nothing is changed.

    Yields
    ------
    Ending
        The outermost block's.
    """
    global _current
    if _current is not None or threading.current_thread() is not threading.main_thread():
        yield _current or Ending()
        return
    before: dict[signal.Signals, Any] = {}
    _current, hook = Ending(), sys.unraisablehook
    try:
        sys.unraisablehook = partial(_current.unraised, hook)
        for name in ENDING:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) in USUAL:
                before[number] = signal.signal(number, _current.handle)
        yield _current
    finally:
        _current = None
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let a block finish before a signal ends the run; for a few moments' work only."""
    ending = _current
    if ending is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    with ending.put_off():
        yield


def note_written() -> None:
    """Remember that the run's files have taken their places."""
    if _current is not None:
        _current.written = True
