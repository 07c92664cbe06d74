"""The paper in plain NumPy float64: what every other implementation is compared with.

`operations` has the twins of the device's operations; `transport` and `pipeline` the whole
method in the textbook way, dense, without truncation and without anything borrowed from the
accelerated path. A reader of the paper may well begin with them.
"""

from clmorph.backends.numpy import NumPyOperations
from clmorph.reference.pipeline import ReferenceMorph, morph, render
from clmorph.reference.transport import cost_matrix, sinkhorn, transport_plan

__all__ = [
    "NumPyOperations",
    "ReferenceMorph",
    "cost_matrix",
    "morph",
    "render",
    "sinkhorn",
    "transport_plan",
]
