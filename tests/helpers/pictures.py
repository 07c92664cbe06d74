"""PNG and TIFF files assembled byte by byte, of kinds that the installed libraries cannot write."""

import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from clmorph import read_image


@pytest.fixture
def read(tmp_path):
    """Read bytes as a file."""

    def read(data, name="image", **options):
        (tmp_path / name).write_bytes(data)
        return read_image(tmp_path / name, **options)

    return read


def png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


#: First row and column of each pass of an interlaced PNG, and its steps.
ADAM7 = (
    (0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2),
    (1, 0, 2, 1),
)  # fmt: skip


def _rows(samples: np.ndarray, bits: int) -> bytes:
    """Pack rows as PNG stores them, each behind the number of its filter."""
    rows = samples.reshape(samples.shape[0], -1)
    if bits < 8:
        planes = (rows[..., None] >> np.arange(bits)[::-1]) & 1
        packed = np.packbits(planes.reshape(rows.shape[0], -1).astype(np.uint8), axis=1)
    else:
        packed = rows.astype({8: "u1", 16: ">u2"}[bits])
    return b"".join(b"\0" + row.tobytes() for row in packed)


def png(
    samples: np.ndarray,
    color: int,
    bits: int = 8,
    chunks: tuple[tuple[bytes, bytes], ...] = (),
    interlaced: bool = False,
) -> bytes:
    """A PNG of samples (H, W) or (H, W, n); `color` is the type in its header."""
    height, width = samples.shape[:2]
    passes = (
        [samples[y::down, x::across] for y, x, down, across in ADAM7] if interlaced else [samples]
    )
    data = b"".join(_rows(part, bits) for part in passes if part.size)
    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, interlaced)
    parts = [(b"IHDR", header), *chunks]
    parts += [(b"IDAT", zlib.compress(data)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*part) for part in parts)


def tiff(data: bytes, width: int, height: int, tags: Mapping[int, Any], order: str = "<") -> bytes:
    """A TIFF of one strip, uncompressed if `tags` do not say otherwise."""
    rows: dict[int, Any] = {
        256: width, 257: height, 259: 1, 273: 8, 278: height, 279: len(data), **tags
    }  # fmt: skip
    rows = {tag: value for tag, value in rows.items() if value is not None}
    start = 8 + len(data) + len(data) % 2
    spare = start + 2 + 12 * len(rows) + 4
    table, beyond = struct.pack(order + "H", len(rows)), b""
    for tag in sorted(rows):
        value = rows[tag]
        if isinstance(value, bytes):
            kind, count, packed = 7, len(value), value
        else:
            values = value if isinstance(value, tuple) else (value,)
            kind, count = (3 if max(values) < 65536 else 4), len(values)
            packed = struct.pack(order + str(count) + "HI"[kind - 3], *values)
        if len(packed) > 4:
            place = spare + len(beyond)
            beyond += packed
            packed = struct.pack(order + "I", place)
        table += struct.pack(order + "HHI", tag, kind, count) + packed.ljust(4, b"\0")
    head = {"<": b"II", ">": b"MM"}[order] + struct.pack(order + "HI", 42, start)
    return head + data + b"\0" * (len(data) % 2) + table + bytes(4) + beyond
