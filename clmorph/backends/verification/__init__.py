"""Checks of single operations against NumPy, shared by the probe, the programs and the command."""
