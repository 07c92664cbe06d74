"""Pictures of the mass that a morph destroys and creates, to be laid over its frames."""

import base64
import io
from typing import Any

import numpy as np
from PIL import Image

from clmorph._shared.typing import Array
from clmorph.frames.sequence import FrameSequence

#: Colors of destroyed and of created mass, and the opacity where all mass is such.
DESTROYED, CREATED, OPACITY = (255, 80, 0), (0, 130, 255), 0.85
#: Longest side of these pictures, pixels.
LONGEST = 256
#: Shares below this are rounding.
LEAST = 1e-3


def unmatched_shares(morph: FrameSequence) -> tuple[Array, Array]:
    """Return the shares in [0, 1] of each pixel's mass that is destroyed, and created.

    Destroyed is 1 - (pi 1)_i / a_i at each pixel (H, W) of the first picture, 0 without mass;
    created (H', W') is the same for the columns of the plan and the second picture.
    """
    found = []
    rho = morph.potentials.rho
    sides = zip(
        (morph.source, morph.target), morph.plan.marginals,
        rho if isinstance(rho, tuple) else (rho, rho), strict=True,
    )  # fmt: skip
    for measure, moved, penalty in sides:
        if np.isinf(penalty):  # differences are residuals
            found.append(np.zeros(measure.shape))
            continue
        share = 1.0 - np.divide(
            moved, measure.weights, out=np.ones(len(measure)), where=measure.weights > 0
        )
        found.append(np.where(share > LEAST, np.clip(share, 0.0, 1.0), 0.0).reshape(measure.shape))
    return found[0], found[1]


def tinted(share: Array, color: tuple[int, int, int]) -> str:
    """Return a picture in one color, whose opacity is the share, as the address of its data."""
    pixels: Any = np.empty((*share.shape, 4), np.uint8)
    pixels[..., :3] = color
    pixels[..., 3] = np.rint(255 * OPACITY * share)
    image = Image.fromarray(pixels)
    if max(image.size) > LONGEST:
        image.thumbnail((LONGEST, LONGEST))
    file = io.BytesIO()
    image.save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
