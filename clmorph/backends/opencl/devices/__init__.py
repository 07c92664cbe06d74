"""OpenCL devices: find them, try them, remember which of them work."""
