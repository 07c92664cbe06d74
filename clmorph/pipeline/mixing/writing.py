"""Write mixes to files: a sheet with all of them, or a film of a path through them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import write_together
from clmorph._shared.progress import StageProgress
from clmorph.errors import OutputError
from clmorph.frames.sequence import Frame
from clmorph.output.framing import Framing
from clmorph.output.metadata import as_png_info
from clmorph.output.options import FrameStyle
from clmorph.output.playback import held_frames, motion_of
from clmorph.output.recording import Drawn
from clmorph.output.save import Output, recorded_for, write_all
from clmorph.pipeline.mixing.weights import Layout
from clmorph.pipeline.options import MorphOptions

#: The ending of files with a sheet of mixes.
SHEET = ".png"


def check_outputs(outputs: Sequence[Output], n_stops: int, options: MorphOptions) -> None:
    """Check that files can hold a sheet, or a film with some stops, before any computation."""
    for output in outputs:
        if not n_stops and output.name != "sheet":
            raise OutputError(
                f"{output.path}: mixes side by side are one picture: expected a name that ends in "
                f"{SHEET}; a path through the mixes makes a film"
            )
        if output.format.keep:
            raise OutputError(
                f"{output.path}: this format holds morphs of two pictures, and not mixes: expected "
                ".gif, .webp, .apng, .mp4, .webm, .png, .tif or a folder"
            )
    if n_stops:
        motion = motion_of(options, held_frames(n_stops, options.n_frames))
        for output in outputs:
            output.check_motion(motion)


def sheet_of(
    pictures: Sequence[Frame], layout: Layout, pixelated: bool, background: str | None, clear: bool
) -> NDArray[np.uint8]:
    """Return pictures at their places on a sheet; see `Mixes.sheet`."""
    from PIL import Image

    style = FrameStyle(background=background or (None if clear else "white"))
    framing = Framing(style, [picture.shape for picture in pictures], pixelated)
    width, height = framing.size
    columns, rows = layout.size
    mode = "RGBA" if framing.clear else "RGB"
    ground = background or ((0, 0, 0, 0) if framing.clear else "white")
    sheet = Image.new(mode, (columns * width, rows * height), ground)
    for picture, (left, top) in zip(pictures, layout.places.tolist(), strict=True):
        framed = framing(np.rint(255 * picture).astype(np.uint8))
        sheet.paste(framed, (round(left * width), round(top * height)))
    return np.asarray(sheet)


def write_sheet(
    outputs: Sequence[Output],
    sheet: NDArray[np.uint8],
    metadata: Mapping[str, Any],
    texts: Mapping[Path, str] | None = None,
) -> None:
    """Write a sheet, (H, W, 3 or 4) uint8, to checked PNG files, and texts: all whole, or none."""
    from PIL import Image

    def write(new: Path) -> None:
        Image.fromarray(sheet).save(new, format="PNG", pnginfo=as_png_info(metadata))

    write_together([(output.place, output.path, write) for output in outputs], texts)


def write_film(
    outputs: Sequence[Output],
    legs: Sequence[Drawn],
    options: MorphOptions,
    pixelated: bool,
    metadata: Mapping[str, Any],
    texts: Mapping[Path, str] | None = None,
    progress: StageProgress | None = None,
) -> tuple[int, float]:
    """Write a path's film and texts, whole or none; return its frames and a round's seconds."""
    report = progress or (lambda stage, share: None)
    motion = motion_of(options, held_frames(len(legs) + 1, options.n_frames))
    style = FrameStyle(**options.of(FrameStyle))
    with recorded_for(
        outputs, legs, motion, n_morphs=len(legs), reverse=options.reverse, pixelated=pixelated,
        parameters=metadata, progress=report,
    ) as film:  # fmt: skip
        write_all(
            outputs, film, style,
            lambda output, share: report(f"write {output.path.name}", share), texts,
        )  # fmt: skip
        return len(film), film.duration
