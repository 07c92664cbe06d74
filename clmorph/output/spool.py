"""Frames on disk while a file is made of them."""

import io
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.items import Items
from clmorph._shared.printable import reason_of
from clmorph._shared.staging import staging_folder
from clmorph.errors import OutputError

#: The largest number of bytes of frames in memory; beyond it they go to a temporary file.
IN_MEMORY = 128 * 1024**2


class Spool(Items[NDArray[Any]]):
    """A sequence of arrays of one dtype, for a `with` block: a few in memory, more in a file."""

    def __init__(self, dtype: Any, folder: Path | None = None) -> None:
        self._dtype = np.dtype(dtype)
        self._folder = folder
        self._stack = ExitStack()
        self._file: IO[bytes] = io.BytesIO()
        self._places: list[tuple[int, tuple[int, ...]]] = []

    def append(self, array: NDArray[Any]) -> None:
        """Add an array of the spool's dtype."""
        if array.dtype != self._dtype:
            raise TypeError(f"an array of {array.dtype} in a spool of {self._dtype}")
        with _disk_errors():
            offset = self._file.seek(0, 2)
            if isinstance(self._file, io.BytesIO) and offset + array.nbytes > IN_MEMORY:
                self._file = self._on_disk(self._file)
            self._file.write(np.ascontiguousarray(array).tobytes())
        self._places.append((offset, array.shape))

    def _on_disk(self, memory: io.BytesIO) -> IO[bytes]:
        """Return a temporary file with the bytes from memory, positioned at its end."""
        # Where files need names, the next run removes the folder of a killed process.
        place = self._folder and self._stack.enter_context(staging_folder(self._folder))
        file = tempfile.TemporaryFile(dir=place)  # noqa: SIM115 (the stack closes it)
        self._stack.callback(file.close)
        file.write(memory.getbuffer())
        return file

    def shape(self, index: int) -> tuple[int, ...]:
        """Return an array's shape without reading it."""
        return self._places[index][1]

    def __len__(self) -> int:
        return len(self._places)

    def _item(self, index: int) -> NDArray[Any]:
        """Read an array."""
        offset, shape = self._places[index]
        with _disk_errors():  # written data may reach the disk only now
            self._file.seek(offset)
            data = self._file.read(int(np.prod(shape)) * self._dtype.itemsize)
        return np.frombuffer(data, self._dtype).reshape(shape)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(OSError):  # the disk may be full again, but the data are discarded anyway
            self._stack.close()


@contextmanager
def _disk_errors() -> Iterator[None]:
    """Raise OutputError for an error of the disk."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"frames cannot be kept on disk until they are written ({reason_of(error)}): "
            "free some space, or take fewer or smaller frames"
        ) from error
