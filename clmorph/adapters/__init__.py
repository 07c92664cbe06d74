"""Interfaces of other libraries.

``clmorph.torch``, ``clmorph.jax``, ``clmorph.pot`` and ``clmorph.geomloss`` are imported
under these names. None of them imports its library before it is called, and ``clmorph.pot`` needs
no POT at all.
"""

from importlib import import_module
from typing import Any

#: The modules, by the last part of their names.
LIBRARIES = ("geomloss", "jax", "pot", "torch")


def __getattr__(name: str) -> Any:
    if name in LIBRARIES:
        # One module object, whether it is imported or an attribute of the package.
        return import_module(f"clmorph.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
