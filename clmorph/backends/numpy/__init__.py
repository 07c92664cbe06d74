"""The operations in NumPy and float64, with which every other backend is compared."""

from clmorph.backends.numpy.operations import NumPyOperations

__all__ = ["NumPyOperations"]
