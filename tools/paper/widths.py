"""Kernel widths, and the divergences of their frames on the path (4.3)."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import clmorph
from clmorph.analysis.metrics import REFERENCES, path_divergence
from clmorph.frames.kernel_width import KernelWidth
from clmorph.pipeline.optimal_width import optimal_curve
from paper import drawing
from paper.setting import (
    AS_PAPER,
    COUNTED_SHARE,
    FIXED_SIGMA,
    GAMMA,
    SIGMA_END,
    TOL,
    Setting,
)

#: The columns of Table 2.
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
STAGE = "Table 2"
#: How many times Figures 7 and 8 have.
FINE = 13
#: Points to which particles are merged before frames are compared with them.
POINTS, QUICK_POINTS = 8192, 2048
#: How each reference is named.
NAMES = {"target": "to the target", "particles": "to the particles μ(t)"}
#: Name, color and line of each rule.
STYLES = {
    "fixed": (f"fixed σ {FIXED_SIGMA:g}", drawing.RED, "s--"),
    "adaptive": ("adaptive as in Table 2", drawing.BLUE, "o-"),
    "adaptive-text": ("adaptive as in Section 4", drawing.SKY, "D-"),
    "none": ("none (nearest pixel)", drawing.ORANGE, "x:"),
    "local": ("local", drawing.GREEN, "^-"),
    "optimal": ("optimal σ(t)", drawing.PURPLE, "v-"),
}


@dataclass(frozen=True)
class Curves:
    """All that Table 2 and Figures 7 and 8 show.

    Attributes
    ----------
    morphs : dict
        By rule.
    times : sequence of float
    divergences : dict
        By (reference, rule), one for each time.
    """

    morphs: dict[str, clmorph.Morph]
    times: tuple[float, ...]
    divergences: dict[tuple[str, str], list[clmorph.Divergence]]


@cache
def curves(setting: Setting) -> Curves:
    """Make one transport, look at it through every rule, and measure every frame."""
    images = setting.pair.as_published(setting.size)
    start = clmorph.morph(
        *images, n_frames=len(TIMES), backend=setting.operations, **{**AS_PAPER, "tol": TOL}
    )
    morphs = {name: replace(start, kernel_width=width) for name, width in _widths(start).items()}
    best = optimal_curve(start, progress=lambda share: setting.report("Optimal σ", share))
    width = replace(start.kernel_width, curve=best)
    morphs["optimal"] = replace(start, kernel_width=width)
    times = TIMES if setting.quick else tuple(np.linspace(0, 1, FINE))
    times = tuple(sorted({*TIMES, *(float(t) for t in times)}))
    keys = [(reference, rule) for reference in REFERENCES for rule in morphs]
    points = QUICK_POINTS if setting.quick else POINTS
    divergences = {
        (reference, rule): path_divergence(
            morphs[rule], times, reference, tol=1e-4, max_points=points
        )
        for reference, rule in setting.each(STAGE, keys)
    }
    return Curves(morphs, times, divergences)


def _widths(start: clmorph.Morph) -> dict[str, KernelWidth]:
    text = start.kernel_width  # Eq. 3's floor, by Kish's effective number
    counted = COUNTED_SHARE * len(start.plan)
    ends = FIXED_SIGMA, SIGMA_END
    return {
        "fixed": KernelWidth(*ends, 0.0, text.n_start, text.n_end, "fixed"),
        "adaptive": KernelWidth(*ends, GAMMA, counted, counted),
        "adaptive-text": text,
        "none": KernelWidth(*ends, 0.0, text.n_start, text.n_end, "none"),
        "local": KernelWidth(*ends, 0.0, text.n_start, text.n_end, "local"),
    }


def sigmas(found: Curves, rule: str) -> list[float]:
    """Return the widths of a rule at all times, in pixels."""
    one = found.morphs[rule]
    return [one.kernel_width.at(t, one.canvas(t)) for t in found.times]


def floor_at(found: Curves, t: float) -> float:
    """Return Eq. 3's floor, in pixels."""
    one = found.morphs["adaptive-text"]
    return one.kernel_width.floor(t, one.canvas(t))
