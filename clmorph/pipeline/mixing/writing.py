"""Mixes in files: a sheet with all of them, or a film of a path through them."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import write_together
from clmorph._shared.progress import StageProgress
from clmorph._shared.typing import Array
from clmorph.errors import OutputError
from clmorph.frames.sequence import Frame
from clmorph.output.metadata import as_png_info
from clmorph.output.options import FrameStyle
from clmorph.output.playback import held_frames, motion_of
from clmorph.output.save import Output, recorded_for, write_all
from clmorph.pipeline.options import MorphOptions


@dataclass(frozen=True)
class Leg:
    """The frames of a path from one mix to another one.

    Attributes
    ----------
    draw : callable
        Draws a mix by its weights.
    start, end : (K,) arrays
        Weights at both ends.
    times : (n,) array
        Times of the frames, from 0 to 1; weights change linearly with time.

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> images = np.zeros((3, 6, 6, 3))
    >>> mixes = clmorph.mix(images, [1, 1, 1], n_frames=3, backend="numpy")
    >>> leg = mixes.path("ab")[0]
    >>> len(leg), next(leg.iter_frames()).shape
    (3, (6, 6, 3))
    """

    draw: Callable[[Array], Frame]
    start: Array
    end: Array
    times: Array

    def __len__(self) -> int:
        return len(self.times)

    def iter_frames(self, first: int = 0) -> Generator[Frame, None, None]:
        """Draw the frames one by one.

        Parameters
        ----------
        first : int
            Number of the first frame.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> images = np.zeros((2, 6, 6, 3))
        >>> leg = clmorph.mix(images, [1, 1], n_frames=3, backend="numpy").path("ab")[0]
        >>> [frame.shape for frame in leg.iter_frames()]
        [(6, 6, 3), (6, 6, 3), (6, 6, 3)]
        """
        return (self.draw((1 - t) * self.start + t * self.end) for t in self.times[first:])


def check_outputs(outputs: Sequence[Output], n_stops: int, options: MorphOptions) -> None:
    """Check that files can hold a sheet, or a film with some stops, before any computation."""
    for output in outputs:
        if not n_stops and output.name != "sheet":
            raise OutputError(
                f"{output.path}: mixes side by side are one picture: expected a name that ends in "
                ".png; a path through the mixes makes a film"
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
    legs: Sequence[Leg],
    options: MorphOptions,
    pixelated: bool,
    metadata: Mapping[str, Any],
    texts: Mapping[Path, str] | None,
    progress: StageProgress,
) -> tuple[int, float]:
    """Write a path's film and texts, whole or none; return its frames and a round's seconds."""
    motion = motion_of(options, held_frames(len(legs) + 1, options.n_frames))
    style = FrameStyle(**options.of(FrameStyle))
    with recorded_for(
        outputs, legs, motion, n_morphs=len(legs), reverse=options.reverse, pixelated=pixelated,
        parameters=metadata, progress=progress,
    ) as film:  # fmt: skip
        write_all(
            outputs, film, style,
            lambda output, share: progress(f"write {output.path.name}", share), texts,
        )  # fmt: skip
        return len(film), film.duration
