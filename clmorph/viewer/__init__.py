"""One page that plays a morph: a file that needs no network, also in notebooks."""

from clmorph.viewer.notebook import repr_html
from clmorph.viewer.page import PAGE_BYTES, page, read_parameters, write_page
from clmorph.viewer.scene import Curve, Field, Scene
from clmorph.viewer.summary import scene_of

__all__ = [
    "PAGE_BYTES",
    "Curve",
    "Field",
    "Scene",
    "page",
    "read_parameters",
    "repr_html",
    "scene_of",
    "write_page",
]
