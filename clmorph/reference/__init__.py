"""The paper in plain NumPy float64, with which every other implementation is compared.

`transport` and `pipeline` contain the whole method in the form of a textbook: dense, without
truncation, and without any mathematics of the accelerated path. A reader of the paper can begin
with them; `README.md` in this folder lists the function of each equation. `NumPyOperations` is the
float64 version of the operations that devices compute.
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
