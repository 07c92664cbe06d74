"""Bytes of files within their length: boxes of JPEG 2000 and AVIF, chunks of PNG, no pictures."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import IO

#: Boxes that hold boxes, with the number of bytes before the first of them.
_HOLDERS = {b"jp2h": 0, b"meta": 4, b"iprp": 0, b"ipco": 0}


class Reader(io.BufferedReader):
    """A file whose reads are limited to its length, as decoders trust sizes in damaged headers."""

    def __init__(self, file: Path) -> None:
        super().__init__(io.FileIO(file))
        self._end = self.seek(0, 2)
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most the given number of bytes; all bytes that are left by default."""
        left = max(0, self._end - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


def boxes(data: bytes, start: int = 0, end: int | None = None) -> Iterator[tuple[bytes, bytes]]:
    """Yield kinds and contents of boxes that describe a picture, also inner ones, to a damage."""
    end = len(data) if end is None else end
    while start + 8 <= end:
        size, kind = int.from_bytes(data[start : start + 4], "big"), data[start + 4 : start + 8]
        first = start + 8
        if size == 1:
            size, first = int.from_bytes(data[start + 8 : start + 16], "big"), start + 16
        last = end if size == 0 else start + size
        if not first <= last <= end:
            return
        if kind in _HOLDERS:
            yield from boxes(data, first + _HOLDERS[kind], last)
        elif kind in (b"colr", b"av1C"):
            yield kind, data[first:last]
        start = last


def png_chunk(stream: IO[bytes], name: bytes) -> bytes:
    """Return the content of a chunk before the picture of a PNG, or b"" if there is none."""
    stream.seek(0)
    if stream.read(8) != b"\x89PNG\r\n\x1a\n":  # an icon can hold a PNG too
        return b""
    while len(head := stream.read(8)) == 8 and head[4:] != b"IDAT":
        size = int.from_bytes(head[:4], "big")
        if head[4:] == name:
            return stream.read(size)
        stream.seek(size + 4, 1)
    return b""
