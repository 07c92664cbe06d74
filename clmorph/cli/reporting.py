"""Report each error of the command line in one line, with an exit code."""

import os
import re
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rich_click as click
from click.exceptions import NoArgsIsHelpError

from clmorph._shared.files import is_closed_pipe
from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.signals import Ending, Terminated, farewell
from clmorph.cli.options import in_option_names
from clmorph.errors import ClmorphError, FileError


def run(
    command: click.Command,
    arguments: Sequence[str] | None,
    names: Mapping[str, str],
    ending: Ending,
) -> int:
    """Run the command line and return its exit code; report every error in one line.

    `names` gives the name on the command line of each argument of the library, and `ending` the
    signals that have arrived.
    """
    try:
        code = _run(command, arguments)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except click.ClickException as error:
        message = " ".join(error.format_message().split())
        line = f"error: {message} (clmorph --help shows the usage)"
    except ClmorphError as error:
        line = line_of(error, names)
    except UnicodeEncodeError as error:
        line = f"error: a name cannot be printed here ({error.reason})"
    except UnicodeError as error:
        line = f"error: {error}"
    except MemoryError:
        line = "error: not enough memory; use a smaller --size"
    except (click.Abort, KeyboardInterrupt):
        return farewell(ending, signal.SIGINT)
    except Terminated as error:
        return farewell(ending, error.number)
    except OSError as error:
        # The output is closed or cannot be written. Python must not try to flush it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if is_closed_pipe(error):
            return 0
        line = f"error: {_reason(error)}"
    line = re.sub(r"\d{100,}", lambda found: f"{found[0][:50]}…", line)  # a number in it
    with suppress(OSError):
        click.echo(f"clmorph: {printable(line, MESSAGE)}", err=True)
    return 2


def line_of(error: ClmorphError, names: Mapping[str, str] | None = None) -> str:
    """Return an error as the command line says it, after its "clmorph: "."""
    if isinstance(error, FileError):  # a file name must not be rewritten as an option
        return f"error: {error}"
    return f"error: {in_option_names(str(error), names)}"


def _reason(error: OSError) -> str:
    """Return the reason of a system's error, with a remedy if one is known."""
    try:
        Path.cwd()
    except OSError:
        return "the current folder is gone; go to another one"
    name = "" if error.filename is None else f"{error.filename}: "
    return f"{name}{reason_of(error)}"


def _run(command: click.Command, arguments: Sequence[str] | None) -> Any:
    """Run the command; a command without arguments shows its help."""
    try:
        return command.main(arguments, prog_name="clmorph", standalone_mode=False)
    except SystemExit as error:
        # Click exits in this way if the reader has closed the pipe.
        if isinstance(error.__context__, BrokenPipeError):
            raise error.__context__ from None
        raise
    except NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help())
        return 2
