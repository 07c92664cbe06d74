"""Colors after a table in three dimensions: ``cl_kernels/color_table.cl``."""

from typing import NamedTuple

import numpy as np
import pyopencl as cl

from clmorph.backends.opencl.build.programs import Programs
from clmorph.backends.opencl.kernels.launches import LaunchBudget, Workspace
from clmorph.backends.records import Float32

#: Work-items of a group, where a device takes so many, and colors of the first launch.
GROUP, FIRST_COLORS = 16, 1 << 18


class Table(NamedTuple):
    """A table on the device, and the number of its nodes along each axis."""

    nodes: int
    values: cl.Buffer


class ColorTable:
    """Applies tables of colors."""

    def __init__(self, work: Workspace, programs: Programs) -> None:
        self._work, self._programs = work, programs
        self._group = min(GROUP, work.device.max_work_group_size)
        self._budget = LaunchBudget(FIRST_COLORS)

    def upload_table(self, table: Float32) -> Table:
        """Upload a table; see `clmorph.backends.interface.Operations`."""
        padded = np.zeros((*table.shape[:3], 4), np.float32)
        padded[..., :3] = table
        return Table(len(table), self._work.buffer(padded))

    def apply_table(self, table: Table, colors: Float32) -> Float32:
        """Return colors after a table; see `clmorph.backends.interface.Operations`."""
        kernel, group = self._programs.kernel("color_table.cl", "apply_table"), self._group
        found = np.empty(colors.shape, np.float32)
        given, buffer = self._work.buffer(colors), self._work.empty(found.nbytes)
        for first, count, last in self._budget.rows(len(colors), 1):
            self._work.launch(
                kernel, (-(-count // group) * group,), (group,), np.uint32(first),
                np.uint32(first + count), np.int32(table.nodes), table.values, given, buffer,
                results=((found, buffer),) if last else (),
            )  # fmt: skip
        return found
