"""Errors of the command line: one line each, and the exit code."""

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

from clmorph._shared.printable import MESSAGE, printable, reason_of
from clmorph._shared.signals import Ending, Terminated, farewell
from clmorph.cli.options import in_option_names
from clmorph.errors import ClmorphError, FileError


def _complain(text: str) -> None:
    """Print a line on standard error, if that takes any; no number fills a page there."""
    text = re.sub(r"\d{100,}", lambda found: f"{found[0][:50]}…", text)
    with suppress(OSError):
        click.echo(f"clmorph: {printable(text, MESSAGE)}", err=True)


def run(
    command: click.Command,
    arguments: Sequence[str] | None,
    names: Mapping[str, str],
    ending: Ending,
) -> int:
    """Run the command line and return its exit code; report every error in one line.

    Parameters
    ----------
    command : click.Command
    arguments : sequence of str, optional
        In place of the process's own.
    names : mapping
        What each argument of the library is called on the command line.
    ending : Ending
        The signals that have arrived.
    """
    try:
        code = _run(command, arguments)
        sys.stdout.flush()
    except click.ClickException as error:
        message = " ".join(error.format_message().split())
        _complain(f"error: {message} (clmorph --help shows the usage)")
        return 2
    except FileError as error:  # a name is not to be taken for an option
        _complain(f"error: {error}")
        return 2
    except ClmorphError as error:
        _complain(f"error: {in_option_names(str(error), names)}")
        return 2
    except UnicodeError as error:
        _complain(
            f"error: a name cannot be printed here ({error.reason})"
            if isinstance(error, UnicodeEncodeError)
            else f"error: {error}"
        )
        return 2
    except MemoryError:
        _complain("error: not enough memory; use a smaller --size")
        return 2
    except (click.Abort, KeyboardInterrupt):
        return farewell(ending, signal.SIGINT)
    except Terminated as error:
        return farewell(ending, error.number)
    except OSError as error:
        # Nobody reads on, or nothing more can be written: keep Python from trying at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0
        _complain(f"error: {_reason(error)}")
        return 2
    return code if isinstance(code, int) else 0


def _reason(error: OSError) -> str:
    """Return what the system says, in words that can be acted on."""
    try:
        Path.cwd()
    except OSError:
        return "the current folder is gone; go to another one"
    name = "" if error.filename is None else f"{error.filename}: "
    return f"{name}{reason_of(error)}"


def _run(command: click.Command, arguments: Sequence[str] | None) -> Any:
    """Run the command; one without arguments shows its help."""
    try:
        return command.main(arguments, prog_name="clmorph", standalone_mode=False)
    except SystemExit as error:
        # So click ends where nobody reads on.
        if isinstance(error.__context__, BrokenPipeError):
            raise error.__context__ from None
        raise
    except NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help())
        return 2
