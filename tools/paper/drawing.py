"""How figures look: one font, one set of colors, a width that is readable on a phone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import ArrayLike

matplotlib.use("Agg")
from matplotlib import pyplot

#: Okabe and Ito's colors, told apart by everybody.
BLUE, SKY, RED, GREEN, PURPLE, ORANGE = (
    "#0072B2", "#56B4E9", "#D55E00", "#009E73", "#AA4499", "#E69F00",
)  # fmt: skip
GRAY = "#666666"
#: Inches; dots an inch.
WIDTH, DPI = 6.2, 180
#: Inches of a timeline's labels, its gaps, and the line above it.
LABEL, GAP, HEAD = 1.25, 0.06, 0.3
#: Pixels to which pictures are enlarged, block by block, before they are drawn.
ENLARGED = 480

pyplot.rcParams.update(
    {
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
    }
)


def panels(rows: int, columns: int, height: float, **options: Any) -> tuple[Any, Any]:
    """Return a figure of the common width and its (rows, columns) axes."""
    return pyplot.subplots(
        rows, columns, figsize=(WIDTH, height), layout="constrained", squeeze=False, **options
    )


def save(figure: Any, path: Path) -> None:
    """Write a figure and forget it."""
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    pyplot.close(figure)


def enlarged(image: ArrayLike) -> np.ndarray:
    """Return an image of large square blocks, one for each pixel."""
    image = np.clip(np.asarray(image, float), 0, 1)
    factor = max(1, ENLARGED // max(image.shape[:2]))
    return np.kron(image, np.ones((factor, factor, *[1] * (image.ndim - 2))))


def show(axes: Any, image: ArrayLike, **options: Any) -> Any:
    """Draw an image with sharp pixels, of even size, and no axes around."""
    height, width = np.shape(image)[:2]
    axes.set_axis_off()
    return axes.imshow(
        enlarged(image), extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="hanning",
        **options,
    )  # fmt: skip


def timeline(
    path: Path, rows: Sequence[tuple[str, Sequence[ArrayLike]]], times: Sequence[float]
) -> None:
    """Draw rows of frames, each with its label on the left, under their times."""
    cell = (WIDTH - LABEL) / len(times) - GAP
    tallest = max(np.shape(f)[0] / np.shape(f)[1] for _, frames in rows for f in frames)
    row_height = cell * min(tallest, 2.0) + GAP
    total = HEAD + len(rows) * row_height
    figure = pyplot.figure(figsize=(WIDTH, total))
    for column, t in enumerate(times):
        x = (LABEL + column * (cell + GAP) + cell / 2) / WIDTH
        figure.text(x, 1 - 0.55 * HEAD / total, f"t = {t:g}", ha="center", va="center")
    for row, (label, frames) in enumerate(rows):
        bottom = total - HEAD - (row + 1) * row_height + GAP
        middle = (bottom + (row_height - GAP) / 2) / total
        figure.text((LABEL - 0.1) / WIDTH, middle, label, ha="right", va="center", linespacing=1.35)
        for column, frame in enumerate(frames):
            left = LABEL + column * (cell + GAP)
            box = (left / WIDTH, bottom / total, cell / WIDTH, (row_height - GAP) / total)
            show(figure.add_axes(box), frame)
    save(figure, path)
