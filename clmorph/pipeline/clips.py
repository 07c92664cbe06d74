"""Recolor clips: one map for all frames, fitted once, applied to one frame after the other."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import atomic_path, check_apart, check_named_place
from clmorph._shared.progress import Share, StageProgress
from clmorph._shared.typing import Array, ArrayLike
from clmorph._shared.validation import check_max_pixels, check_progress, is_path, shown
from clmorph.backends.interface import Operations
from clmorph.backends.select import Backend, get_backend
from clmorph.clips.reading import Clip, Frame, Sound
from clmorph.clips.tags import ColorTags
from clmorph.clips.writing import CONTAINERS, ClipWriter, even
from clmorph.errors import InputError
from clmorph.images.looks import Lut
from clmorph.images.pixels import MAX_PIXELS, as_pixels
from clmorph.output.formats.format import check_sides, encoding
from clmorph.output.formats.video import check_video
from clmorph.output.metadata import as_text, checked_parameters
from clmorph.pipeline.documentation import documented
from clmorph.pipeline.keywords import RecolorKeywords
from clmorph.pipeline.luts import LutOnDevice
from clmorph.pipeline.recolor import SAMPLES, Look, fitted_look, lattice, weights_of
from clmorph.pipeline.recolor_options import RecolorOptions

#: Frames, at even distances over a clip, whose colors count.
FRAMES = 16
#: Nodes along each axis of the table by which frames are recolored.
NODES = 65


def check_clip_place(path: str | PathLike[str], format: str | None = None) -> Path:
    """Return the path of a clip to be written, or raise OutputError if it cannot be written."""
    endings = [f".{name}" for name in CONTAINERS]
    expected = f"{' or '.join(endings)} for a clip"
    place = check_named_place(path, endings, "out.mp4", expected, format and f".{format}")
    check_video()
    return place


def container_of(path: str | PathLike[str], format: str | None = None) -> str:
    """Return the container that an ending or a format stands for."""
    return Path(path).suffix.lower()[1:] if format is None else format


@documented(RecolorOptions)
def recolor_clip(
    clip: str | PathLike[str],
    like: ArrayLike | Lut,
    path: str | PathLike[str],
    options: RecolorOptions | None = None,
    *,
    max_pixels: int = MAX_PIXELS,
    backend: Backend = "auto",
    progress: StageProgress | None = None,
    **given: Unpack[RecolorKeywords],
) -> None:
    """Give a clip the colors of a picture, by one map of colors for all its frames.

    The map is fitted once, to 16 frames over the clip or to `reference_frame`. Frames are read,
    recolored and written one by one. Sound, times, and color tags are those of the clip; frames
    stand upright, and their sides are made even.

    Parameters
    ----------
    clip : path
        A film of any usual kind. One of high dynamic range is refused.
    like : array or Lut
        The picture that has the colors, see `clmorph.images.pixels.as_pixels`, or a table.
    path : path
        ``.mp4`` (H.264) or ``.webm`` (VP9); both copy the sound as it is. An existing file is
        replaced when the new one is whole.
    options : RecolorOptions, optional
        All options at once; options given by name replace those of this object.
    max_pixels : int
        Clips with larger frames are refused.
    backend : str, object of pyopencl, or Operations
        See `clmorph.get_backend`.
    progress : callable, optional
        A function that is called with a stage's name and the share of it that is done.
    {options}

    Raises
    ------
    InputError
        If an argument cannot be used, or (FileError) the clip.
    OutputError
        If the file cannot be written, or the extra "video" is missing.
    DeviceError
        If the device cannot be found or fails.

    Examples
    --------
    >>> import clmorph
    >>> picture = clmorph.read_image("palette.jpg")  # doctest: +SKIP
    >>> clmorph.recolor_clip("clip.mp4", picture, "out.mp4")  # doctest: +SKIP
    """
    chosen = RecolorOptions.of_call(options, given, "strength=0.5")
    report = check_progress(progress)
    if not is_path(clip):
        raise InputError(f"clip={shown(clip)}: expected the path of a film, such as 'clip.mp4'")
    check_max_pixels(max_pixels)
    place = check_clip_place(path)
    check_apart([path], [clip])
    look = like if isinstance(like, Lut) else as_pixels(like, "like")
    operations = get_backend(backend)
    recoloring = ClipRecoloring(Path(clip), look, chosen, operations, max_pixels, report)
    with atomic_path(place) as file:
        recoloring.write(file, container_of(path), {}, report)


class ClipRecoloring:
    """A clip and the table that recolors its frames, like a picture or a table; all are checked."""

    def __init__(
        self,
        clip: Path,
        like: Array | Lut,
        options: RecolorOptions,
        operations: Operations,
        max_pixels: int,
        report: StageProgress,
    ) -> None:
        self._path, self._max_pixels = clip, max_pixels
        with Clip(clip, max_pixels) as opened:
            self.tags, self.size = opened.tags, opened.size
        if isinstance(like, Lut):
            lut = _in_part(like, options.strength, self.tags, operations)
        else:
            look = self._look(like, options, operations, report)
            lut = _as_table(
                self.tags, lambda colors: colors if look is None else look.moved(colors, report)
            )
        self._apply = LutOnDevice(lut, operations)

    def write(
        self, file: Path, container: str, parameters: dict[str, Any], report: StageProgress
    ) -> int:
        """Write the recolored clip to a new file; return the number of its frames."""
        import av

        kind = CONTAINERS[container]
        with Clip(self._path, self._max_pixels) as clip:
            size = clip.size[0] + clip.size[0] % 2, clip.size[1] + clip.size[1] % 2
            check_sides(size, kind.longest_side, kind.words)
            with (
                encoding(kind.words, av.error.FFmpegError),
                ClipWriter(
                    file, container, size, clip.rate, clip.time_base, clip.tags, clip.matrix,
                    aspect=clip.aspect, comment=as_text(checked_parameters(parameters)),
                    deep=clip.deep, sounds=clip.sounds, changes=kind.fast,
                ) as writer,
            ):  # fmt: skip
                return self._copy(clip, writer, report)

    def _copy(self, clip: Clip, writer: ClipWriter, report: StageProgress) -> int:
        count, first = 0, None
        for part in clip.parts():
            if isinstance(part, Sound):
                writer.copy(part.packet)
                continue
            first = part.time if first is None else first
            count += 1
            writer.write(even(self._recolored(part)), [round(part.time / clip.time_base)])
            done = float(part.time - first + 1 / clip.rate) / (clip.duration or np.inf)
            report("frames", Share(min(0.999, done), f"{count} frames"))
        writer.finish()
        report("frames", Share(1.0, f"{count} frames"))
        return count

    def _recolored(self, frame: Frame) -> NDArray[Any]:
        most = np.iinfo(frame.pixels.dtype).max
        found = self._apply(frame.pixels * np.float32(1.0 / most))
        found *= np.float32(most)
        return np.rint(found, out=found).astype(frame.pixels.dtype)

    def _look(
        self, like: Array, options: RecolorOptions, operations: Operations, report: StageProgress
    ) -> Look | None:
        """Fit a look to some frames of the clip."""
        if options.strength == 0:
            return None
        parts = [self._sample(frame) for frame in self._chosen(options.reference_frame)]
        colors = np.concatenate(parts)[None]
        return fitted_look(
            (colors, np.ones(colors.shape[:2])), (like[..., :3], weights_of(like)), options,
            operations, lambda share: report("colors", share),
        )  # fmt: skip

    def _sample(self, frame: Frame) -> Array:
        """Return some colors of a frame in sRGB: (N, 3) array."""
        pixels = frame.pixels
        step = int(np.ceil(np.sqrt(pixels.size / 3 * FRAMES / SAMPLES)))
        some = pixels[:: max(1, step), :: max(1, step)].reshape(-1, 3)
        return self.tags.to_srgb(some / float(np.iinfo(pixels.dtype).max))

    def _chosen(self, number: int | None) -> list[Frame]:
        """Return the frame of a number, or frames over the whole clip."""
        with Clip(self._path, self._max_pixels) as clip:
            if number is not None:
                frame = clip.numbered(number)
                if frame is None:
                    raise InputError(
                        f"reference_frame={number}: {self._path} has fewer frames; expected a "
                        "number from 0"
                    )
                return [frame]
            if clip.duration is None:
                return [frame for frame, _ in zip(clip.frames(), range(FRAMES), strict=False)]
            times = (np.arange(FRAMES) + 0.5) / FRAMES * clip.duration
            found = [frame for time in times if (frame := clip.at(float(time))) is not None]
        if found:
            return found
        with Clip(self._path, self._max_pixels) as clip:
            return [next(clip.frames())]


def _as_table(tags: ColorTags, change: Callable[[Array], Array]) -> Lut:
    """Return a change of colors of sRGB as a table of the clip's own colors."""
    found = tags.from_srgb(change(tags.to_srgb(lattice(NODES))))
    return Lut(found.reshape(NODES, NODES, NODES, 3))


def _in_part(lut: Lut, strength: float, tags: ColorTags, operations: Operations) -> Lut:
    """Return a table of which colors go a share of the way, in the clip's own colors."""
    if strength == 1.0 and tags.is_srgb:
        return lut
    apply = LutOnDevice(lut, operations)
    return _as_table(tags, lambda colors: colors + strength * (apply(colors) - colors))
