"""The command ``clmorph``, also as ``python -m clmorph``."""

import signal

from clmorph.signals import Terminated, farewell, terminable


def main() -> int:
    """Run the command line; Ctrl-C while it is still being loaded is no traceback either."""
    with terminable() as ending:
        try:
            from clmorph.cli import main as run

            return run()
        except KeyboardInterrupt:
            return farewell(ending, signal.SIGINT)
        except Terminated as error:
            return farewell(ending, error.number)


if __name__ == "__main__":
    raise SystemExit(main())
