"""The command ``clmorph``, also as ``python -m clmorph``."""

import io
import os
import signal
import sys

from clmorph._shared.signals import Terminated, farewell, terminable


def _open_streams() -> None:
    """Open the standard streams that whoever started us has closed, as if they led nowhere.

    Otherwise the next file to be opened would take the place of one, and get what is printed.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # It gets the lowest number that is free: this one.
            os.open(os.devnull, os.O_RDONLY if number == 0 else os.O_WRONLY)
        if getattr(sys, name) is None:
            mode = "r" if number == 0 else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def main() -> int:
    """Run the command line; Ctrl-C while it is still being loaded is no traceback either."""
    _open_streams()
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        # Frames of tables, powers of ten: better a question mark than no help.
        sys.stdout.reconfigure(errors="replace")
    with terminable() as ending:
        try:
            from clmorph.cli.main import main as run

            return run()
        except KeyboardInterrupt:
            return farewell(ending, signal.SIGINT)
        except Terminated as error:
            return farewell(ending, error.number)


if __name__ == "__main__":
    raise SystemExit(main())
