"""Frames on disk while a file is made of them."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from clmorph.errors import OutputError

#: Bytes of frames that stay in memory; more go to a temporary file.
IN_MEMORY = 128 * 1024**2


class Spool(Sequence[NDArray[Any]]):
    """A sequence of arrays of any shapes and one dtype, kept in a temporary file.

    The file has no name, or loses it at once: however the process ends, nothing is left of it.

    Parameters
    ----------
    dtype : dtype
    folder : Path, optional
        Where the temporary file goes, without a name; the system's place by default.
    """

    def __init__(self, dtype: Any, folder: Path | None = None) -> None:
        self._dtype = np.dtype(dtype)
        place = None if folder is None else str(folder)
        self._file = tempfile.SpooledTemporaryFile(IN_MEMORY, dir=place)  # noqa: SIM115
        self._places: list[tuple[int, tuple[int, ...]]] = []

    def append(self, array: NDArray[Any]) -> None:
        """Add an array of the spool's dtype."""
        if array.dtype != self._dtype:
            raise TypeError(f"an array of {array.dtype} in a spool of {self._dtype}")
        with _told():
            offset = self._file.seek(0, 2)
            self._file.write(np.ascontiguousarray(array).tobytes())
        self._places.append((offset, array.shape))

    def shape(self, index: int) -> tuple[int, ...]:
        """Return an array's shape without reading it."""
        return self._places[index][1]

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, index: slice) -> list[NDArray[Any]]: ...
    def __getitem__(self, index: int | slice) -> NDArray[Any] | list[NDArray[Any]]:
        """Read an array, or some of them."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        offset, shape = self._places[index]
        with _told():  # what was written may only now reach the disk
            self._file.seek(offset)
            data = self._file.read(int(np.prod(shape)) * self._dtype.itemsize)
        return np.frombuffer(data, self._dtype).reshape(shape)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(OSError):  # a full disk again: what is lost here was not to be kept
            self._file.close()


@contextmanager
def _told() -> Iterator[None]:
    """Tell what the disk refuses."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"frames cannot wait on disk until they are written ({error.strerror or error}): "
            "free some space, or take fewer or smaller frames"
        ) from error
