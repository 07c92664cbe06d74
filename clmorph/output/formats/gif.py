"""``.gif``: one palette for all frames, so that nothing flickers."""

import struct
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import Report, tracked
from clmorph._shared.threads import in_order
from clmorph.output.formats.animation import SIDE, box_of, changed, pieces, timed_frames
from clmorph.output.formats.format import Format, check_sides, encoding
from clmorph.output.metadata import as_text, image_head
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording

if TYPE_CHECKING:
    from PIL.Image import Image

    from clmorph.output.framing import Framing

#: Number of colors in the palette; one more entry stands for transparent pixels.
COLORS = 255
#: Palette entries that are reserved for mixtures of the pictures' own colors.
LEAST = 16
#: The least opacity of a pixel that is drawn; pixels with less are transparent.
OPAQUE = 128
#: Largest number of pixels from which the palette is computed. With four times as many, colors are
#: on average 0 to 3 % nearer to their entries, and the palette takes four to ten times as long.
SAMPLES = 65_536
#: Colors that are compared with all entries of the palette at once.
AT_ONCE = 16_384
#: The longest duration of a frame in hundredths of a second: the field has 16 bits.
LONGEST = 65_000
#: The longest side in pixels: the field has 16 bits.
MOST = 65535


@encoding("GIF")
def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write an animated GIF, with each pixel either opaque or transparent."""
    framing = recording.framing(style, SIDE)
    check_sides(framing.size, MOST, "GIF")
    in_palette = _Palette(_palette(recording, framing), framing.nearest)
    shown = timed_frames(recording, 100)
    # Frames are read from their file in this thread.
    taken = ((recording.picture(index), units) for index, units in tracked(shown, report))
    head: dict[str, Any] = {"comment": as_text(recording.parameters).encode()}
    if recording.motion.loop != "once":
        head["loop"] = 0
    # The frame before must not show through.
    options: dict[str, Any] = {"transparency": COLORS, "disposal": 2} if framing.clear else {}
    before: Image | None = None
    # Pictures are written as they arrive; Pillow's own writer first keeps them all.
    with file.open("wb") as stream:
        for (_, units), picture in in_order(lambda each: in_palette(framing(each[0])), taken):
            box = changed(before, picture)
            if framing.clear and before is not None:
                box = box_of(np.asarray(picture) != COLORS)
            part = picture.crop(box)
            # A frame that stays longer than the format allows is drawn again.
            for number, piece in enumerate(pieces(units, LONGEST)):
                if before is None and number == 0:
                    stream.write(_still(part, 10 * piece, options | head)[:-1])
                else:
                    whole = _still(part, 10 * piece, options)
                    block = bytearray(whole[13 + (6 << (whole[10] & 7)) : -1])
                    # The place on the canvas stands after the 8 bytes of the duration and a mark.
                    struct.pack_into("<HH", block, 9, *box[:2])
                    stream.write(block)
            before = picture
        stream.write(b";")


def read_metadata(path: Path) -> str:
    """Return the metadata text of a GIF: its comment."""
    from PIL.GifImagePlugin import GifImageFile

    with image_head(GifImageFile, path) as image:
        return bytes(image.info.get("comment", b"")).decode("ascii", "replace")


def _still(picture: "Image", duration: int, options: dict[str, Any]) -> bytes:
    """Return a GIF of one frame: a header of 13 bytes, the palette, the frame, a semicolon."""
    stream = BytesIO()
    picture.save(stream, format="GIF", optimize=False, interlace=0, duration=duration, **options)
    return stream.getvalue()


def _palette(recording: Recording, framing: "Framing") -> "Image":
    """Return an image with a palette for all frames and bars, exact for pixel art if it can."""
    from PIL import Image

    pixels = sum(height * width for height, width, _ in recording.shapes)
    step = -(-pixels // SAMPLES)
    # These are copies, because a view would keep its frame in memory.
    samples = [_colors(recording, framing, index)[::step].copy() for index in range(len(recording))]
    pool = np.concatenate(samples)
    exact = _exact(recording, framing)
    # The palette must hold each of these colors, even if the samples have missed it.
    chosen = _as_rgb(np.union1d(pool, exact))
    if len(chosen) > COLORS:
        others = _as_rgb(pool[~np.isin(pool, exact)])
        rest = Image.fromarray(others[:, None]).quantize(
            COLORS - len(exact), method=Image.Quantize.MEDIANCUT, kmeans=1
        )
        found = np.frombuffer(bytes(rest.getpalette() or ()), np.uint8).reshape(-1, 3)
        chosen = np.concatenate((_as_rgb(exact), found))[:COLORS]
    palette = Image.new("P", (1, 1))
    # The colors are repeated, so that every entry is a color that occurs.
    palette.putpalette(np.resize(chosen, (COLORS, 3)).astype(np.uint8).tobytes())
    return palette


def _exact(recording: Recording, framing: "Framing") -> NDArray[np.uint32]:
    """Return the colors that must not change: those of the bars, and those of pixel art."""
    ground = np.array([framing.ground or (0, 0, 0)], np.uint8)
    bars = own = _as_numbers(ground)
    if framing.nearest:
        for index in np.flatnonzero(recording.holds):
            own = np.union1d(own, _colors(recording, framing, int(index)))
            if len(own) > COLORS - LEAST:
                return bars
    return own


def _colors(recording: Recording, framing: "Framing", index: int) -> NDArray[np.uint32]:
    """Return the colors of a frame's visible pixels, each packed into a number."""
    picture = np.asarray(framing.unscaled(recording.picture(index)))
    seen = picture[picture[..., 3] >= OPAQUE] if picture.shape[2] == 4 else picture
    return _as_numbers(seen[..., :3].reshape(-1, 3))


def _as_numbers(colors: NDArray[np.uint8]) -> NDArray[np.uint32]:
    return colors.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)


def _as_rgb(numbers: NDArray[np.uint32]) -> NDArray[np.uint8]:
    return np.stack([numbers >> 16, numbers >> 8, numbers], axis=-1).astype(np.uint8)


class _Palette:
    """Pictures in the colors of an image's palette; `plain` ones (pixel art) are not dithered."""

    def __init__(self, image: "Image", plain: bool) -> None:
        self._image, self._plain = image, plain
        self._entries = np.frombuffer(bytes(image.getpalette() or ()), np.uint8).reshape(-1, 3)
        # The entry of each color, and whether it is known yet. Frames share most of their colors.
        self._nearest = np.zeros(1 << 24 if plain else 0, np.uint8)
        self._known = np.zeros(len(self._nearest), bool)

    def __call__(self, picture: "Image") -> "Image":
        """Return a picture in the palette's colors."""
        from PIL import Image

        if self._plain:
            colors = Image.fromarray(self._indices(np.asarray(picture)[..., :3]), "L").convert("P")
            colors.putpalette(self._entries.tobytes())
        else:
            dither = Image.Dither.FLOYDSTEINBERG
            colors = picture.convert("RGB").quantize(palette=self._image, dither=dither)
        if picture.mode == "RGBA":
            hidden = picture.getchannel("A").point(lambda alpha: 255 * (alpha < OPAQUE))
            colors.paste(COLORS, mask=hidden)
        return colors

    def _indices(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the entries nearest to colors; Pillow's own search rounds colors to six bits."""
        numbers = _as_numbers(pixels)
        new = np.unique(numbers[~self._known[numbers]])
        entries = self._entries.astype(np.float32)  # exact: squares stay below 2^24
        for first in range(0, len(new), AT_ONCE):
            some = new[first : first + AT_ONCE]
            products = _as_rgb(some).astype(np.float32) @ entries.T
            self._nearest[some] = np.argmin((entries**2).sum(axis=1) - 2 * products, axis=1)
        self._known[new] = True
        return self._nearest[numbers]


FORMATS = (
    Format(
        name="gif", endings=(".gif",), write=write, read_metadata=read_metadata,
        signatures=((0, b"GIF8"),), animated=True, fastest=50.0,
    ),
)  # fmt: skip
