"""Keep every launch short: a desktop GPU's watchdog kills long ones, and progress and
Ctrl-C live between them.
"""  # noqa: D205

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from pyopencl.tools import ImmediateAllocator, MemoryPool

#: The duration that launches aim at, in seconds; well under the limit of 0.2 s.
TARGET_SECONDS = 0.08
#: The most particles that one launch moves or sorts, or that a block of pixels visits in it.
LAUNCH_PARTICLES = 1 << 20
#: The most bytes of released buffers that are kept for later ones.
HELD_BYTES = 1 << 28


class LaunchBudget:
    """The amount of work of one launch, learned from the launches before it.

    Parameters
    ----------
    first : int
        Work of the first launch, in point pairs; small, as the device is unknown.
    """

    def __init__(self, first: int = 1 << 22) -> None:
        self._pairs = first
        self.longest = 0.0  #: seconds, over all launches measured

    def pairs(self) -> int:
        """Return the number of point pairs for the next launch."""
        return self._pairs

    def parts(self, work: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Split items in a row, given the work of each, into launches: (first, stop)."""
        total = np.cumsum(work)
        first = 0
        while first < len(total):
            before = total[first - 1] if first else 0
            stop = int(np.searchsorted(total, before + self.pairs(), side="right"))
            stop = max(first + 1, stop)
            yield first, stop
            first = stop

    @contextlib.contextmanager
    def measure(self, pairs: int) -> Iterator[None]:
        """Time a launch over this many pairs and adapt the next one's size."""
        began = time.perf_counter()
        yield
        elapsed = time.perf_counter() - began
        self.longest = max(self.longest, elapsed)
        affordable = pairs * TARGET_SECONDS / max(elapsed, 1e-6)
        # Slow steps up: a short launch is mostly overhead and says little about a long one.
        self._pairs = max(1, int(min(affordable, 4 * self._pairs)))


class Workspace:
    """Where the kernels of one device run: its context, its queue, and their buffers.

    Parameters
    ----------
    context : pyopencl.Context
    queue : pyopencl.CommandQueue
    """

    def __init__(self, context: cl.Context, queue: cl.CommandQueue) -> None:
        self.context, self.queue = context, queue
        self._pool = MemoryPool(ImmediateAllocator(queue, cl.mem_flags.READ_WRITE))

    def buffer(self, values: NDArray[Any], dtype: Any = np.float32) -> cl.Buffer:
        """Return a buffer that holds these values."""
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(values, dtype))

    def empty(self, n_bytes: int) -> cl.MemoryObject:
        """Return a buffer that holds anything, to be written first.

        When it is garbage, the next one of its size gets its place: the first touch of fresh
        memory costs a CPU more than what most kernels do there.
        """
        if self._pool.managed_bytes - self._pool.active_bytes > HELD_BYTES:
            self._pool.free_held()
        return self._pool.allocate(max(4, n_bytes))

    def launch(
        self,
        kernel: cl.Kernel,
        size: tuple[int, ...],
        group: tuple[int, ...] | None,
        *arguments: Any,
    ) -> None:
        """Run a kernel and wait for it.

        Arguments are NumPy scalars and buffers; holding them here keeps buffers alive until
        the launch has ended, which a kernel does not. They are set one by one: pyopencl's
        `set_args` generates code for each kernel, which costs more at start than it saves.
        """
        for number, argument in enumerate(arguments):
            kernel.set_arg(number, argument)
        cl.enqueue_nd_range_kernel(self.queue, kernel, size, group).wait()
