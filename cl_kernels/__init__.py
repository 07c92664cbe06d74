"""OpenCL C sources of clmorph, as package data."""
