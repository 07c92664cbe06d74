"""The few expensive operations: their protocol, its float64 twin in NumPy, and OpenCL."""
