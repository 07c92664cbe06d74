"""Morph one image into another by unbalanced optimal transport, on any OpenCL device."""

from pathlib import Path

import lazy_loader

# The public names stand in __init__.pyi, for type checkers too. Each is imported when it is first
# asked for, so that the command answers at once.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Modules that were documented and have moved: their old names still work, with a warning.
__path__.append(str(Path(__file__).parent / "_moved"))

# Interfaces of other libraries: `import clmorph.torch`, and so on.
__path__.append(str(Path(__file__).parent / "adapters"))
