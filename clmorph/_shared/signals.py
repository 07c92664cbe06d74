"""SIGTERM and SIGHUP end the command line as Ctrl-C does, without half-written files.

Only the command line installs handlers, only in the main thread, and only in place of the default
handlers: a handler that a caller has set, or an ignored signal (``nohup``), stays. The library
never installs handlers, so `undisturbed` has no effect in it.
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

#: Signals that end a run; some systems have no SIGHUP.
ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
#: Seconds for which further signals are ignored, so that they do not interrupt the cleanup.
PATIENCE = 5.0
#: Seconds after which a signal is raised again if it arrived where no exception can be raised.
SOON = 0.02
#: Default handlers, which may be replaced.
USUAL = (signal.SIG_DFL, signal.default_int_handler)


class Terminated(BaseException):
    """Ctrl-C, the system or another program ends this process; the exit code is 128 + `number`.

    A KeyboardInterrupt in code that is compiled from a text, as by `dataclasses`, would count as
    unhandled, and click would print an empty line for it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def _imports(frame: FrameType | None) -> int:
    """Return in how many steps of imports a frame is."""
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename == "<frozen importlib._bootstrap>"
        frame = frame.f_back
    return count


class Ending:
    """Whether all files of a run are `written`, or else what is done so far (`partial`)."""

    def __init__(self) -> None:
        self.written = False
        self.partial = ""
        #: Blocks that put signals off, and the signal that waits for their end.
        self.depth = 0
        self.waiting: int | None = None
        self._last = -PATIENCE
        self._imports = _imports(sys._getframe())

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raise `Terminated`, or store the signal if it must wait."""
        now = time.monotonic()
        if _current is not self or now - self._last < PATIENCE:
            return  # the run is over, or its cleanup is in progress
        if not self.depth and _imports(frame) > self._imports:
            # A module that is compiled may lose an exception that is raised while it is imported.
            self._soon(number)
            return
        self._last = now
        if self.depth:
            self.waiting = number
        else:
            raise Terminated(number)

    def unraised(self, usual: Callable[[Any], object], what: Any) -> None:
        """Raise a signal again soon that came in a destructor, which only prints its exceptions."""
        if what.exc_type is not Terminated:
            usual(what)
            return
        self._last = -PATIENCE
        self._soon(what.exc_value.number)

    def _soon(self, number: int) -> None:
        timer = threading.Timer(SOON, self._again, (number,))
        timer.daemon = True
        timer.start()

    def _again(self, number: int) -> None:
        if _current is not self:
            return
        if hasattr(signal, "pthread_kill"):  # it wakes the main thread where that waits, too
            signal.pthread_kill(threading.main_thread().ident or 0, number)
        else:
            _thread.interrupt_main(signal.Signals(number))


def farewell(ending: Ending, number: int) -> int:
    """Report on standard error why the run ends; return the exit code, 128 plus the signal."""
    what = "interrupted" if number == signal.SIGINT else "terminated"
    left = "after the files were written" if ending.written else "nothing was written"
    left = ending.partial or left
    with suppress(OSError, ValueError):  # after a hang-up nobody reads the message
        print(f"clmorph: {what}, {left}", file=sys.stderr, flush=True)
    return 128 + number


_current: Ending | None = None


@contextmanager
def terminable() -> Iterator[Ending]:
    """Convert signals that end a program to exceptions, in the main thread and outermost block."""
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
    """Let a short block finish before a signal ends the run."""
    ending = _current
    if ending is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    ending.depth += 1
    try:
        yield
    finally:
        ending.depth -= 1
        # A failed block raises it too; otherwise a later, unrelated block would end the run.
        if ending.waiting is not None and not ending.depth:
            number, ending.waiting = ending.waiting, None
            raise Terminated(number)


def note_written() -> None:
    """Record that the run's files have replaced their targets."""
    if _current is not None:
        _current.written = True


def note_partial(text: str) -> None:
    """Record what a run of many parts has done, for the last line if it is ended."""
    if _current is not None:
        _current.partial = text
