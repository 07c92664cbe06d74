"""The few expensive operations: their protocol, a float64 version in NumPy, and one in OpenCL."""
