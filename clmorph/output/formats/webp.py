"""``.webp``: animated WebP, with opacity, lossy or lossless."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from clmorph._shared.progress import Report, Share
from clmorph.output.bounded import MAX_HEAD, MAX_TEXT
from clmorph.output.formats.animation import FASTEST, SIDE, timed_frames
from clmorph.output.formats.format import PACE, SIZES, Format, check_sides, encoding
from clmorph.output.metadata import IMAGE_DESCRIPTION, as_text
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

if TYPE_CHECKING:
    from PIL.Image import Exif, Image

    from clmorph.output.framing import Framing

#: Quality of lossy WebP, from 0 to 100, and effort of lossless WebP.
LOSSY_QUALITY, LOSSLESS_EFFORT = 90, 80
#: The longest side in pixels: the field has 14 bits.
LONGEST_SIDE = 16383
#: Flags of an extended WebP.
ANIMATED, HAS_EXIF, HAS_ALPHA = 0x02, 0x08, 0x10
#: The largest number of chunks that the search for Exif reads: one per frame, and some more.
MAX_CHUNKS = 1_000_000


@encoding("WebP")
def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write an animated WebP, lossy unless the style is lossless."""
    framing = recording.framing(style, SIDE)
    check_sides(framing.size, LONGEST_SIDE, "WebP")
    frames = timed_frames(recording, 1000)
    plays = int(recording.motion.loop == "once")
    _reel(recording, [index for index, _ in frames], framing, report).save(
        file, format="WEBP", save_all=True, duration=[duration for _, duration in frames],
        loop=plays, lossless=style.lossless, exact=style.lossless,
        quality=LOSSLESS_EFFORT if style.lossless else LOSSY_QUALITY, method=4,
        exif=as_exif(recording.parameters),
    )  # fmt: skip
    _keep_animated(file, framing, sum(duration for _, duration in frames), plays)
    report(Share(1.0, f"{len(frames)} of {len(frames)}"))


def _keep_animated(file: Path, framing: "Framing", duration: int, plays: int) -> None:
    """Make a still, which libwebp writes of equal frames, an animation of one (RFC 9649, 2.7)."""
    with file.open("rb") as stream:
        stream.seek(12)
        chunks = [*iter(lambda: _chunk(stream), None)]
    if any(kind == b"ANMF" for kind, _ in chunks):
        return
    size = b"".join((side - 1).to_bytes(3, "little") for side in framing.size)
    pixels = b"".join(_packed(*each) for each in chunks if each[0] in (b"ALPH", b"VP8 ", b"VP8L"))
    flags = ANIMATED | HAS_EXIF | (HAS_ALPHA if framing.clear else 0)
    whole = [
        (b"VP8X", bytes((flags, 0, 0, 0)) + size),
        (b"ANIM", struct.pack("<IH", 0, plays)),
        (b"ANMF", bytes(6) + size + duration.to_bytes(3, "little") + b"\0" + pixels),
        *(each for each in chunks if each[0] == b"EXIF"),
    ]
    body = b"WEBP" + b"".join(_packed(*each) for each in whole)
    file.write_bytes(_packed(b"RIFF", body))


def _chunk(stream: BinaryIO) -> tuple[bytes, bytes] | None:
    """Return the kind and the content of the next chunk of a whole WebP."""
    head = stream.read(8)
    if len(head) < 8:
        return None
    kind, length = struct.unpack("<4sI", head)
    return kind, stream.read(length + length % 2)[:length]


def _packed(kind: bytes, content: bytes) -> bytes:
    return kind + struct.pack("<I", len(content)) + content + bytes(len(content) % 2)


def _reel(recording: Recording, order: list[int], framing: "Framing", report: Report) -> "Image":
    """Return an image of many frames, which Pillow reads one by one: one at a time is in memory."""
    from PIL import Image

    reel = Image.new("RGBA" if framing.clear else "RGB", framing.size)
    position = -1

    def seek(number: int) -> None:
        nonlocal position
        # After the last frame Pillow seeks back to the first one, which is not needed.
        if number != position + 1:
            return
        if number > 0:
            report(Share(number / len(order), f"{number} of {len(order)}"))
        reel.paste(framing(recording.picture(order[number])))
        position = number

    reel.n_frames = len(order)  # type: ignore[attr-defined]
    reel.seek = seek  # type: ignore[assignment, method-assign]
    return reel


def as_exif(parameters: Mapping[str, Any]) -> "Exif":
    """Return parameters as the description in Exif."""
    from PIL import Image

    exif = Image.Exif()
    exif[IMAGE_DESCRIPTION] = as_text(parameters)
    return exif


def read_metadata(path: Path) -> str:
    """Return the description in a WebP's Exif, by its chunks (RFC 9649, 2.3), without frames."""
    from PIL import Image

    with path.open("rb") as file:
        if file.read(12)[8:] != b"WEBP":
            raise ValueError("it is not a kind of file that clmorph writes")
        for _ in range(MAX_CHUNKS):
            kind, length = struct.unpack("<4sI", file.read(8))
            if kind == b"EXIF":
                if length > MAX_HEAD:
                    raise ValueError(f"its parameters have more than {MAX_TEXT} characters")
                exif = Image.Exif()
                exif.load(file.read(length))
                return str(exif.get(IMAGE_DESCRIPTION, ""))
            file.seek(length + length % 2, 1)
    return ""


FORMATS = (
    Format(
        name="webp", endings=(".webp",), write=write, read_metadata=read_metadata,
        signatures=((0, b"RIFF"),), animated=True, relevant_options=(*SIZES, *PACE, "lossless"),
        fastest=FASTEST,
    ),
)  # fmt: skip
