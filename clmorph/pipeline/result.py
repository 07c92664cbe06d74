"""The result `Morph`: a sequence of frames that can be rendered and saved."""

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.progress import Share, StageProgress
from clmorph._shared.validation import check_number, check_progress
from clmorph.backends.arrays import pyopencl_needed
from clmorph.backends.interface import Operations
from clmorph.errors import InputError
from clmorph.frames.frame_renderer import FrameRenderer, SpreadRenderer
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.layers import Layers
from clmorph.frames.particles import Particles
from clmorph.frames.sequence import Frame
from clmorph.images.detail import is_pixel_art
from clmorph.measures.measure import Measure
from clmorph.measures.pixel_blocks import solved_size
from clmorph.pipeline.film import Film, picture_of
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.recipe import recipe
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials


@dataclass(frozen=True, repr=False, eq=False)
class Morph(Film):
    """A morph between two images: a sequence of frames, rendered on demand.

    ``len(morph)`` is the number of frames and ``morph[i]`` is the frame at ``times[i]``. Slices and
    iteration are supported. `frame` renders the frame at any time.

    Attributes
    ----------
    source, target : Measure
        The images, lifted to position and color; smaller copies of them if there are `pictures`.
    potentials : Potentials
        The solution of the transport problem. With labels it holds those of the problem of each
        label, one after another, over the points that have mass
        (`clmorph.transport.subproblems`).
    plan : Plan or Barycentric
    particles : Particles
    times : (n_frames,) array
        The times of the frames, ascending from 0 to 1.
    kernel_width : KernelWidth
    operations : Operations
        The backend that renders the frames. Several devices share them, see
        `clmorph.frames.frame_renderer`.
    endpoints : {"exact", "paper"}
        Whether the first and the last frame are the images themselves.
    unmatched : {"fade", "grow", "drop"}
        Whether unmatched mass is drawn and fades, or is not drawn.
    options : MorphOptions
        The options of `clmorph.morph`.
    arrays : tuple of str
        Names of the further input arrays: "weights", "color_metric", "labels", "features".
    shapes : pair of (height, width) or None
        Shapes of the images as they were given; None if they are those of the measures.
    pictures : pair of (H, W, 3) arrays or None
        The images as frames show them at both ends, in float32, where they have more pixels than
        the measures: with layers, particles give fields alone, so that above 512 pixels along the
        longer side smaller copies are lifted, unless more is solved than these.
    found : str
        What ``landmarks="auto"`` has found, in a line; "" if nothing. `options` has the points.
    misses : (n,) array
        How far the warp misses the partner of each landmark, in pixels of image_b as it was given.

    Examples
    --------
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
    >>> len(morph), morph[0].shape
    (5, (6, 6, 3))
    >>> bool(np.allclose(morph[0], left, atol=1e-3))
    True
    >>> middle = morph.frame(0.5)
    >>> [round(float(t), 2) for t in morph.times]
    [0.0, 0.25, 0.5, 0.75, 1.0]
    """

    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan | Barycentric
    particles: Particles
    times: NDArray[np.float64]
    kernel_width: KernelWidth
    operations: Operations = field(repr=False)
    endpoints: str = "exact"
    unmatched: str = "fade"
    options: MorphOptions = field(default_factory=MorphOptions, repr=False)
    arrays: tuple[str, ...] = ()
    shapes: tuple[tuple[int, int], tuple[int, int]] | None = None
    pictures: tuple[NDArray[Any], NDArray[Any]] | None = field(default=None, repr=False)
    found: str = ""
    misses: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), repr=False)
    _renderer: SpreadRenderer = field(init=False, repr=False, compare=False)
    #: Cache of rendered frames: it holds no frame or all frames.
    _kept: list[NDArray[np.float32]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        # Ends seen through the kernel, and widths found for it, ask for the particles' own detail.
        asked = self.endpoints == "paper" or self.kernel_width.curve is not None
        renderer = FrameRenderer(
            self.source, self.target, self.plan, self.particles, self.kernel_width,
            self.operations, self.endpoints, self.unmatched,
            "particles" if asked else self.options.detail, self.pictures,
        )  # fmt: skip
        object.__setattr__(self, "_renderer", SpreadRenderer(renderer, self.times))

    def __repr__(self) -> str:
        (h, w), (height, width) = (self.canvas(t).shape for t in (0.0, 1.0))
        return (
            f"<Morph of {w} x {h} into {width} x {height} pixels, {len(self.times)} frames, "
            f"{len(self.particles)} particles, {self.potentials.message}>"
        )

    @property
    def solved_sizes(self) -> tuple[int, int]:
        """Numbers of solved blocks along the longer sides: at most the option `solve_size`."""
        most = self.options.solve_size
        return solved_size(self.source.shape, most), solved_size(self.target.shape, most)

    @property
    def parameters(self) -> dict[str, Any]:
        """The recipe of this morph in the form of files, which `json.dumps` accepts."""
        return recipe(self.options, device=self.operations.description, arrays=self.arrays)

    def _item(self, index: int) -> NDArray[np.float32]:
        return self._kept[index] if self._kept else super()._item(index)

    def _frames_from(self, first: int) -> Generator[Frame, None, None]:
        """Draw frames by all devices at once, unless they are cached."""
        if self._kept or not self._renderer.at_once:
            return super()._frames_from(first)
        return self._renderer.frames(first)

    @property
    def detail(self) -> str:
        """What draws the frames: "layers", "cells", "pixels" or "particles".

        It is the option `detail`, but "particles" with ``endpoints="paper"`` or optimal widths.
        """
        return self._renderer.detail

    @property
    def layers(self) -> Layers:
        """Both pictures in motion, with ``detail="layers"``: fields, agreement, times.

        Raises
        ------
        InputError
            If something else draws the frames.
        """
        layers = self._renderer.layers
        if layers is None:
            raise InputError(f'detail={self.detail!r}: expected "layers"; only they have layers')
        return layers

    @property
    def halfway(self) -> None:
        """None. Deprecated: it was the motion of carried detail, which `layers` has replaced."""
        warn("clmorph 1.0 will remove Morph.halfway, which is None: use Morph.layers",
             DeprecationWarning, stacklevel=2)  # fmt: skip

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(n_frames,) kernel width at `times`, in pixels; 0 where there is no kernel.

        It is the width for ``detail="particles"`` and for `sums`.
        """
        return np.array([self.kernel_width.at(t, self.canvas(t)) for t in self.times])

    def frame(self, t: float) -> NDArray[np.float32]:
        """Render the frame at time t.

        With ``detail="layers"`` each place shows one of the two pictures, moved and recolored along
        the plan (`clmorph.frames.layers`); with "cells" the blocks of both move as wholes
        (`clmorph.frames.cells`), and with "pixels" whole pixels of sprites
        (`clmorph.frames.sprites`). With "particles" a pixel is
        the weighted mean of Eq. 4 where `coverage` is at least `render.HOLE_COVERAGE`
        (with "local" splatting, and where it is not torn out of its surroundings). Where coverage
        is at most half of that, the kernels' tails would decide, and
        wider kernels fill the pixel instead. Between the two limits both results are mixed. Pixels
        therefore follow particles nearby, rather than pairs that the plan has dropped.

        Parameters
        ----------
        t : float in [0, 1]

        Returns
        -------
        (H(t), W(t), 3) float32 array
            sRGB in [0, 1]. If an image has pixels that are not opaque, the shape is
            (H(t), W(t), 4), with opacity as the fourth channel.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> frame = morph.frame(0.3)
        >>> frame.shape, frame.dtype.name
        ((6, 6, 3), 'float32')
        """
        return self._renderer.frame(check_number("t", t, 0.0, 1.0)).astype(np.float32, copy=False)

    def device_frame(self, t: float, queue: Any = None) -> Any:
        """Render the frame at time t into a new array in the memory of a device.

        Parameters
        ----------
        t : float in [0, 1]
        queue : pyopencl.CommandQueue or Operations, optional
            The queue of the array, or the backend whose queue it is; by default the queue on which
            the morph itself is computed.

        Returns
        -------
        (H(t), W(t), 3) or (H(t), W(t), 4) `pyopencl.array.Array` of float32
            The same values as those of `frame`, in C order. Its ``events`` hold the end of the
            writing; work that is enqueued on its queue is ordered after it, if the queue is in
            order.

        Raises
        ------
        InputError
            If `t` or `queue` cannot be used; also if there is no queue, with the backend "numpy".
        DeviceError
            If the array cannot be made, or the device fails.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> try:
        ...     morph.device_frame(0.3)
        ... except clmorph.InputError:
        ...     print("NumPy has no queue")
        NumPy has no queue
        """
        with pyopencl_needed("queue"):
            from clmorph.backends.opencl.device_arrays import as_queue, to_device

        queue = as_queue(self.operations if queue is None else queue)
        return to_device(queue, self._renderer.frame(check_number("t", t, 0.0, 1.0)), np.float32)

    def coverage(self, t: float) -> NDArray[np.float32]:
        """Return how well the particles cover each pixel at time t, before filling.

        Returns
        -------
        (H(t), W(t)) float32 array
            Kernel mass relative to that of evenly spread particles; see
            `clmorph.analysis.metrics.hole_fraction`.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> morph.coverage(0.5).shape
        (6, 6)
        """
        return self.sums(t).coverage.astype(np.float32)

    @property
    def frames(self) -> list[NDArray[np.float32]]:
        """All frames, at `times`; the first access renders and caches them."""
        keep_frames(self)
        return self._kept

    @property
    def pixelated(self) -> bool:
        """Whether both images are pixel art."""
        if self.pictures is not None:
            return all(is_pixel_art(picture) for picture in self.pictures)
        return all(is_pixel_art(picture_of(measure)) for measure in (self.source, self.target))


def keep_frames(morph: Morph, progress: StageProgress | None = None) -> None:
    """Render and cache all frames of a morph, so that files written later need not do so."""
    report = check_progress(progress)
    if morph._kept:
        return
    found = []
    with closing(morph.iter_frames()) as frames:
        for frame in frames:
            found.append(frame)
            report("frames", Share(len(found) / len(morph), f"{len(found)} of {len(morph)}"))
    morph._kept.extend(found)
