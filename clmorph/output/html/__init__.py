"""One page that plays a morph without a network, as a file or in a notebook."""

from clmorph.output.html.notebook import repr_html
from clmorph.output.html.page import PAGE_BYTES, page, read_parameters, write_page
from clmorph.output.html.scene import Curve, Field, Marks, Scene
from clmorph.output.html.summary import scene_of

__all__ = [
    "PAGE_BYTES",
    "Curve",
    "Field",
    "Marks",
    "Scene",
    "page",
    "read_parameters",
    "repr_html",
    "scene_of",
    "write_page",
]
