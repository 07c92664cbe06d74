"""The paper in plain NumPy float64: what every other implementation is compared with.

`operations` has the twins of the device's operations; `pipeline` the whole method in the
textbook way, dense, without truncation and without anything borrowed from the accelerated
path. A reader of the paper may well begin with `pipeline`.
"""

from clmorph.reference.operations import NumPyOperations
from clmorph.reference.pipeline import (
    ReferenceMorph,
    morph,
    render,
    sinkhorn,
    transport_plan,
)

__all__ = [
    "NumPyOperations",
    "ReferenceMorph",
    "morph",
    "render",
    "sinkhorn",
    "transport_plan",
]
