"""The style of figures, and parts that several figures share; drawn with matplotlib."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clmorph.transport.displacement import Displacement

#: Colors of Okabe and Ito, which color-blind readers can distinguish; and two grays.
BLUE, SKY, RED, GREEN, PURPLE, ORANGE = (
    "#0072B2", "#56B4E9", "#D55E00", "#009E73", "#AA4499", "#E69F00",
)  # fmt: skip
GRAY, INK = "#666666", "#222222"
#: How all figures look.
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
#: Arrows along the longer side of a field.
ARROWS = 24
#: Pixels to which pictures are enlarged, block by block, before they are drawn.
ENLARGED = 480
#: By how much a picture is paled where something is drawn over it.
PALE = 0.62


def enlarged(image: ArrayLike) -> NDArray[np.float64]:
    """Return an image of large square blocks, one for each pixel."""
    pixels = np.clip(np.asarray(image, float), 0, 1)
    factor = max(1, ENLARGED // max(pixels.shape[:2]))
    return pixels.repeat(factor, axis=0).repeat(factor, axis=1)


def show(axes: Any, image: ArrayLike, **options: Any) -> Any:
    """Draw an image with sharp pixels, of even size, and no axes around."""
    height, width = np.shape(image)[:2]
    axes.set_axis_off()
    return axes.imshow(
        enlarged(image), extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="hanning",
        **options,
    )  # fmt: skip


def pale(image: ArrayLike, share: float = PALE) -> NDArray[np.float64]:
    """Return an image nearer to white, so that what is drawn over it is seen."""
    return np.asarray(1 - (1 - share) * (1 - np.asarray(image, float)))


def step_of(shape: tuple[int, ...], count: int = ARROWS) -> int:
    """Return the distance of arrows, in pixels, if at most `count` stand along a side."""
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
    """Draw where pixels go as arrows of true length, colored by it, over a pale image.

    Parameters
    ----------
    axes : matplotlib axes
    image : (H, W, 3) array
    moved : Displacement
    longest : float
        Length, in pixels, that has the last color.
    count : int
        Arrows along the longer side, at most.
    width : float
        Of a shaft, as a share of the axes'.

    Returns
    -------
    The artist that a color bar needs.
    """
    show(axes, pale(image))
    step = step_of(moved.length.shape, count)
    # A grid in the middle of the image, not from its corner on.
    y, x = np.meshgrid(
        *(np.arange((side - 1) % step // 2, side, step) for side in moved.length.shape),
        indexing="ij",
    )
    # Nothing leaves transparent pixels: no arrow, not one without length.
    some = moved.moves[y, x]
    y, x = y[some], x[some]
    field, length = moved.field[y, x], moved.length[y, x]
    return axes.quiver(
        x, y, field[..., 0], field[..., 1], length, cmap="plasma", clim=(0, max(longest, 1e-9)),
        angles="xy", scale_units="xy", scale=1, headwidth=3.5, headlength=4,
        headaxislength=3.6, minlength=0.5, width=width,
    )  # fmt: skip


def ordinal(number: int) -> str:
    """Return an ordinal number in words."""
    return {1: "single", 2: "second", 3: "third"}.get(number, f"{number}th")
