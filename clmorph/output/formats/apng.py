"""``.apng``: animated PNG, with opacity, written frame by frame.

Pillow's own writer keeps all frames in memory until it has the last one. This module lets Pillow
encode each frame as a PNG and copies the image data into the animation. The chunks follow the
Portable Network Graphics (PNG) Specification, Third Edition, W3C 2025, section 11.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from clmorph._shared.progress import Report, tracked
from clmorph.output.formats.animation import FASTEST, SIDE, changed, pieces, timed_frames
from clmorph.output.formats.format import Format, encoding
from clmorph.output.metadata import as_png_info, read_png
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.PngImagePlugin import PngInfo

#: The first bytes of every PNG.
SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: The longest delay in milliseconds: the numerator of a delay has 16 bits.
LONGEST = 65_000


@encoding("animated PNG")
def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write an animated PNG."""
    framing = recording.framing(style, SIDE)
    timed = timed_frames(recording, 1000)
    info = as_png_info(recording.parameters)
    count = sum(len(pieces(duration, LONGEST)) for _, duration in timed)
    plays = int(recording.motion.loop == "once")
    before: Image | None = None
    sequence = 0
    with file.open("wb") as stream:
        for index, duration in tracked(timed, report):
            picture = framing(recording.picture(index))
            left, top, right, bottom = box = changed(before, picture)
            chunks = list(_chunks(picture.crop(box), info if before is None else None))
            data = b"".join(content for kind, content in chunks if kind == b"IDAT")
            if before is None:
                stream.write(SIGNATURE)
                for kind, content in chunks:
                    if kind not in (b"IDAT", b"IEND"):
                        _write(stream, kind, content)
                _write(stream, b"acTL", struct.pack(">II", count, plays))
            # A frame that stays longer than the format allows is drawn again.
            for number, delay in enumerate(pieces(duration, LONGEST)):
                place = right - left, bottom - top, left, top
                # Disposal: none. Blending: the new pixels replace the old ones, opacity included.
                control = struct.pack(">IIIIIHHBB", sequence, *place, delay, 1000, 0, 0)
                _write(stream, b"fcTL", control)
                sequence += 1
                if before is None and number == 0:
                    _write(stream, b"IDAT", data)
                else:
                    _write(stream, b"fdAT", struct.pack(">I", sequence) + data)
                    sequence += 1
            before = picture
        _write(stream, b"IEND", b"")


def _write(stream: BinaryIO, kind: bytes, content: bytes) -> None:
    stream.write(struct.pack(">I", len(content)) + kind + content)
    stream.write(struct.pack(">I", zlib.crc32(kind + content)))


def _chunks(picture: "Image", info: "PngInfo | None") -> Iterator[tuple[bytes, bytes]]:
    """Return kind and content of each chunk of a picture as PNG."""
    stream = BytesIO()
    picture.save(stream, format="PNG", pnginfo=info)
    whole = stream.getvalue()
    place = len(SIGNATURE)
    while place < len(whole):
        length, kind = struct.unpack_from(">I4s", whole, place)
        yield kind, whole[place + 8 : place + 8 + length]
        place += 12 + length


FORMATS = (
    Format(
        name="apng", endings=(".apng",), write=write, read_metadata=read_png,
        signatures=((0, SIGNATURE[:4]),), animated=True, fastest=FASTEST,
    ),
)  # fmt: skip
