"""Rendered frames of a morph or of a chain of morphs, from which files are written."""

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.items import MadeItems
from clmorph._shared.progress import Share, StageProgress
from clmorph.frames.sequence import FrameSequence
from clmorph.images.pixels import to_bytes
from clmorph.output.framing import Framing, in_time
from clmorph.output.options import FrameStyle
from clmorph.output.playback import Motion
from clmorph.output.spool import Spool


class Drawn(Protocol):
    """Frames that are drawn one after the other: a morph, or a leg of a path through mixes."""

    @property
    def times(self) -> NDArray[np.float64]:
        """The times of the frames, ascending from 0 to 1."""

    def iter_frames(self, first: int = 0) -> Generator[NDArray[np.float32], None, None]:
        """Draw the frames one by one, from a given number on."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Rendered frames and their timing."""

    #: (H, W, 3) or (H, W, 4), uint8 or floats in [0, 1], each of its own size, in the order of
    #: playback.
    frames: Sequence[NDArray[Any]]
    shapes: list[tuple[int, ...]]
    #: From 0 to the number of morphs; descending if reversed.
    times: NDArray[np.float64]
    #: Whether a frame is one of the pictures, and so is shown longer.
    holds: NDArray[np.bool_]
    motion: Motion
    #: Whether all pictures are pixel art.
    pixelated: bool = False
    #: The metadata of the files, as `json.dumps` takes them.
    parameters: Mapping[str, Any] = field(default_factory=dict)
    #: For formats that store more than frames; empty if they were not kept.
    morphs: list[FrameSequence] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.times)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return a frame in 8 bits."""
        return to_bytes(self.frames[index])

    def framing(
        self, style: FrameStyle, side: int = 1, *, even: bool = False, opacity: bool = True
    ) -> Framing:
        """Return the `Framing` that fits the frames to one size; see there for the arguments."""
        shapes = in_time(self.shapes, self.times)
        return Framing(style, shapes, self.pixelated, side, even, opacity)

    def played(self) -> list[tuple[int, float]]:
        """Return the frames of one round, each with the seconds for which it is shown."""
        return self.motion.played(self.holds)

    @property
    def duration(self) -> float:
        """Seconds of one round."""
        return sum(seconds for _, seconds in self.played())


@contextmanager
def recorded(
    morphs: Iterable[Drawn],
    motion: Motion,
    *,
    reverse: bool = False,
    n_morphs: int = 1,
    exact: bool = False,
    keep: bool = False,
    pixelated: bool = False,
    parameters: Mapping[str, Any] | None = None,
    folder: Path | None = None,
    progress: StageProgress | None = None,
) -> Iterator[Recording]:
    """Render morphs one by one into a temporary file in `folder`; `keep` holds them in memory."""
    report = progress or (lambda stage, share: None)
    times: list[float] = []
    holds: list[bool] = []
    kept: list[FrameSequence] = []
    with Spool(np.float32 if exact else np.uint8, folder) as spool:
        for number, morph in enumerate(morphs):
            if keep:
                assert isinstance(morph, FrameSequence)  # formats that need more are for morphs
                kept.append(morph)
            name = f"frames {number + 1}" if n_morphs > 1 else "frames"
            first = 0 if number == 0 else 1
            # After an error the threads that render frames end at once.
            with closing(morph.iter_frames(first)) as frames:
                for index, frame in enumerate(frames, first):
                    spool.append(frame if exact else to_bytes(frame))
                    times.append(number + float(morph.times[index]))
                    holds.append(index in (0, len(morph.times) - 1))
                    done = index + 1
                    report(name, Share(done / len(morph.times), f"{done} of {len(morph.times)}"))
            del morph, frames  # before the next one is computed
        step = -1 if reverse else 1
        shapes = [spool.shape(index) for index in range(len(spool))]
        backwards = MadeItems(lambda index: spool[-1 - index], len(spool))
        yield Recording(
            backwards if reverse else spool, shapes[::step], np.array(times)[::step],
            np.array(holds)[::step], motion, pixelated, dict(parameters or {}), kept,
        )  # fmt: skip
