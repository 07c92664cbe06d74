"""OpenCL: find and choose devices, build the kernels, launch them."""
