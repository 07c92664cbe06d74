"""Read the tags of a TIFF directory, the format of Exif data too, and check every number.

Pillow and tifffile read tags too, but warn or log about unusual ones, and only after they have
opened the image. Here no number causes more work than the bytes of the file justify.
"""

import re
import struct
from io import BytesIO
from typing import IO, NamedTuple

#: Size in bytes and `struct` letter of each type of value; "" marks types that are read as bytes.
_TYPES = {
    1: (1, "B"), 2: (1, ""), 3: (2, "H"), 4: (4, "I"), 5: (8, ""), 6: (1, "b"), 7: (1, ""),
    8: (2, "h"), 9: (4, "i"), 10: (8, ""), 11: (4, "f"), 12: (8, "d"), 13: (4, "I"),
    16: (8, "Q"), 17: (8, "q"), 18: (8, "Q"),
}  # fmt: skip
#: Largest number of directories that are read; hardly any file has its main image further back.
MAX_DIRECTORIES = 16

#: Largest number of values of a tag; a tag with more counts as damaged.
MAX_VALUES = 1 << 18

NEW_SUBFILE_TYPE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
STRIP_OFFSETS, ORIENTATION, SAMPLES, ROWS_PER_STRIP, PLANAR = 273, 274, 277, 278, 284
TILE_WIDTH, TILE_HEIGHT, TILE_OFFSETS = 322, 323, 324
EXTRA_SAMPLES, SAMPLE_FORMAT, SUBSAMPLING, XMP, ICC_PROFILE = 338, 339, 530, 700, 34675
#: Tags that are read. A hostile directory can have 65,536 tags that each refer to the whole file.
_WANTED = frozenset(
    (NEW_SUBFILE_TYPE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, STRIP_OFFSETS, ORIENTATION,
     SAMPLES, ROWS_PER_STRIP, PLANAR, TILE_WIDTH, TILE_HEIGHT, TILE_OFFSETS,
     EXTRA_SAMPLES, SAMPLE_FORMAT, SUBSAMPLING, XMP, ICC_PROFILE)
)  # fmt: skip

_XMP_ORIENTATION = re.compile(rb"tiff:Orientation(?:=\"|>)([1-8])")

Values = tuple[int | float, ...] | bytes


class Directory(NamedTuple):
    """The tags of one picture."""

    #: Those in `_WANTED`: tuples of numbers, or bytes. Unreadable tags are omitted.
    tags: dict[int, Values]
    #: Offset of the next directory, 0 if there is none.
    next: int

    def number(self, tag: int, default: int) -> int:
        """Return a tag's first number, or the default if the tag is missing."""
        values = self.tags.get(tag, ())
        return int(values[0]) if isinstance(values, tuple) and values else default

    def octets(self, tag: int) -> bytes:
        """Return a tag's bytes, from either type of value; b"" if the tag is missing."""
        values = self.tags.get(tag, b"")
        if isinstance(values, bytes):
            return values
        return bytes(int(value) for value in values if 0 <= value < 256)

    def numbers(self, tag: int) -> tuple[int, ...]:
        """Return a tag's numbers; an empty tuple if the tag is missing."""
        values = self.tags.get(tag, ())
        return tuple(map(int, values)) if isinstance(values, tuple) else ()


def read_directory(stream: IO[bytes], place: int = 0) -> Directory:
    """Read the directory at `place` of a TIFF, 0 for the first one; ValueError if there is none."""
    size = stream.seek(0, 2)
    stream.seek(0)
    header = stream.read(16)
    order = {b"II": "<", b"MM": ">"}.get(header[:2], "")
    if not order or len(header) < 8:
        raise ValueError("no TIFF header")
    version = struct.unpack(order + "H", header[2:4])[0]
    if version not in (42, 43) or (version == 43 and len(header) < 16):
        raise ValueError("no TIFF header")
    big = version == 43
    offset = order + ("Q" if big else "I")
    width = struct.calcsize(offset)
    place = place or struct.unpack(offset, header[8:16] if big else header[4:8])[0]
    if not 8 <= place < size:
        raise ValueError("its directory lies outside of the file")
    stream.seek(place)
    counted = stream.read(8 if big else 2)
    if len(counted) < (8 if big else 2):
        raise ValueError("its directory is cut off")
    count = struct.unpack(order + ("Q" if big else "H"), counted)[0]
    step = 4 + 2 * width
    # A valid directory has at most 65,536 tags, because a tag's number has 16 bits.
    rows = stream.read(min(count, 1 << 16) * step)
    after = stream.read(width)
    tags: dict[int, Values] = {}
    for start in range(0, len(rows) - step + 1, step):
        tag, kind = struct.unpack_from(order + "HH", rows, start)
        if tag not in _WANTED or tag in tags:
            continue
        values = _values(stream, size, order, kind, rows[start + 4 : start + step], width)
        if values is not None:
            tags[tag] = values
    end = struct.unpack(offset, after)[0] if len(after) == width else 0
    return Directory(tags, end)


def _values(
    stream: IO[bytes], size: int, order: str, kind: int, row: bytes, width: int
) -> Values | None:
    """Return the values of a directory entry, or None if they are not in the file."""
    each, letter = _TYPES.get(kind, (0, ""))
    offset = order + ("Q" if width == 8 else "I")
    (count,) = struct.unpack_from(offset, row)
    bytes_ = count * each
    if not each or bytes_ > size or (letter and count > MAX_VALUES):
        return None
    data = row[width : width + bytes_]
    if bytes_ > width:
        (place,) = struct.unpack_from(offset, row, width)
        if place + bytes_ > size:
            return None
        stream.seek(place)
        data = stream.read(bytes_)
    if not letter:
        return data
    return struct.unpack(f"{order}{count}{letter}", data)


def first_full_page(stream: IO[bytes]) -> tuple[Directory, int, bool]:
    """Return the first full picture of a TIFF, its number, and whether another full one follows."""
    found: list[tuple[Directory, int]] = []
    first = read_directory(stream)
    directory, seen = first, {0}
    for index in range(MAX_DIRECTORIES):
        # Bit 0 marks a reduced copy, bit 2 a transparency mask.
        if not directory.number(NEW_SUBFILE_TYPE, 0) & 0b101:
            found.append((directory, index))
        if len(found) == 2 or not directory.next or directory.next in seen:
            break
        seen.add(directory.next)
        try:
            directory = read_directory(stream, directory.next)
        except ValueError:
            break
    return (*(found[0] if found else (first, 0)), len(found) == 2)


def exif_orientation(exif: bytes) -> int | None:
    """Return the orientation in Exif data, 1 to 8, or None if there is none."""
    exif = exif.removeprefix(b"Exif\0\0")
    try:
        directory = read_directory(BytesIO(exif))
        if not directory.tags.get(ORIENTATION):
            return None
        turned = directory.number(ORIENTATION, 1)
    except (ValueError, OverflowError):
        return None
    return turned if 1 <= turned <= 8 else 1


def xmp_orientation(xmp: bytes) -> int:
    """Return the orientation in XMP data, 1 to 8; 1 if there is none."""
    found = _XMP_ORIENTATION.search(xmp)
    return int(found[1]) if found else 1
