"""Many pairs on the workers of Dask's distributed scheduler (extra ``dask``).

Dask is imported when a function is called, not with this module.
"""

from clmorph.batch.barycenters import barycenters
from clmorph.batch.matrix import divergence_matrix
from clmorph.batch.run import morph

__all__ = ["barycenters", "divergence_matrix", "morph"]
