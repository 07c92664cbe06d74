"""The host side of the kernels: one module for each file of ``cl_kernels``."""
