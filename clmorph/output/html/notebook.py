"""A morph in a notebook: its page in an iframe, small enough to be saved with the notebook."""

import math
from html import escape

import numpy as np

from clmorph.frames.sequence import FrameSequence
from clmorph.output.html.page import page
from clmorph.output.html.summary import scene_of

#: The limit of the size of all frames in a notebook's output, in bytes of text.
NOTEBOOK_BYTES = 8e6
#: The total number of pixels of all frames above which only some frames are shown.
NOTEBOOK_PIXELS = 4e6
#: Height of the frame, in CSS pixels.
HEIGHT = 640


def repr_html(
    morph: FrameSequence, *, max_pixels: float = NOTEBOOK_PIXELS, max_bytes: float = NOTEBOOK_BYTES
) -> str:
    """Return an iframe with a morph's page and no other access, of some of its frames if many."""
    count = len(morph.times)
    pixels = max(math.prod(morph.canvas(t).shape) for t in (0.0, 1.0))
    shown = min(count, max(2, int(max_pixels // pixels)))
    chosen = np.unique(np.round(np.linspace(0, count - 1, shown)).astype(int))
    notes = []
    if len(chosen) < count:
        notes.append(
            f"{len(chosen)} of {count} frames are shown, to keep the notebook small; "
            "save the morph to a file for all of them."
        )
    scene = scene_of(morph, morph.times[chosen], fps=20.0 * len(chosen) / count, notes=notes)
    text = escape(page(scene, max_bytes=max_bytes))
    return (
        f'<iframe srcdoc="{text}" title="{escape(scene.title)}" loading="lazy" '
        f'sandbox="allow-scripts allow-downloads" '
        f'style="width:100%;height:{HEIGHT}px;border:0;border-radius:12px"></iframe>'
    )
