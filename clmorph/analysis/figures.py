"""Draw the transport between two images as one picture, with matplotlib."""

import importlib
import logging
from io import BytesIO
from os import PathLike
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import atomic_path, check_named_place
from clmorph._shared.printable import percent, reason_of
from clmorph.analysis.drawing import ARROWS, GRAY, INK, STYLE, draw_field, ordinal, show, step_of
from clmorph.analysis.panels import (
    color_bar,
    draw_lengths,
    draw_marks,
    draw_mass,
    draw_residuals,
    mass_shares,
    outline,
    write_numbers,
)
from clmorph.analysis.report import Report
from clmorph.errors import OutputError
from clmorph.measures.measure import Measure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Endings of file names for the formats of pictures.
ENDINGS = (".png", ".svg", ".pdf")
#: The two grays behind transparent pixels.
CHECKS = 0.80, 0.92
#: Size of the figure in inches, and its resolution in dots per inch.
SIZE, DPI = (14.0, 8.0), 130
#: The least number of arrows along a side, and the limit of their mean length as a multiple of
#: their spacing.
FEWEST, LONGEST = 14, 2.0


def check_plotting(path: str | PathLike[str] | None = None) -> None:
    """Check, before the computation, that a .png, .svg or .pdf can be drawn and written."""
    # The first import on a machine builds a cache of fonts, and on a slow one says so on stderr.
    log = logging.getLogger("matplotlib.font_manager")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise OutputError(
            f'a picture needs matplotlib ({reason_of(error)}): pip install "clmorph[plot]"'
        ) from None
    finally:
        log.setLevel(level)
    if path is not None:
        check_named_place(path, ENDINGS, "report.png", f"one of {', '.join(ENDINGS)}")


def draw_inspection(inspection: Report, path: str | PathLike[str]) -> None:
    """Draw the figure of a transport to a path, whose old file is replaced atomically."""
    check_plotting(path)
    with atomic_path(path) as place:
        _write(inspection, place, place.suffix.lower())


def inspection_png(inspection: Report) -> bytes:
    """Return the figure of a transport as the bytes of a PNG file."""
    check_plotting()
    file = BytesIO()
    _write(inspection, file, ".png")
    return file.getvalue()


def plotted(inspection: Report) -> "Figure":
    """Return the figure of a transport as one of pyplot, which shows it."""
    check_plotting()
    import matplotlib
    import matplotlib.pyplot as plt

    with matplotlib.rc_context(cast(Any, STYLE)):
        figure = plt.figure(figsize=SIZE)
        _lay_out(figure, inspection)
    return figure


def has_plotting() -> bool:
    """Return whether matplotlib is installed."""
    try:
        check_plotting()
    except OutputError:
        return False
    return True


def _write(inspection: Report, file: Any, ending: str) -> None:
    """Draw the figure and write it to a path or a file that is open."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(cast(Any, STYLE)):
        figure = Figure(figsize=SIZE)
        _lay_out(figure, inspection)
        dates = {".png": "Software", ".svg": "Date", ".pdf": "CreationDate"}
        # The file has no date, so that the same numbers give the same file.
        figure.savefig(file, dpi=DPI, format=ending[1:], metadata={dates[ending]: None})


def _lay_out(figure: Any, found: Report) -> None:
    """Place all panels: the source on the left, the target on the right, motion between."""
    grid = figure.add_gridspec(
        2, 4, width_ratios=(1, 1, 1, 0.92), left=0.015, right=0.985, bottom=0.085, top=0.895,
        wspace=0.1, hspace=0.28,
    )  # fmt: skip
    (h, w), (height, width) = found.source.shape, found.target.shape
    figure.text(0.016, 0.952, "Transport alone", fontsize=15, weight="bold", color=INK)
    options = found.potentials
    reach = options.reach if isinstance(options.reach, tuple) else (options.reach,)
    reaches = " and ".join("balanced" if r is None else f"reach {r:.4g}" for r in reach)
    figure.text(
        0.162, 0.953,
        f"{w} × {h} into {width} × {height} pixels,  blur {options.blur:.4g},  {reaches},  "
        f"color weight {found.source.color_weight:g}",
        fontsize=10.5, color=GRAY,
    )  # fmt: skip
    moved = found.displacement
    source, target = _picture(found.source), _picture(found.target)
    for side, (picture, title) in enumerate(((source, "Source"), (target, "Target"))):
        axes = figure.add_subplot(grid[0, 2 * side])
        axes.set_title(title)
        show(axes, picture)
        outline(axes, picture.shape)
        draw_marks(axes, found.marks, side, picture.shape)
    axes = figure.add_subplot(grid[0, 1])
    length = max(moved.mass_weighted_mean, 1e-9)
    count = int(np.clip(LONGEST * max(h, w) / length, FEWEST, ARROWS))
    axes.set_title(f"Displacement of every {ordinal(step_of(found.source.shape, count))} pixel")
    arrows = draw_field(axes, source, moved, moved.max, count=count)
    axes.set_xlim(-0.5, w - 0.5)
    axes.set_ylim(h - 0.5, -0.5)
    outline(axes, found.source.shape)
    color_bar(figure, axes, arrows, "pixels")
    shares = mass_shares(found.source, moved.destroyed), mass_shares(found.target, moved.created)
    largest = max(0.01, *(float(share.max()) for share in shares))  # one scale for both
    for place, picture, share, name, total, colors in (
        (0, source, shares[0], "Destroyed", found.destroyed, "Reds"),
        (2, target, shares[1], "Created", found.created, "Greens"),
    ):
        axes = figure.add_subplot(grid[1, place])
        axes.set_title(f"{name}: {percent(total)} of the mass")
        draw_mass(figure, axes, picture, share, largest, colors)
    # The margins leave space for the numbers along the axes.
    middle = grid[1, 1].subgridspec(2, 2, width_ratios=(0.11, 1), hspace=0.7, wspace=0)
    draw_lengths(figure.add_subplot(middle[0, 1]), moved)
    draw_residuals(figure.add_subplot(middle[1, 1]), found)
    write_numbers(figure.add_subplot(grid[:, 3]), found)


def _picture(measure: Measure) -> NDArray[np.float64]:
    """Return the image of a measure, with a chessboard behind transparent pixels."""
    height, width = measure.shape
    image = measure.colors.reshape(height, width, 3)
    if measure.alpha is None:
        return image
    alpha = measure.alpha.reshape(height, width, 1)
    side = max(1, round(max(height, width) / 24))
    y, x = np.mgrid[:height, :width] // side
    return np.asarray(image * alpha + np.choose((x + y) % 2, CHECKS)[..., None] * (1 - alpha))
