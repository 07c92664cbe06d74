"""Read files from unknown sources within limits, whatever size their headers state."""

import io
import json
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

#: The largest number of characters of the parameters in a file, for readers and writers.
MAX_TEXT = 1 << 20
#: The largest number of bytes read of a file whose metadata stand at its start.
MAX_HEAD = 4 * MAX_TEXT
#: Exceptions that libraries raise for files that are damaged or of another format.
UNREADABLE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, EOFError, SyntaxError,
    RuntimeError, ArithmeticError, MemoryError, struct.error, tokenize.TokenError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


class BoundedFile(io.FileIO):
    """A file that raises ValueError when a reader requests too many bytes, in all or at once."""

    def __init__(self, path: Path, *, in_all: int | None = None, at_once: int | None = None):
        super().__init__(path)
        self._left, self._at_once = in_all, at_once

    def read(self, size: int | None = -1, /) -> bytes:
        """Read at most `size` bytes, or all that remain if `size` is negative."""
        if size is None or size < 0:
            size = max(0, Path(str(self.name)).stat().st_size - self.tell())
        if self._at_once is not None and size > self._at_once:
            raise ValueError(f"a part of it has more than {self._at_once} bytes")
        data = super().read(size if self._left is None else min(size, self._left + 1))
        if self._left is not None:
            self._left -= len(data)
            if self._left < 0:
                raise ValueError("its parameters are not among the first parts of it")
        return data or b""

    def readall(self) -> bytes:
        """Read all that remains."""
        return self.read(-1)

    def readinto(self, buffer: Any, /) -> int:
        """Read into a buffer, within the same limits as `read`."""
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)


def from_text(text: str | bytes) -> Any:
    """Return a JSON text's value; ValueError if it is long or odd, or RecursionError."""
    if len(text) > MAX_TEXT:
        raise ValueError(f"its parameters have more than {MAX_TEXT} characters")
    return json.loads(
        text, object_pairs_hook=_object, parse_constant=_constant, parse_float=_number
    )


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key stands there twice")
    return found


def _constant(word: str) -> None:
    raise ValueError(f"{word} is not a number")


def _number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError("a number is too large")
    return number
