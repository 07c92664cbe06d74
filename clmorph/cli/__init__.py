"""The command ``clmorph``."""
