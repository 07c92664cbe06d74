"""The result `Rearrangement`: frames in which the pixels of one image move to form another one."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph._shared.validation import check_number
from clmorph.backends.interface import Operations
from clmorph.frames.cells import mirrored, owners_at
from clmorph.frames.frame_renderer import FrameRenderer
from clmorph.frames.kernel_width import KernelWidth
from clmorph.frames.particles import Particles
from clmorph.images.detail import is_pixel_art
from clmorph.measures.measure import Measure
from clmorph.pipeline.film import Film, picture_of
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recipe import recipe
from clmorph.transport.assignment import Indices
from clmorph.transport.plan import Plan
from clmorph.transport.potentials import Potentials


@dataclass(frozen=True, repr=False, eq=False)
class Rearrangement(Film):
    """The pixels of image A on their way to form image B: a sequence of frames, drawn on demand.

    ``len(found)`` is the number of frames and ``found[i]`` is the frame at ``times[i]``.

    Attributes
    ----------
    assignment : (H * W,) array of int
        The place at which each pixel of A arrives; pixels are counted row by row. A permutation.
    cost : float
        Mean over the pixels of half the squared distance between a pixel of A and the pixel of B
        whose place it takes, in position and color (`clmorph.lift`); in squared sides of the image.
    lower_bound : float
        No permutation has a lower cost.
    source, target : Measure
        Image A, and the picture that its pixels form in the end.
    potentials : Potentials
        Entropic potentials of the pixels, from which the search began.
    plan : Plan
        The permutation as a plan.
    particles : Particles
        One for each pixel.
    times : (n_frames,) array
        The times of the frames, ascending from 0 to 1.
    options : RearrangeOptions

    Examples
    --------
    >>> import numpy as np
    >>> import clmorph
    >>> a = np.array([[0.0, 0.25, 0.75, 1.0]])
    >>> found = clmorph.rearrange(a, a[:, ::-1], n_frames=3, color_weight=10.0, backend="numpy")
    >>> found.assignment.tolist()
    [3, 2, 1, 0]
    >>> found[-1][0, :, 0].tolist()
    [1.0, 0.75, 0.25, 0.0]
    """

    kind: ClassVar[str] = "Rearrangement"

    assignment: Indices
    cost: float
    lower_bound: float
    source: Measure
    target: Measure
    potentials: Potentials
    plan: Plan
    particles: Particles
    times: Array
    kernel_width: KernelWidth
    operations: Operations = field(repr=False)
    options: RearrangeOptions = field(repr=False)
    endpoints: str = "exact"
    unmatched: str = "drop"

    def __repr__(self) -> str:
        height, width = self.source.shape
        return (
            f"<Rearrangement of {width} x {height} pixels, {len(self)} frames, cost "
            f"{self.cost:.4g}, at least {self.lower_bound:.4g}>"
        )

    @property
    def parameters(self) -> dict[str, Any]:
        """The recipe in the form of files, which `json.dumps` accepts."""
        return recipe(self.options, device=self.operations.description)

    @property
    def detail(self) -> str:
        """What draws the frames: "pixels"."""
        return "pixels"

    @property
    def pixelated(self) -> bool:
        """Whether image A is pixel art."""
        return is_pixel_art(self._pixels.astype(float))

    def frame(self, t: float) -> NDArray[np.float32]:
        """Draw the pixels at time t of their straight ways: each place shows the nearest one.

        The first and the last frame hold each pixel once. Between them pixels that meet hide one
        another. Where they are far apart each one takes the room around it, and fills it with what
        is around it in A.

        Parameters
        ----------
        t : float in [0, 1]

        Returns
        -------
        (H, W, 3) float32 array
            sRGB in [0, 1]; (H, W, 4), with opacity, if A or B has transparent pixels.

        Examples
        --------
        >>> import numpy as np
        >>> import clmorph
        >>> a = np.array([[0.0, 0.25, 0.75, 1.0]])
        >>> clmorph.rearrange(a, a, backend="numpy").frame(0.5)[0, :, 0].tolist()
        [0.0, 0.25, 0.75, 1.0]
        """
        t = check_number("t", t, 0.0, 1.0)
        positions, shape = self.source.positions, self.source.shape
        ends = positions[self.assignment]
        nearest = owners_at(positions, ends, t, self.canvas(t), self.operations)
        ways = np.stack(np.unravel_index(self.assignment, shape)) - np.indices(shape).reshape(2, -1)
        # Halves are rounded alike, so that neighbors stay neighbors.
        places = np.floor(np.indices(shape) - t * ways[:, nearest] + 0.5).astype(np.intp)
        return self._pixels[tuple(mirrored(places, shape))]

    @cached_property
    def _pixels(self) -> NDArray[np.float32]:
        return picture_of(self.source).astype(np.float32)

    @cached_property
    def _renderer(self) -> FrameRenderer:
        return FrameRenderer(
            self.source, self.target, self.plan, self.particles, self.kernel_width,
            self.operations, self.endpoints, self.unmatched, "particles",
        )  # fmt: skip
