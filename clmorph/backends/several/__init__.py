"""One backend out of several: rows of reductions, and frames, are spread over devices."""

from clmorph.backends.several.opening import members_of, open_several, sharing_note
from clmorph.backends.several.operations import SeveralDevices
from clmorph.backends.several.shares import frame_turns
from clmorph.backends.several.threads import results_in_order

__all__ = [
    "SeveralDevices",
    "frame_turns",
    "members_of",
    "open_several",
    "results_in_order",
    "sharing_note",
]
