"""Kernel widths whose frames are nearest to the particles, by the Sinkhorn divergence (paper, 4.3).

Torn pixels are closed. The divergence prefers grain to blur: an average is a color of no particle.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clmorph.backends.multi_device import members_of
from clmorph.frames.as_measure import frame_measure, particle_measure
from clmorph.frames.render import Widths
from clmorph.pipeline.result import Morph
from clmorph.transport.divergence import sinkhorn_divergence

#: Times at which widths are optimized; widths at other times are interpolated. At the ends, where
#: particles stand on pixels, the narrowest width is the best, so the next times are near the ends.
KNOTS = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
#: Candidate widths in pixels. The objective can have several minima, so all candidates are tried.
#: The search then continues `REFINEMENTS` times between the neighbors of the best one.
WIDTHS = 0.1 * 2.0 ** (0.5 * np.arange(12))
REFINEMENTS = 3
#: Number of points to which the particles of frames are merged for this search.
POINTS = 4096


def optimal_curve(
    morph: Morph, report: Callable[[float], None]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the kernel widths, times and pixels, whose frames are nearest to the particles."""
    widths = []
    for number, t in enumerate(KNOTS):
        widths.append(_least(_objective(morph, float(t))))
        report((number + 1) / len(KNOTS))
    return KNOTS, np.array(widths)


def _objective(morph: Morph, t: float) -> Callable[[float], float]:
    """Return the divergence of the frame at t to its particles, as a function of the width."""
    particles, _ = particle_measure(morph, t, max_points=POINTS)
    blur, reach = morph.potentials.blur, morph.potentials.reach
    assert not isinstance(reach, tuple)  # the options have been checked
    local, device = morph.kernel_width.splatting == "local", members_of(morph.operations)[0]

    def divergence(width: float) -> float:
        sums = morph.sums(t, widths=Widths(width, local, closed=True))
        frame = frame_measure(morph, t, sums=sums)
        return float(sinkhorn_divergence(frame, particles, blur, reach, backend=device))

    return divergence


def _least(objective: Callable[[float], float]) -> float:
    """Return the width with the least objective."""
    tried = [(objective(width), float(width)) for width in WIDTHS]
    step = float(np.sqrt(WIDTHS[1] / WIDTHS[0]))
    for _ in range(REFINEMENTS):
        best = min(tried)[1]
        tried += [(objective(width), width) for width in (best / step, best * step)]
        step = float(np.sqrt(step))
    return min(tried)[1]
