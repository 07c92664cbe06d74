"""Render the frames of one morph on all devices of a backend, each frame on one of them."""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.typing import Array
from clmorph.backends.multi_device import members_of, turns
from clmorph.backends.threads import results_in_order
from clmorph.frames.canvas import Canvas
from clmorph.frames.frame_renderer import FrameRenderer
from clmorph.frames.layers import Layers
from clmorph.frames.render import Sums, Widths


class SpreadRenderer:
    """Renders a morph by the devices of a backend, as `FrameRenderer` does by one device.

    The number of a frame and the devices' speeds decide which device renders it, so that frames
    repeat to the bit. A frame at another time is rendered by the first device, which also computes
    the correction of the ends that all devices use.
    """

    def __init__(self, renderer: FrameRenderer, times: Array) -> None:
        first, *others = members_of(renderer.operations)
        self._first = renderer if not others else renderer.on(first)
        self._renderers = [self._first, *(renderer.on(each, self._first) for each in others)]
        self._times = times
        self._turns = turns(renderer.operations, len(times))
        self._turn_at = {float(t): turn for t, turn in zip(times, self._turns, strict=True)}

    def canvas(self, t: float) -> Canvas:
        """Return the canvas at time t."""
        return self._first.canvas(t)

    def _at(self, t: float) -> FrameRenderer:
        turn = self._turn_at.get(t)
        return self._first if turn is None else self._renderers[turn]

    def frame(self, t: float) -> NDArray[np.floating]:
        """Render the frame at time t; see `FrameRenderer.frame`."""
        return self._at(t).frame(t)

    def sums(self, t: float, widths: Widths | None = None) -> Sums:
        """Render colors, coverage and density at time t; see `FrameRenderer.sums`."""
        return self._at(t).sums(t, widths)

    @property
    def detail(self) -> str:
        """What draws the frames; see `FrameRenderer.detail`."""
        return self._first.detail

    @property
    def layers(self) -> Layers | None:
        """The layers of both pictures; None if something else draws the frames."""
        return self._first.layers

    @property
    def at_once(self) -> bool:
        """Whether frames are rendered at the same time, by several devices."""
        return len(self._renderers) > 1

    def frames(self, first: int) -> Generator[NDArray[np.float32], None, None]:
        """Render frames, as many at once as there are devices, and yield them from `first` on.

        At most two frames of each device are in memory, beside the one that the caller has.
        """
        # The correction of the ends is computed before the threads start, and so only once.
        self._first.prepare()

        def frame(turn: int, number: int) -> NDArray[np.float32]:
            t = float(self._times[first + number])
            return self._renderers[turn].frame(t).astype(np.float32, copy=False)

        yield from results_in_order(self._turns[first:], frame)
