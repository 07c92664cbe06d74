"""The command ``clmorph``, also as ``python -m clmorph``."""

import sys


def main() -> int:
    """Run the command line; Ctrl-C while it is still being loaded is no traceback either."""
    try:
        from clmorph.cli import main as run
    except KeyboardInterrupt:
        print("clmorph: interrupted, nothing was written", file=sys.stderr)
        return 130
    return run()


if __name__ == "__main__":
    raise SystemExit(main())
