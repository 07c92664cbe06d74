"""The style of figures and the parts that several figures share, drawn with matplotlib."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clmorph._shared.typing import Array
from clmorph.transport.displacement import Displacement

#: Colors of Okabe and Ito, which color-blind readers can distinguish; and two grays.
BLUE, SKY, RED = "#0072B2", "#56B4E9", "#D55E00"
GRAY, INK = "#666666", "#222222"
#: Settings of matplotlib for all figures.
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
    "lines.linewidth": 1.5,
    "lines.markersize": 4,
    "svg.hashsalt": "clmorph",
}
#: Number of arrows along the longer side of a field.
ARROWS = 24
#: Side in pixels to which pictures are enlarged before they are drawn, as square blocks.
ENLARGED = 480
#: The share of white that is mixed into a picture under a drawing.
PALE = 0.62


def show(axes: Any, image: ArrayLike, **options: Any) -> Any:
    """Draw an image with sharp pixels of equal size, without axes."""
    pixels = np.clip(np.asarray(image, float), 0, 1)
    height, width = pixels.shape[:2]
    factor = max(1, ENLARGED // max(height, width))
    axes.set_axis_off()
    return axes.imshow(
        pixels.repeat(factor, axis=0).repeat(factor, axis=1),
        extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="hanning", **options,
    )  # fmt: skip


def pale(image: ArrayLike, share: float = PALE) -> Array:
    """Return an image mixed with white, so that a drawing over it is visible."""
    return np.asarray(1 - (1 - share) * (1 - np.asarray(image, float)))


def step_of(shape: tuple[int, ...], count: int = ARROWS) -> int:
    """Return the spacing of arrows in pixels at which at most `count` stand along a side."""
    return max(1, -(-max(shape[:2]) // count))


def draw_field(
    axes: Any,
    image: ArrayLike,
    moved: Displacement,
    longest: float,
    *,
    count: int = ARROWS,
    width: float = 0.0045,
) -> Any:
    """Draw displacement over a pale image as arrows of true length; return the artist."""
    show(axes, pale(image))
    step = step_of(moved.length.shape, count)
    # The grid of arrows is centered on the image.
    y, x = np.meshgrid(
        *(np.arange((side - 1) % step // 2, side, step) for side in moved.length.shape),
        indexing="ij",
    )
    # No mass leaves transparent pixels, so they have no arrow.
    some = moved.moves[y, x]
    y, x = y[some], x[some]
    field, length = moved.field[y, x], moved.length[y, x]
    return axes.quiver(
        x, y, field[..., 0], field[..., 1], length, cmap="plasma", clim=(0, max(longest, 1e-9)),
        angles="xy", scale_units="xy", scale=1, headwidth=3.5, headlength=4,
        headaxislength=3.6, minlength=0.5, width=width,
    )  # fmt: skip
