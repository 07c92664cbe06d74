"""Write a morph as files that people open."""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clmorph.errors import OutputError

if TYPE_CHECKING:
    from PIL.Image import Image

Frames = Sequence[NDArray[np.floating]]

#: Longer side, in pixels, to which small frames are enlarged in a GIF.
GIF_SIDE = 384
#: The same for each picture of a contact sheet.
SHEET_SIDE = 192
#: Pictures of a contact sheet, and how many stand in a row.
SHEET_FRAMES = 10
SHEET_COLUMNS = 5
#: Milliseconds of a GIF's frame, and of its first and last.
GIF_FRAME_MS = 50
GIF_HOLD_MS = 700
#: Colors of its palette; the last entry stands for what is transparent.
GIF_COLORS = 255


def output_writer(path: str | PathLike[str]) -> Callable[[Frames, NDArray[np.float64]], None]:
    """Return what writes to this path, after checking that it can.

    Parameters
    ----------
    path : path
        ``.gif``: an endless loop on a constant canvas, small frames enlarged. ``.png``: a
        contact sheet. No ending: a new folder of PNG frames, each at its own size.

    Returns
    -------
    callable
        Called with frames (H, W, 3 or 4 floats in [0, 1]) and their times. Opacity is kept in a
        folder, rounded to all or nothing in a GIF, and laid on white in a contact sheet.

    Raises
    ------
    OutputError
        If the ending is unknown or nothing can be written there.
    """
    if not isinstance(path, str | PathLike) or not str(path):
        raise OutputError(f"{path!r} is not a path; expected one such as 'out.gif'")
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in ("", ".gif", ".png"):
        raise OutputError(
            f"{target}: unknown ending {target.suffix!r}; expected .gif, .png (a contact sheet) "
            "or no ending (a folder of PNG frames)"
        )
    try:
        parent = target.resolve().parent
    except OSError as error:
        raise OutputError(f"{target}: there is no such place ({error.strerror})") from None
    if not parent.is_dir():
        raise OutputError(f"{target}: there is no folder {parent}; make it first")
    try:
        # The name itself can be impossible, and some folders only seem to be writable.
        target.is_dir()
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written ({error.strerror}); choose another place"
        ) from None
    if suffix and target.is_dir():
        raise OutputError(f"{target} is a folder; choose a file name")
    if not suffix and target.exists() and not (target.is_dir() and not any(target.iterdir())):
        raise OutputError(
            f"{target} exists already; choose a new or empty folder, or a name ending in "
            ".gif or .png"
        )
    write = {"": _write_folder, ".gif": _write_gif, ".png": _write_sheet}[suffix]

    def writer(frames: Frames, times: NDArray[np.float64]) -> None:
        # Written beside its place and moved there whole: never a half-written file.
        temporary = None
        try:
            temporary = Path(tempfile.mkdtemp(dir=parent, prefix=".clmorph-"))
            made = temporary / f"morph{suffix}"
            write(frames, times, made)
            if not suffix and target.exists():
                target.rmdir()
            made.replace(target)
        except OSError as error:
            raise OutputError(
                f"{target} cannot be written ({error.strerror or error}); choose another place"
            ) from error
        finally:
            if temporary is not None:
                shutil.rmtree(temporary, ignore_errors=True)

    return writer


def save(frames: Frames, times: NDArray[np.float64], path: str | PathLike[str]) -> None:
    """Write frames to a GIF, a contact sheet or a folder; see `output_writer`.

    Raises
    ------
    OutputError
        If the ending is unknown or nothing can be written there.
    """
    output_writer(path)(frames, times)


def to_bytes(frame: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Round a frame in [0, 1] to 8 bits."""
    return np.round(np.clip(frame, 0.0, 1.0) * 255.0).astype(np.uint8)


def _enlarged(
    frame: NDArray[np.floating], size: tuple[int, int], background: str = "black"
) -> "Image":
    """Return a frame as large as it fits into `size` (width, height), centered."""
    from PIL import Image

    picture = Image.fromarray(to_bytes(frame))
    if picture.size == size:
        return picture
    factor = min(size[0] / picture.width, size[1] / picture.height)
    fitted = max(1, round(picture.width * factor)), max(1, round(picture.height * factor))
    if picture.mode == "RGBA":
        # Multiplied by opacity meanwhile, so that unseen colors do not show at the edges.
        resized = picture.convert("RGBa").resize(fitted, Image.Resampling.BICUBIC)
        picture, page = resized.convert("RGBA"), Image.new("RGBA", size, (0, 0, 0, 0))
    else:
        picture = picture.resize(fitted, Image.Resampling.BICUBIC)
        page = Image.new("RGB", size, background)
    if fitted == size:
        return picture
    page.paste(picture, ((size[0] - fitted[0]) // 2, (size[1] - fitted[1]) // 2))
    return page


def _common_size(frames: Frames, side: int) -> tuple[int, int]:
    """Width and height that hold every frame, enlarged to `side` if smaller."""
    height = max(frame.shape[0] for frame in frames)
    width = max(frame.shape[1] for frame in frames)
    factor = max(1.0, side / max(height, width))
    return max(1, round(width * factor)), max(1, round(height * factor))


def _write_folder(frames: Frames, times: NDArray[np.float64], folder: Path) -> None:
    from PIL import Image

    folder.mkdir()
    digits = max(4, len(str(len(frames) - 1)))
    for number, frame in enumerate(frames):
        Image.fromarray(to_bytes(frame)).save(folder / f"frame-{number:0{digits}d}.png")


def _write_gif(frames: Frames, times: NDArray[np.float64], file: Path) -> None:
    from PIL import Image

    size = _common_size(frames, GIF_SIDE)
    # One palette for all frames, so that nothing flickers: taken from samples of each.
    samples = [to_bytes(frame[..., :3]).reshape(-1, 3) for frame in frames]
    step = max(1, sum(map(len, samples)) // 250_000)
    bars = np.zeros((256, 3), np.uint8)  # what stands beside frames of another shape
    pool = np.concatenate([sample[::step] for sample in samples] + [bars])[:, None]
    palette = Image.fromarray(pool).quantize(GIF_COLORS, method=Image.Quantize.MEDIANCUT)
    pictures = []
    for frame in frames:
        picture = _enlarged(frame, size)
        colors = picture.convert("RGB").quantize(
            palette=palette, dither=Image.Dither.FLOYDSTEINBERG
        )
        if picture.mode == "RGBA":
            clear = picture.getchannel("A").point(lambda alpha: 255 * (alpha < 128))
            colors.paste(GIF_COLORS, mask=clear)
        pictures.append(colors)
    durations = [GIF_FRAME_MS] * len(pictures)
    durations[0] = durations[-1] = GIF_HOLD_MS
    options: dict[str, Any] = {}
    if any(frame.shape[2] == 4 for frame in frames):
        # What was drawn before must not show through.
        options = {"transparency": GIF_COLORS, "disposal": 2}
    pictures[0].save(
        file, save_all=True, append_images=pictures[1:], duration=durations, loop=0,
        optimize=False, **options,
    )  # fmt: skip


def _write_sheet(frames: Frames, times: NDArray[np.float64], file: Path) -> None:
    from PIL import Image, ImageDraw, ImageFont

    count = min(SHEET_FRAMES, len(frames))
    chosen = np.unique(np.round(np.linspace(0, len(frames) - 1, count)).astype(int))
    width, height = _common_size([frames[i] for i in chosen], SHEET_SIDE)
    columns = min(SHEET_COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    gap, label = 12, 22
    sheet = Image.new(
        "RGB",
        (columns * (width + gap) + gap, rows * (height + label + gap) + gap),
        "white",
    )
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(14)
    for place, index in enumerate(chosen):
        x = gap + (place % columns) * (width + gap)
        y = gap + (place // columns) * (height + label + gap)
        picture = _enlarged(frames[index], (width, height), "white")
        sheet.paste(picture, (x, y), picture if picture.mode == "RGBA" else None)
        caption = f"t = {times[index]:.2f}"
        draw.text((x + width / 2, y + height + 3), caption, fill="black", font=font, anchor="ma")
    sheet.save(file)
