"""Count the commands by which a process moves memory of OpenCL devices, its launches and its waits.

A test or an example counts with it which arrays are copied between host and device:

    with TransferCount() as count:
        ...
    print(count.of([array]), count.of_others([array]), count.n_launches, count.n_waits)

It sees what goes through pyopencl in this process. On PoCL, ``POCL_TRACING=text`` shows the same
commands as the driver receives them.
"""

import functools
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple
from unittest import mock

import pyopencl as cl
import pyopencl.array as cl_array

#: Functions of pyopencl by what they do to memory. Mapping and unmapping are no copies where the
#: device's memory is the host's.
KINDS = {
    "read": ("_enqueue_read_buffer", "_enqueue_read_buffer_rect", "_enqueue_read_image"),
    "write": ("_enqueue_write_buffer", "_enqueue_write_buffer_rect", "_enqueue_write_image"),
    "copy": (
        "_enqueue_copy_buffer", "_enqueue_copy_buffer_rect", "_enqueue_copy_image",
        "_enqueue_copy_buffer_to_image", "_enqueue_copy_image_to_buffer", "_enqueue_svm_memcpy",
        "enqueue_copy_buffer_p2p_amd",
    ),
    "fill": ("_enqueue_fill_buffer", "enqueue_fill_image", "_enqueue_svm_memfill"),
    "migrate": ("enqueue_migrate_mem_objects", "_enqueue_svm_migrate_mem"),
    "map": ("enqueue_map_buffer", "enqueue_map_image", "_enqueue_svm_map"),
}  # fmt: skip
#: Functions of pyopencl that wait, beside the commands that block.
WAITS = ((cl, "wait_for_events"), (cl.Event, "wait"), (cl.CommandQueue, "finish"))
#: The kinds of commands that block unless they are told otherwise.
BLOCKING = ("read", "write", "map")
#: The kinds that copy.
COPIES = ("read", "write", "copy", "fill", "migrate")


class Command(NamedTuple):
    """One command, and the memory that it has touched, which is kept: its address stays its own."""

    kind: str
    memory: tuple[Any, ...]
    n_bytes: int


class TransferCount:
    """Records the commands that move memory while it is entered."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        #: Launches of kernels, and the times that the host has waited for the device.
        self.n_launches = self.n_waits = 0
        #: Seconds of this thread's processor in waits; some drivers compute in them.
        self.seconds_in_waits = 0.0
        self._patches: list[Any] = []

    def __enter__(self) -> "TransferCount":
        for kind, names in KINDS.items():
            for name in names:
                for module in (cl, cl._cl):
                    if hasattr(module, name):
                        recording = self._recording(kind, getattr(module, name))
                        self._patches.append(mock.patch.object(module, name, recording))
        self._patches.append(mock.patch.object(cl, "Buffer", self._buffer_class()))
        for owner, name in WAITS:
            waiting = self._waiting(getattr(owner, name))
            self._patches.append(mock.patch.object(owner, name, waiting))
        launching = self._launching(cl.enqueue_nd_range_kernel)
        self._patches.append(mock.patch.object(cl, "enqueue_nd_range_kernel", launching))
        for patch in self._patches:
            patch.start()
        return self

    def __exit__(self, *error: object) -> None:
        while self._patches:
            self._patches.pop().stop()

    def _recording(self, kind: str, function: Any) -> Any:
        @functools.wraps(function)
        def record(*arguments: Any, **options: Any) -> Any:
            values = (*arguments, *options.values())
            memory = tuple(each for each in values if isinstance(each, cl.MemoryObjectHolder))
            n_bytes = sum(getattr(each, "nbytes", 0) for each in values)
            self.n_waits += bool(options.get("is_blocking", True)) and kind in BLOCKING
            self.commands.append(Command(kind, memory, n_bytes))
            return function(*arguments, **options)

        return record

    def _launching(self, function: Any) -> Any:
        @functools.wraps(function)
        def launch(*arguments: Any, **options: Any) -> Any:
            self.n_launches += 1
            return function(*arguments, **options)

        return launch

    def _waiting(self, function: Any) -> Any:
        @functools.wraps(function)
        def wait(*arguments: Any) -> Any:
            self.n_waits += 1
            began = time.thread_time()
            try:
                return function(*arguments)
            finally:
                self.seconds_in_waits += time.thread_time() - began

        return wait

    def _buffer_class(self) -> type:
        """Return a class of buffers that records those which are filled from the host's memory."""
        commands = self.commands

        class Buffer(cl.Buffer):
            def __init__(
                self, context: Any, flags: Any, size: int = 0, hostbuf: Any = None
            ) -> None:
                super().__init__(context, flags, size, hostbuf)
                if hostbuf is not None and flags & cl.mem_flags.COPY_HOST_PTR:
                    commands.append(Command("write", (self,), hostbuf.nbytes))

        return Buffer

    def of(self, arrays: Iterable[cl_array.Array]) -> Counter[str]:
        """Return the numbers of commands by kind that touched the memory of some arrays."""
        own = {each.base_data.int_ptr for each in arrays}
        return Counter(each.kind for each in self.commands if _addresses(each) & own)

    def of_others(self, arrays: Iterable[cl_array.Array]) -> Counter[str]:
        """Return the numbers of commands by kind that touched no memory of these arrays."""
        own = {each.base_data.int_ptr for each in arrays}
        return Counter(each.kind for each in self.commands if not _addresses(each) & own)

    def n_bytes(self, kind: str) -> int:
        """Return how many bytes all commands of a kind have moved, if it is "read" or "write"."""
        return sum(each.n_bytes for each in self.commands if each.kind == kind)


def _addresses(command: Command) -> set[int]:
    """Return the addresses of the memory of a command, and of what it is a part of."""
    parents = [getattr(each, "associated_memobject", None) for each in command.memory]
    return {each.int_ptr for each in (*command.memory, *parents) if each is not None}
