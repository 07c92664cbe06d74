"""Make one backend out of several, and tell its members."""

import threading
from collections.abc import Sequence
from typing import Any
from weakref import WeakValueDictionary

from clmorph._shared.validation import shown
from clmorph.backends.interface import Operations
from clmorph.backends.several.operations import SeveralDevices
from clmorph.backends.several.shares import recorded_shares
from clmorph.errors import InputError

#: Backends in use, by the identities of their members, which they keep alive.
_opened: "WeakValueDictionary[tuple[int, ...], SeveralDevices]" = WeakValueDictionary()
_lock = threading.Lock()


def open_several(members: Sequence[Operations], names: Sequence[Any]) -> Operations:
    """Return one backend that spreads work over others, the same object for the same members.

    A single member is returned itself. In errors members have the `names` that a user gave.
    """
    if not members:
        raise InputError("backend=[]: expected at least one device, such as ['0:0', '0:1']")
    for number, (member, name) in enumerate(zip(members, names, strict=True)):
        if isinstance(member, SeveralDevices):
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
            found = _opened[key] = SeveralDevices(members, recorded_shares(members))
        return found


def _same_device(one: Operations, other: Operations) -> bool:
    """Return whether two backends are one, or work on one OpenCL device."""
    device = getattr(one, "device", None)  # not in the protocol: NumPy has none
    return one is other or (device is not None and device == getattr(other, "device", None))


def members_of(operations: Operations) -> list[tuple[Operations, float]]:
    """Return the devices of a backend and their shares of the work; a device is its own member."""
    if isinstance(operations, SeveralDevices):
        return list(zip(operations.members, operations.shares, strict=True))
    return [(operations, 1.0)]


def sharing_note(operations: Operations) -> str | None:
    """Return a note for a user whose devices are one processor; None if they are not."""
    named = [member.description for member, _ in members_of(operations) if member.on_processor]
    if len(named) < 2:
        return None
    return (
        f"{' and '.join(named)} work on one processor, so that together they cannot be faster than "
        "one of them"
    )
