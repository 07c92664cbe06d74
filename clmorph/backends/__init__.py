"""The few expensive operations: one protocol, its float64 twin in NumPy, and OpenCL."""
