"""Damage files at random, and at the places where formats store sizes, types and checksums."""

import struct
import zlib
from collections.abc import Callable, Sequence

import numpy as np

Rng = np.random.Generator

#: Numbers at which sizes overflow, wrap around or exhaust.
NUMBERS = (0, 1, 2, 3, 127, 128, 255, 256, 257, 32767, 32768, 65535, 65536, (1 << 31) - 1, 1 << 31,
           (1 << 32) - 1)  # fmt: skip


def _place(rng: Rng, data: bytearray) -> int:
    """Return a place in a file; half of them near its beginning, where what matters stands."""
    size = min(len(data), 512) if rng.random() < 0.5 else len(data)
    return int(rng.integers(max(1, size)))


def flip_bits(rng: Rng, data: bytearray, other: bytes) -> None:
    """Flip some bits."""
    for _ in range(int(rng.integers(1, 12)) if data else 0):
        data[_place(rng, data)] ^= 1 << int(rng.integers(8))


def set_bytes(rng: Rng, data: bytearray, other: bytes) -> None:
    """Set some bytes to any."""
    for _ in range(int(rng.integers(1, 12)) if data else 0):
        data[_place(rng, data)] = int(rng.integers(256))


def truncate(rng: Rng, data: bytearray, other: bytes) -> None:
    """Leave only a beginning."""
    del data[_place(rng, data) :]


def splice(rng: Rng, data: bytearray, other: bytes) -> None:
    """Go on as another file."""
    place, of_other = _place(rng, data), int(rng.integers(len(other) + 1))
    data[place:] = other[of_other:]


def move_block(rng: Rng, data: bytearray, other: bytes) -> None:
    """Delete, repeat or insert a block."""
    start, length = _place(rng, data), int(rng.integers(1, 64))
    block = bytes(data[start : start + length])
    kind = int(rng.integers(3))
    if kind == 0:
        del data[start : start + length]
    elif kind == 1:
        data[start:start] = block * int(rng.integers(1, 9))
    else:
        data[start:start] = rng.bytes(length)


def set_number(rng: Rng, data: bytearray, other: bytes) -> None:
    """Write a number of 1, 2, 4 or 8 bytes, as sizes and counts are."""
    width = int(rng.choice([1, 2, 4, 8]))
    number = int(rng.choice(NUMBERS)) & ((1 << 8 * width) - 1)
    place = _place(rng, data)
    data[place : place + width] = number.to_bytes(width, "big" if rng.random() < 0.5 else "little")


def change_field(rng: Rng, data: bytearray, other: bytes) -> None:
    """Change a field of the format's own: a tag of TIFF, a chunk of PNG, a size of the others."""
    if data[:2] in (b"II", b"MM"):
        _change_tag(rng, data)
    elif data[:4] == b"\x89PNG":
        _change_chunk(rng, data)
    elif data[:2] == b"\xff\xd8":
        _change_segment(rng, data)
    else:
        # Sizes of GIF, BMP, QOI, PSD, RIFF and others stand here.
        place = int(rng.choice([4, 5, 6, 8, 12, 14, 16, 18, 20, 22, 24, 26, 28]))
        width = int(rng.choice([2, 4]))
        number = int(rng.choice(NUMBERS)) & ((1 << 8 * width) - 1)
        data[place : place + width] = number.to_bytes(
            width, "big" if rng.random() < 0.3 else "little"
        )


def _change_tag(rng: Rng, data: bytearray) -> None:
    order = "<" if data[:2] == b"II" else ">"
    if len(data) < 16:
        return
    big = struct.unpack_from(order + "H", data, 2)[0] == 43
    (start,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
    head, step = (8, 20) if big else (2, 12)
    if start + head > len(data):
        return
    (count,) = struct.unpack_from(order + ("Q" if big else "H"), data, start)
    place = start + head + step * int(rng.integers(max(1, min(count, 40))))
    offset, width = [(0, 2), (2, 2), (4, 8 if big else 4), (step // 2 + 2, 8 if big else 4)][
        int(rng.choice([0, 1, 2, 3, 3, 3]))
    ]
    number = int(rng.choice(NUMBERS)) if rng.random() < 0.5 else int(rng.integers(12))
    number &= (1 << 8 * width) - 1
    field = number.to_bytes(width, "little" if order == "<" else "big")
    if place + offset + width <= len(data):
        data[place + offset : place + offset + width] = field


def _chunks(data: bytes) -> list[tuple[int, int]]:
    """Where each chunk of a PNG begins, and how long its data are."""
    found, place = [], 8
    while place + 12 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        found.append((place, length))
        place += 12 + length
    return found


def _change_chunk(rng: Rng, data: bytearray) -> None:
    chunks = _chunks(data)
    if not chunks:
        return
    place, length = chunks[int(rng.integers(len(chunks)))] if rng.random() < 0.6 else chunks[0]
    kind = int(rng.integers(4))
    if kind == 0:
        data[place : place + 4] = int(rng.choice(NUMBERS)).to_bytes(4, "big")
    elif kind == 1:
        data[place + 4 : place + 8] = bytes(rng.choice([
            b"IHDR", b"PLTE", b"IDAT", b"tRNS", b"iCCP", b"gAMA", b"cHRM", b"sRGB", b"eXIf",
            b"zTXt", b"iTXt", b"tEXt", b"acTL", b"fcTL", b"fdAT", b"IEND", b"pHYs",
        ]))  # fmt: skip
    elif length and place + 8 + length <= len(data):
        where = place + 8 + int(rng.integers(length))
        data[where] = int(rng.integers(256))


def _change_segment(rng: Rng, data: bytearray) -> None:
    places = [
        i for i in range(len(data) - 8) if data[i] == 0xFF and data[i + 1] in range(0xC0, 0xFF)
    ]
    if not places:
        return
    place = places[int(rng.integers(len(places)))]
    offset = int(rng.choice([1, 2, 4, 5, 7, 9]))
    data[place + offset : place + offset + 2] = int(rng.choice(NUMBERS)).to_bytes(8, "big")[-2:]


def mend_checksums(data: bytearray) -> None:
    """Give the chunks of a PNG the checksums that they should have."""
    if data[:4] == b"\x89PNG":
        for place, length in _chunks(data):
            end = place + 8 + length
            if end + 4 <= len(data):
                data[end : end + 4] = struct.pack(">I", zlib.crc32(data[place + 4 : end]))


MUTATIONS: Sequence[Callable[[Rng, bytearray, bytes], None]] = (
    flip_bits, set_bytes, truncate, splice, move_block, set_number, change_field, change_field,
)  # fmt: skip


def mutated(rng: Rng, data: bytes, other: bytes) -> bytes:
    """Return a damaged copy of a file; parts of another one may be taken."""
    made = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        MUTATIONS[int(rng.integers(len(MUTATIONS)))](rng, made, other)
    if rng.random() < 0.75:
        mend_checksums(made)
    return bytes(made)
