"""The operations in NumPy and float64: every other backend is compared with these."""

from clmorph.backends.numpy.operations import NumPyOperations

__all__ = ["NumPyOperations"]
