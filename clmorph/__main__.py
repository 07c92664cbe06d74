"""``python -m clmorph`` is the command ``clmorph``."""

from clmorph.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
