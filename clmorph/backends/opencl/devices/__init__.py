"""OpenCL devices: find them, test them, and remember which of them work."""
