"""Keep what is printed."""

import os
import sys
import tempfile


class Quiet:
    """Keeps what this process prints to itself, C libraries included."""

    def __enter__(self) -> "Quiet":
        sys.stdout.flush()
        sys.stderr.flush()
        self._kept = [os.dup(number) for number in (1, 2)]
        self._out, self._err = tempfile.TemporaryFile(), tempfile.TemporaryFile()
        os.dup2(self._out.fileno(), 1)
        os.dup2(self._err.fileno(), 2)
        return self

    def __exit__(self, *error: object) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, kept in zip((1, 2), self._kept, strict=True):
            os.dup2(kept, number)
            os.close(kept)
        self._out.close()
        self._err.seek(0)
        self._text = self._err.read().decode("utf-8", "replace")
        self._err.close()

    def text(self) -> str:
        """Return what was printed to stderr."""
        return self._text
