"""Rendered frames of a morph or of a chain of morphs, from which files are written."""

import io
import tempfile
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.items import Items, MadeItems
from clmorph._shared.printable import reason_of
from clmorph._shared.progress import Share, StageProgress
from clmorph._shared.staging import staging_folder
from clmorph._shared.typing import AnyArray, Array, BoolArray
from clmorph.errors import OutputError
from clmorph.frames.sequence import FrameSequence
from clmorph.images.pixels import to_bytes
from clmorph.output.options import FrameStyle
from clmorph.output.playback import Motion

if TYPE_CHECKING:
    from clmorph.output.framing import Framing

#: The largest number of bytes of frames in memory; beyond it they go to a temporary file.
IN_MEMORY = 128 * 1024**2


class Drawn(Protocol):
    """Frames that are drawn one after the other: a morph, or a leg of a path through mixes."""

    @property
    def times(self) -> Array:
        """The times of the frames, ascending from 0 to 1."""

    def iter_frames(self, first: int = 0) -> Generator[NDArray[np.float32], None, None]:
        """Draw the frames one by one, from a given number on."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Rendered frames and their timing."""

    #: (H, W, 3) or (H, W, 4), uint8 or floats in [0, 1], each of its own size, in the order of
    #: playback.
    frames: Sequence[AnyArray]
    shapes: list[tuple[int, ...]]
    #: From 0 to the number of morphs; descending if reversed.
    times: Array
    #: Whether a frame is one of the pictures, and so is shown longer.
    holds: BoolArray
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
    ) -> "Framing":
        """Return the `Framing` that fits the frames to one size; see there for the arguments."""
        from clmorph.output.framing import Framing, in_time

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


class Spool(Items[AnyArray]):
    """A sequence of arrays of one dtype, for a `with` block: a few in memory, more in a file."""

    def __init__(self, dtype: Any, folder: Path | None = None) -> None:
        self._dtype = np.dtype(dtype)
        self._folder = folder
        self._stack = ExitStack()
        self._file: IO[bytes] = io.BytesIO()
        self._places: list[tuple[int, tuple[int, ...]]] = []

    def append(self, array: AnyArray) -> None:
        """Add an array of the spool's dtype."""
        if array.dtype != self._dtype:
            raise TypeError(f"an array of {array.dtype} in a spool of {self._dtype}")
        with _disk_errors():
            offset = self._file.seek(0, 2)
            if isinstance(self._file, io.BytesIO) and offset + array.nbytes > IN_MEMORY:
                self._file = self._on_disk(self._file)
            self._file.write(np.ascontiguousarray(array).tobytes())
        self._places.append((offset, array.shape))

    def _on_disk(self, memory: io.BytesIO) -> IO[bytes]:
        """Return a temporary file with the bytes from memory, positioned at its end."""
        # Where files need names, the next run removes the folder of a killed process.
        place = self._folder and self._stack.enter_context(staging_folder(self._folder))
        file = tempfile.TemporaryFile(dir=place)  # noqa: SIM115 (the stack closes it)
        self._stack.callback(file.close)
        file.write(memory.getbuffer())
        return file

    def shape(self, index: int) -> tuple[int, ...]:
        """Return an array's shape without reading it."""
        return self._places[index][1]

    def __len__(self) -> int:
        return len(self._places)

    def _item(self, index: int) -> AnyArray:
        """Read an array."""
        offset, shape = self._places[index]
        with _disk_errors():  # written data may reach the disk only now
            self._file.seek(offset)
            data = self._file.read(int(np.prod(shape)) * self._dtype.itemsize)
        return np.frombuffer(data, self._dtype).reshape(shape)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(OSError):  # the disk may be full again, but the data are discarded anyway
            self._stack.close()


@contextmanager
def _disk_errors() -> Iterator[None]:
    """Raise OutputError for an error of the disk."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"frames cannot be kept on disk until they are written ({reason_of(error)}): "
            "free some space, or take fewer or smaller frames"
        ) from error
