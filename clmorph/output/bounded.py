"""Read files from unknown sources within limits, whatever size their headers state."""

import io
import json
import math
import struct
import tokenize
import zipfile
import zlib
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np

from clmorph._shared.typing import AnyArray

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
#: Limit in bytes of one read from an ``.npz``. The directory of the archive is one such read, with
#: about a hundred bytes for each array.
AT_ONCE = 1 << 24
#: The permitted methods of compression there; others take much memory to unpack.
PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
#: The only accepted version of an array's header; in later versions the header can take gigabytes.
VERSION = (1, 0)


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


class Arrays:
    """The arrays of an ``.npz``, read one by one, within `max_bytes`; errors are `UNREADABLE`."""

    def __init__(self, path: Path, *, max_bytes: float) -> None:
        self._max_bytes = self._left = max_bytes
        with ExitStack() as stack:
            file = stack.enter_context(BoundedFile(path, at_once=AT_ONCE))
            self._archive = stack.enter_context(zipfile.ZipFile(file))
            names = [name.removesuffix(".npy") for name in self._archive.namelist()]
            if len(set(names)) < len(names):
                raise ValueError("two of its arrays have one name")
            self.names = frozenset(names)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def size(self, name: str) -> int:
        """Return the bytes that an array takes, according to the archive's directory."""
        return self._archive.getinfo(f"{name}.npy").file_size

    def read(self, name: str, ndim: int, kinds: str = "f") -> AnyArray:
        """Return an array, which must have `ndim` axes and one of the `kinds` of `numpy.dtype`."""
        shape, dtype, size = self._measured(name, ndim, kinds)
        self._left -= size
        if self._left < 0:
            raise ValueError(f"its arrays take more than {self._max_bytes:g} bytes")
        with self._archive.open(f"{name}.npy") as stream:
            array = np.lib.format.read_array(stream, allow_pickle=False)
        if array.shape != shape or array.dtype != dtype:
            raise ValueError(f"{name}: another array than it begins with")
        return np.asarray(array)

    def text(self, name: str) -> str:
        """Return a text of at most `MAX_TEXT` characters, stored as an array without axes."""
        if self._measured(name, 0, "U")[2] > 4 * MAX_TEXT:
            raise ValueError(f"its parameters have more than {MAX_TEXT} characters")
        return str(self.read(name, 0, "U"))

    def _measured(
        self, name: str, ndim: int, kinds: str
    ) -> tuple[tuple[int, ...], np.dtype[Any], int]:
        """Return an array's shape, dtype and bytes, without reading it."""
        entry = self._archive.getinfo(f"{name}.npy")
        if entry.compress_type not in PACKED:
            raise ValueError(f"{name}: packed in a way that clmorph does not write")
        with self._archive.open(entry) as stream:
            if np.lib.format.read_magic(stream) != VERSION:
                raise ValueError(f"{name}: not an array as clmorph writes it")
            shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
            begin = stream.tell()
        if dtype.kind not in kinds or len(shape) != ndim:
            raise ValueError(f"{name}: an array of another kind than clmorph writes")
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or size != entry.file_size - begin:
            raise ValueError(f"{name}: its size is not the one in its header")
        return shape, dtype, size
