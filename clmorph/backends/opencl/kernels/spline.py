"""Pictures sampled where a smooth motion says, by ``cl_kernels/spline.cl``."""

from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.build.variants import Variant
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.records import Motion

#: Work-items of a group, along a row: more than the lanes of any device.
GROUP = 256
#: Pixels of the first launch.
FIRST_PIXELS = 1 << 17


class Spline(NamedTuple):
    """The coefficients of a picture's spline, on the device."""

    shape: tuple[int, int]
    coefficients: cl.Buffer  # (H, W, 4) float32, with 0 after the three channels


class SplineSampling:
    """Samples splines.

    Parameters
    ----------
    work : Workspace
    programs : Programs
    """

    def __init__(self, work: Workspace, programs: Programs) -> None:
        self._work, self._programs = work, programs
        self._kernel: cl.Kernel | None = None
        self._budget = LaunchBudget(FIRST_PIXELS)

    def upload_spline(self, coefficients: NDArray[np.float32]) -> Spline:
        """Upload a picture; see `clmorph.backends.interface.Operations`."""
        height, width = coefficients.shape[:2]
        four = np.zeros((height, width, 4), np.float32)
        four[..., :3] = coefficients
        return Spline((height, width), self._work.buffer(four))

    def sample_spline(
        self, spline: Spline, motion: Motion, first: int, stop: int
    ) -> NDArray[np.float32]:
        """Sample a picture; see `clmorph.backends.interface.Operations`."""
        if self._kernel is None:
            self._kernel = self._programs.kernels(Variant("spline.cl"))["sample_spline"]
        make = cl.cltypes
        width = motion.shape[1]
        found = np.empty((stop - first, width, 3), np.float32)
        displacements = self._work.buffer(motion.displacements)
        row = first
        while row < stop:
            rows = min(stop - row, max(1, self._budget.pairs() // width))
            out = found[row - first : row - first + rows]
            buffer = self._work.empty(out.nbytes)
            with self._budget.measure(rows * width):
                self._work.launch(
                    self._kernel, (-(-width // GROUP) * GROUP, rows), (GROUP, 1),
                    np.uint32(row), make.make_int2(*motion.shape),
                    make.make_float2(*motion.origin), make.make_float2(*motion.step),
                    make.make_int2(*motion.displacements.shape[:2]), displacements,
                    make.make_int2(*spline.shape), spline.coefficients, buffer,
                    results=((out, buffer),),
                )  # fmt: skip
            row += rows
        return found
