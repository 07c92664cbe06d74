"""The style of figures: one font, one set of colors, a width that is readable on a phone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import ArrayLike

from clmorph.analysis.drawing import (
    BLUE,
    ENLARGED,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    STYLE,
    show,
)

matplotlib.use("Agg")
from matplotlib import pyplot

__all__ = [
    "BLUE", "ENLARGED", "GRAY", "GREEN", "ORANGE", "PURPLE", "RED", "SKY",
    "panels", "pyplot", "save", "show", "timeline",
]  # fmt: skip

#: Inches; dots an inch.
WIDTH, DPI = 6.2, 180
#: Inches of a timeline's labels, its gaps, and the line above it.
LABEL, GAP, HEAD = 1.25, 0.06, 0.3

pyplot.rcParams.update(STYLE)


def panels(rows: int, columns: int, height: float, **options: Any) -> tuple[Any, Any]:
    """Return a figure of the common width and its (rows, columns) axes."""
    return pyplot.subplots(
        rows, columns, figsize=(WIDTH, height), layout="constrained", squeeze=False, **options
    )


def save(figure: Any, path: Path) -> None:
    """Write a figure and forget it."""
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    pyplot.close(figure)


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
