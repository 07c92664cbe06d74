"""Several devices as one backend: the first one solves, and all share whole frames and batches."""

import threading
import warnings
from collections.abc import Sequence
from typing import Any, cast
from weakref import WeakValueDictionary

import numpy as np

from clmorph._shared.validation import shown
from clmorph.backends.interface import Operations
from clmorph.errors import ClmorphWarning, InputError


class MultiDevice:
    """The first of several devices, with all its attributes, and others to share work with."""

    def __init__(self, members: Sequence[Operations]) -> None:
        self.members = list(members)
        self.primary = self.members[0]
        self.description = " + ".join(member.description for member in members)
        # Those in the host's memory have equal parts of it.
        on_host = sum(member.shares_host_memory for member in members)
        limits = [
            member.memory_bytes // (on_host if member.shares_host_memory else 1)
            for member in members
            if member.memory_bytes is not None
        ]
        self.memory_bytes = min(limits, default=None)
        self.shares_host_memory = on_host > 0

    def __getattr__(self, name: str) -> Any:
        if name in ("primary", "members"):  # not set yet, as in a copy
            raise AttributeError(name)
        return getattr(self.primary, name)

    def __repr__(self) -> str:
        return f"<MultiDevice: {self.description}>"


#: Backends in use, by the identities of their members, which they keep alive.
_opened: "WeakValueDictionary[tuple[int, ...], MultiDevice]" = WeakValueDictionary()
_lock = threading.Lock()


def open_several(members: Sequence[Operations], names: Sequence[Any]) -> Operations:
    """Return one backend of several devices, the same for the same; errors have `names`."""
    if not members:
        raise InputError("backend=[]: expected at least one device, such as ['0:0', '0:1']")
    for number, (member, name) in enumerate(zip(members, names, strict=True)):
        if isinstance(member, MultiDevice):
            raise InputError(
                f"backend: {shown(name)} stands for several devices: expected one device for each "
                "entry of a list"
            )
        for other, earlier in zip(members[:number], names, strict=False):
            if _same_device(member, other):
                raise InputError(
                    f"backend: {shown(earlier)} and {shown(name)} are the same device "
                    f"({member.description}): name each device once"
                )
    if len(members) == 1:
        return members[0]
    key = tuple(map(id, members))
    with _lock:
        found = _opened.get(key)
        if found is None:
            found = _opened[key] = MultiDevice(members)
        return cast(Operations, found)


def _same_device(one: Operations, other: Operations) -> bool:
    """Return whether two backends are one, or work on one OpenCL device."""
    device = getattr(one, "device", None)  # not in the protocol: NumPy has none
    return one is other or (device is not None and device == getattr(other, "device", None))


def members_of(operations: Operations) -> list[Operations]:
    """Return the devices of a backend; a device is its own member."""
    return operations.members if isinstance(operations, MultiDevice) else [operations]


def for_one_solve(operations: Operations) -> Operations:
    """Return the device of a single solve, with a warning if there are several."""
    members = members_of(operations)
    if len(members) > 1:
        warnings.warn(
            f"a single solve uses one device, {members[0].description}: several devices share "
            "whole frames, batches and films",
            ClmorphWarning,
            stacklevel=3,
        )
    return members[0]


def sharing_notes(operations: Operations) -> list[str]:
    """Return notes for a user of several devices on what they do, and whether it can help."""
    members = members_of(operations)
    if len(members) == 1:
        return []
    notes = [f"{members[0].description} computes the transport; all devices share the frames"]
    named = [member.description for member in members if member.on_processor]
    if len(named) > 1:
        notes.append(
            f"{' and '.join(named)} work on one processor, so that together they cannot be faster "
            "than one of them"
        )
    return notes


def turns(operations: Operations, count: int) -> list[int]:
    """Return the device of each piece of work, (count,), in proportion to recorded speeds."""
    speeds = np.array([member.pairs_per_second for member in members_of(operations)])
    known = speeds[speeds > 0]
    speeds[speeds <= 0] = known.min() if len(known) else 1.0
    chosen, owed = [], np.zeros(len(speeds))
    for _ in range(count):
        owed += speeds / speeds.sum()
        chosen.append(int(np.argmax(owed)))
        owed[chosen[-1]] -= 1.0
    return chosen
