"""Nodes for ComfyUI, which loads the names below from a folder in its ``custom_nodes``.

``clmorph comfyui PATH_TO_COMFYUI`` writes that folder: one file with one line, which imports these
names from the installed package. Nothing of ComfyUI or PyTorch is imported before a node runs.
"""

from clmorph.adapters.comfyui.nodes import NODE_CLASS_MAPPINGS as NODE_CLASS_MAPPINGS
from clmorph.adapters.comfyui.nodes import NODE_DISPLAY_NAME_MAPPINGS as NODE_DISPLAY_NAME_MAPPINGS

__all__ = ["NODE_CLASS_MAPPINGS", "NODE_DISPLAY_NAME_MAPPINGS"]
