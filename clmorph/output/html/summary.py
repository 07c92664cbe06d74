"""Build the content of a page, or of an iframe in a notebook, from a morph."""

import math
from html import escape
from typing import Any

import numpy as np

from clmorph._shared.items import MadeItems
from clmorph._shared.typing import Array
from clmorph.frames.options import BULGING
from clmorph.frames.sequence import FrameSequence
from clmorph.images.pixels import to_bytes
from clmorph.output.html.page import page
from clmorph.output.html.scene import Curve, Field, Marks, Scene
from clmorph.transport.plan import Plan

#: Number of arrows along the longer side of the source.
ARROWS = 24
#: The least mass of a place that gets an arrow, as a share of the largest mass of a place.
FAINTEST = 1e-3
#: The limit of the size of all frames in a notebook's output, in bytes of text.
NOTEBOOK_BYTES = 8e6
#: The total number of pixels of all frames above which only some frames are shown.
NOTEBOOK_PIXELS = 4e6
#: Height of the frame, in CSS pixels.
HEIGHT = 640


def scene_of(morph: FrameSequence, times: Array | None = None, **more: Any) -> Scene:
    """Return the content of a page about a morph at `times`; `more` are other fields of `Scene`."""
    chosen = morph.times if times is None else times
    field = arrow_field(morph)
    known: dict[str, Any] = {
        "frames": MadeItems(lambda index: to_bytes(morph.frame(float(chosen[index]))), len(chosen)),
        "times": chosen, "title": morph.title, "pixelated": morph.pixelated,
        "curves": morph_curves(morph, chosen), "fields": () if field is None else (field,),
        "parameters": known_parameters(morph), "extent": morph.source.extent,
        "marks": marks_of(morph),
    }  # fmt: skip
    return Scene(**known | more)


def marks_of(morph: FrameSequence, *, backwards: bool = False) -> Marks:
    """Return the landmarks of a morph, in pixels of its pictures as they were given."""
    landmarks = getattr(morph.options, "landmarks", None) or ()
    return Marks(np.array(landmarks, float), morph.given_shapes, backwards)


def morph_curves(morph: FrameSequence, times: Array) -> tuple[Curve, ...]:
    """Return curves of the mass that travels, dies and is born (%), and of the kernel width."""
    moving = morph.particles
    begun = [
        float(mass[other == 0].sum()) for mass, other in (moving.weights.T, moving.weights.T[::-1])
    ]
    whole = moving.weights.sum(axis=0)
    dying, born = (1 - times) * begun[0], times * begun[1]
    total = (1 - times) * whole[0] + times * whole[1]
    traveling = np.maximum(total - dying - born, 0.0)
    curves = []
    if morph.detail == "particles":
        widths = np.array([morph.kernel_width.at(t, morph.canvas(t)) for t in times])
        curves.append(Curve("kernel width", "pixels", widths))
    for name, mass in (("traveling", traveling), ("dying", dying), ("born", born)):
        share = np.divide(100 * mass, total, out=np.zeros_like(mass), where=total > 0)
        curves.append(Curve(f"mass {name}", "% of mass", share))
    return tuple(curves)


def arrow_field(morph: FrameSequence, most: int = ARROWS) -> Field | None:
    """Return the mean moves of at most `most` places a side of the source; None if none moves."""
    source, plan = morph.source, morph.plan
    if isinstance(plan, Plan):
        ends, _ = plan.mean_destinations(source.positions, morph.target.positions)
    else:
        ends = plan.positions
    height, width = source.shape
    side = -(-max(source.shape) // most)
    columns = -(-width // side)
    rows, column = np.divmod(np.arange(height * width), width)
    place = rows // side * columns + column // side
    mass = plan.marginals[0]
    total = np.bincount(place, mass)
    kept = total > FAINTEST * total.max(initial=0.0)
    if not kept.any():
        return None

    def mean(points: Array) -> Array:
        sums = [np.bincount(place, mass * axis, len(total)) for axis in points.T]
        return np.column_stack(sums)[kept] / total[kept, None]

    starts = mean(source.positions)
    return Field(starts, mean(ends) - starts, total[kept] / total.max())


def known_parameters(morph: FrameSequence) -> dict[str, Any]:
    """Return the parameters that a morph was made with, as values that JSON can represent."""
    from clmorph._shared.version import __version__

    width, potentials, source = morph.kernel_width, morph.potentials, morph.source
    reach = potentials.reach
    reaches = [
        "balanced" if side is None else _short(side)
        for side in (reach if isinstance(reach, tuple) else (reach,))
    ]
    known = {
        "source_size": list(morph.canvas(0.0).shape[::-1]),
        "target_size": list(morph.canvas(1.0).shape[::-1]),
        "blur": _short(potentials.blur),
        "reach": reaches if len(reaches) > 1 else reaches[0],
        "color_weight": _short(source.color_weight),
        "color_space": source.color_space,
        "path_space": morph.particles.path_space,
        "extent": source.extent,
        "detail": morph.detail,
        "endpoints": morph.endpoints,
        "unmatched": morph.unmatched,
        "particles": len(morph.particles),
        "iterations": int(potentials.n_iter),
        "residual": _short(potentials.residual),
        "transported_mass": _short(potentials.transported_mass),
        "clmorph": __version__,
    }
    if morph.detail == "particles":
        known["splatting"] = width.splatting
        known["sigma_start"] = _short(width.sigma_start)
        known["sigma_end"] = _short(width.sigma_end)
    if width.splatting in BULGING:
        known["gamma"] = _short(width.gamma)
    if width.curve is not None:
        known["sigma"] = "optimal"
    return known


def _short(value: float) -> float | None:
    """Round to six significant digits; return None for NaN and infinity, which JSON lacks."""
    return float(f"{value:.6g}") if np.isfinite(value) else None


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
