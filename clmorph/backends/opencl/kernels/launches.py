"""Keep every launch short: watchdogs kill long ones, and Ctrl-C comes between them."""

import contextlib
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from pyopencl.tools import ImmediateAllocator, MemoryPool

from clmorph.backends.cancellation import check_cancelled

#: The duration that launches aim at, in seconds; well under the limit of 0.2 s.
TARGET_SECONDS = 0.08
#: The largest number of particles that one launch moves or sorts, or that a block of pixels visits
#: in a launch.
LAUNCH_PARTICLES = 1 << 20
#: The largest number of bytes of released buffers that are kept for reuse.
HELD_BYTES = 1 << 28
#: From this number of bytes on, uploads reuse memory: below, a command takes longer than it saves.
POOLED_BYTES = 1 << 18

#: Arrays, and the buffers that they are read from.
Results = Sequence[tuple[NDArray[Any], cl.MemoryObject]]


class LaunchBudget:
    """The point pairs of one launch, `first` at first, learned from the launches before it."""

    def __init__(self, first: int = 1 << 22) -> None:
        self._pairs = first
        self.longest = 0.0  #: seconds, over all launches measured

    def pairs(self) -> int:
        """Return the number of point pairs for the next launch."""
        return self._pairs

    def parts(self, work: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Split consecutive items into launches by the work of each item: (first, stop)."""
        total = np.cumsum(work)
        first = 0
        while first < len(total):
            before = total[first - 1] if first else 0
            stop = int(np.searchsorted(total, before + self.pairs(), side="right"))
            stop = max(first + 1, stop)
            yield first, stop
            first = stop

    def rows(self, height: int, work: int, slack: int = 1) -> Iterator[tuple[int, int, bool]]:
        """Split rows into timed launches of `slack` times their work at most: first, count, end."""
        row = 0
        while row < height:
            count = min(height - row, max(1, self.pairs() // (slack * work)))
            with self.measure(count * work):
                yield row, count, row + count == height
            row += count

    @contextlib.contextmanager
    def measure(self, pairs: int) -> Iterator[None]:
        """Time a launch over this many pairs and adapt the next one's size."""
        began = time.perf_counter()
        yield
        self.learn(pairs, time.perf_counter() - began)

    def learn(self, pairs: int, elapsed: float) -> None:
        """Adapt the next launch's size to the seconds that a launch over this many pairs took."""
        self.longest = max(self.longest, elapsed)
        affordable = pairs * TARGET_SECONDS / max(elapsed, 1e-6)
        # The size grows slowly: a short launch is mostly overhead and hardly predicts a long one.
        self._pairs = max(1, int(min(affordable, 4 * self._pairs)))


def set_argument(kernel: cl.Kernel, number: int, value: Any, known: dict[int, bytes]) -> None:
    """Set an argument of a kernel; of scalars, whose bytes are `known`, one that has changed."""
    # pyopencl takes 5 microseconds to set a scalar, and a kernel stores the last one.
    scalar = value.tobytes() if isinstance(value, np.generic) else b""
    if scalar and known.get(number) == scalar:
        return
    # Ctrl-C may come between any two of these steps: the kernel must not store another value than
    # the one that is known.
    known.pop(number, None)
    kernel.set_arg(number, value)
    if scalar:
        known[number] = scalar


class Workspace:
    """The context, the queue, perhaps out of order, and the buffers of kernels on one device."""

    def __init__(self, context: cl.Context, queue: cl.CommandQueue) -> None:
        self.context, self.queue, self.device = context, queue, queue.device
        self._is_profiled = bool(queue.properties & cl.command_queue_properties.PROFILING_ENABLE)
        #: Where the queue is profiled: seconds of all kernels, and seconds and name of the longest.
        self.device_seconds, self.longest_launch = 0.0, (0.0, "")
        #: The scalars that each kernel stores, as bytes, by the argument's number.
        self._scalars: dict[cl.Kernel, dict[int, bytes]] = {}
        self._pool = MemoryPool(ImmediateAllocator(queue, cl.mem_flags.READ_WRITE))

    def note(self, kernel: cl.Kernel, event: cl.Event) -> None:
        """Add the device's seconds of a kernel that has ended, if the queue is profiled."""
        if self._is_profiled:
            seconds = 1e-9 * (event.profile.end - event.profile.start)
            self.device_seconds += seconds
            self.longest_launch = max(self.longest_launch, (seconds, kernel.function_name))

    def buffer(self, values: NDArray[Any], dtype: Any = np.float32) -> cl.MemoryObject:
        """Return a buffer that holds these values; large ones reuse memory, see `empty`."""
        content = np.ascontiguousarray(values, dtype)
        if content.nbytes >= POOLED_BYTES:
            buffer = self.empty(content.nbytes)
            cl.enqueue_copy(self.queue, buffer, content)
            return buffer
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=content)

    def empty(self, n_bytes: int) -> cl.MemoryObject:
        """Return an uninitialized buffer, whose memory is used again when it is garbage."""
        # On a CPU the first access to fresh memory takes longer than the work of most kernels.
        if self._pool.managed_bytes - self._pool.active_bytes > HELD_BYTES:
            self._pool.free_held()
        return self._pool.allocate(max(4, n_bytes))

    def launch(
        self,
        kernel: cl.Kernel,
        size: tuple[int, ...],
        group: tuple[int, ...] | None,
        *arguments: Any,
        results: Results = (),
    ) -> None:
        """Run a kernel, read its `results` (arrays, buffers), and wait once for all of this."""
        # Nothing else sets arguments, NumPy scalars and buffers. A kernel holds no buffers:
        # this function does until the launch has ended. pyopencl's `set_args` generates code.
        check_cancelled()
        known = self._scalars.setdefault(kernel, {})
        for number, argument in enumerate(arguments):
            set_argument(kernel, number, argument, known)
        ended = [cl.enqueue_nd_range_kernel(self.queue, kernel, size, group)]
        try:
            for values, buffer in results:
                ended.append(
                    cl.enqueue_copy(
                        self.queue, values, buffer, is_blocking=False, wait_for=ended[:1]
                    )
                )
        finally:
            cl.wait_for_events(ended)
        self.note(kernel, ended[0])
