"""The frames of a morph and its transport, as files, pages and measures of quality use them."""

from abc import abstractmethod
from collections.abc import Generator, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.items import Items
from clmorph._shared.typing import Array
from clmorph._shared.validation import check_integer, check_number, shown
from clmorph.errors import InputError
from clmorph.frames.canvas import Canvas
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.particles import Particles
from clmorph.frames.render import Sums, Widths, check_widths
from clmorph.measures.measure import Measure
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials

Frame = NDArray[np.float32]


class FrameSequence(Items[Frame]):
    """The frames at `times`, drawn when they are asked for, and the transport behind them."""

    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan | Barycentric
    particles: Particles
    #: Times of the frames, ascending from 0 to 1: (n_frames,) array.
    times: Array
    kernel_width: KernelWidth
    #: "exact" if the first and the last frame are the images themselves, else "paper".
    endpoints: str
    #: Whether mass that does not travel is drawn: "fade", "grow" or "drop".
    unmatched: str
    #: The options of the morph, including those of playback and of files.
    options: Any
    #: Shapes (height, width) of the images as they were given; None if frames have these.
    shapes: tuple[tuple[int, int], tuple[int, int]] | None = None

    #: What draws them, such as a `clmorph.frames.frame_renderer.FrameRenderer`.
    _renderer: Any

    #: What such frames are, in a word.
    kind: ClassVar[str] = "Morph"

    @property
    def title(self) -> str:
        """What a page is called whose pictures have no names: what the film is, and its sizes."""
        kind = "Mosaic" if self.detail == "cells" else self.kind
        ends = [self.canvas(t).shape for t in (0.0, 1.0)]
        sizes = [f"{width} × {height}" for height, width in ends]
        return f"{kind} of {' into '.join(dict.fromkeys(sizes))} pixels"

    @property
    @abstractmethod
    def parameters(self) -> Mapping[str, Any]:
        """The recipe, as values that `json.dumps` accepts."""

    @property
    def given_shapes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Shapes (height, width) of the images as they were given, in whose pixels landmarks are.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> image = np.eye(12)
        >>> morph = clmorph.morph(image, image, size=6, n_frames=2, backend="numpy")
        >>> morph.given_shapes, morph.source.shape
        (((12, 12), (12, 12)), (6, 6))
        """
        return self.shapes or (self.canvas(0.0).shape, self.canvas(1.0).shape)

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> morph.canvas(0.5).shape
        (6, 6)
        """
        canvas: Canvas = self._renderer.canvas(check_number("t", t, 0.0, 1.0))
        return canvas

    def sums(self, t: float, *, widths: Widths | None = None) -> Sums:
        """Render colors, coverage and density at time t as splats, without exact ends.

        Parameters
        ----------
        t : float in [0, 1]
        widths : Widths, optional
            Kernel widths, in place of those of the frames.

        Returns
        -------
        Sums

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> sums = morph.sums(0.5)
        >>> sums.colors.shape, sums.coverage.shape, sums.density.shape
        ((6, 6, 3), (6, 6), (6, 6))
        """
        t = check_number("t", t, 0.0, 1.0)
        sums: Sums = self._renderer.sums(t, check_widths(widths))
        return sums

    @abstractmethod
    def frame(self, t: float) -> Frame:
        """Render the frame at time t: (H(t), W(t), 3) or (H(t), W(t), 4) array."""

    @property
    @abstractmethod
    def detail(self) -> str:
        """What draws the frames: the option `detail`."""

    @property
    @abstractmethod
    def pixelated(self) -> bool:
        """Whether both images are pixel art."""

    def __len__(self) -> int:
        return len(self.times)

    def _item(self, index: int) -> Frame:
        return self.frame(float(self.times[index]))

    def iter_frames(self, first: int = 0) -> Generator[Frame, None, None]:
        """Render the frames one by one, without keeping them.

        Several devices of a morph work at once. Frames that `Morph.frames` has cached are not
        rendered again.

        Parameters
        ----------
        first : int
            Number of the first frame.

        Examples
        --------
        >>> import clmorph
        >>> import numpy as np
        >>> left, right = np.zeros((2, 6, 6, 3))
        >>> left[:, :3] = right[:, 3:] = 1.0
        >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
        >>> [frame.shape for frame in morph.iter_frames()]
        [(6, 6, 3), (6, 6, 3), (6, 6, 3), (6, 6, 3), (6, 6, 3)]
        """
        return self._frames_from(check_integer("first", first, 0, len(self)))

    def _frames_from(self, first: int) -> Generator[Frame, None, None]:
        return (self[index] for index in range(first, len(self)))


def check_frame_sequence(morph: FrameSequence) -> None:
    """Raise InputError unless the argument is a morph."""
    if not isinstance(morph, FrameSequence):
        raise InputError(f"morph={shown(morph)}: expected a Morph, as clmorph.morph returns it")
