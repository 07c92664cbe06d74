"""Kernel widths chosen by what the paper argues from: nearness to the particles themselves.

The paper judges a kernel by the Sinkhorn divergence of its frames (4.3) and sets its width by
hand (gamma). Here sigma(t) is the width whose frame, weighted by its kernel mass, has the least
divergence to the particles mu_t that it is a picture of. The divergence prefers grain to blur:
an average of colors is a color that no particle has.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clmorph.divergence import sinkhorn_divergence
from clmorph.errors import InputError
from clmorph.quality import frame_measure, particle_measure

if TYPE_CHECKING:
    from clmorph.result import Morph

#: Times at which widths are sought; in between they are interpolated.
KNOTS = np.linspace(0.0, 1.0, 5)
#: Widths between which they are sought, in pixels, and how exactly, as a factor. Narrower, a
#: particle between two pixels would be on neither.
NARROWEST, WIDEST, EXACTNESS = 0.25, 6.0, 1.08
#: Points to which frames' particles are merged meanwhile.
POINTS = 4096
#: Ratio of the golden section.
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def optimal_curve(
    morph: "Morph", *, progress: Callable[[float], None] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the kernel widths whose frames are nearest to the particles.

    Parameters
    ----------
    morph : Morph
        Of which everything but the widths is taken.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    times, widths : arrays
        For `clmorph.widths.KernelWidth.curve`; in pixels.

    Raises
    ------
    InputError
        If the morph has no divergence: its reach is a pair, or its metric of color a map.
    """
    if morph.source.has_metric_map or isinstance(morph.potentials.reach, tuple):
        raise InputError(
            "sigma='optimal' needs a divergence: one reach for both images, and one color "
            "metric for all pixels"
        )
    widths = []
    for number, t in enumerate(KNOTS):
        widths.append(_golden_section(_objective(morph, float(t))))
        if progress:
            progress((number + 1) / len(KNOTS))
    return KNOTS, np.array(widths)


def _objective(morph: "Morph", t: float) -> Callable[[float], float]:
    """Divergence of the frame at t to its particles, as a function of the width's logarithm."""
    particles, _ = particle_measure(morph, t, max_points=POINTS)
    blur, reach = morph.potentials.blur, morph.potentials.reach

    def divergence(log_width: float) -> float:
        sums = morph.sums(t, sigma=float(np.exp(log_width)))
        frame = frame_measure(morph, t, sums=sums)
        return float(
            sinkhorn_divergence(frame, particles, blur, reach, backend=morph.operations)  # type: ignore[arg-type]
        )

    return divergence


def _golden_section(objective: Callable[[float], float]) -> float:
    """Return the width with the least objective, if it has one valley."""
    low, high = np.log(NARROWEST), np.log(WIDEST)
    inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
    values = [objective(place) for place in inner]
    while high - low > np.log(EXACTNESS):
        if values[0] <= values[1]:
            high, inner[1], values[1] = inner[1], inner[0], values[0]
            inner[0] = high - GOLDEN * (high - low)
            values[0] = objective(inner[0])
        else:
            low, inner[0], values[0] = inner[0], inner[1], values[1]
            inner[1] = low + GOLDEN * (high - low)
            values[1] = objective(inner[1])
    return float(np.exp(inner[int(np.argmin(values))]))
