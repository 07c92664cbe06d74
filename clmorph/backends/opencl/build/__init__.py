"""Kernel programs: load, expand and build the sources; build constants and their tuning."""
