"""The transport between two images as one picture; needs matplotlib."""

import importlib
from os import PathLike
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.files import atomic_path, check_file_place
from clmorph._shared.printable import percent, reason_of, size_text, time_text
from clmorph.analysis.drawing import (
    ARROWS,
    BLUE,
    GRAY,
    INK,
    RED,
    SKY,
    STYLE,
    draw_field,
    ordinal,
    pale,
    show,
    step_of,
)
from clmorph.analysis.report import Inspection
from clmorph.errors import OutputError
from clmorph.measures.measure import Measure
from clmorph.transport.displacement import Displacement

#: Endings of pictures that can be written.
ENDINGS = (".png", ".svg", ".pdf")
#: The two grays behind transparent pixels.
CHECKS = 0.80, 0.92
#: By how much pictures are paled where shares of mass are drawn over them.
MASS_PALE = 0.6
#: Inches of the figure, and its dots an inch.
SIZE, DPI = (14.0, 8.0), 130
#: Arrows along a side, at least; how long they may be on average, in distances of them.
FEWEST, LONGEST = 14, 2.0
#: Bins of the histogram.
BINS = 40


def check_plotting(path: str | PathLike[str] | None = None) -> None:
    """Check that a picture can be drawn, and written there, before the work for it begins.

    Parameters
    ----------
    path : path, optional
        Ending in .png, .svg or .pdf.

    Raises
    ------
    OutputError
        If matplotlib is missing, the ending is another, or nothing can be written there.
    """
    try:
        importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise OutputError(
            f'a picture needs matplotlib ({reason_of(error)}): pip install "clmorph[plot]"'
        ) from None
    if path is None:
        return
    place = check_file_place(path)
    if place.suffix.lower() not in ENDINGS:
        raise OutputError(
            f"{path}: unknown ending {place.suffix!r}; expected one of {', '.join(ENDINGS)}"
        )


def draw_inspection(inspection: Inspection, path: str | PathLike[str]) -> None:
    """Draw what a transport does.

    Both images; where each source pixel goes on average, as arrows; mass destroyed and created;
    how far mass travels; how the solver came near the solution; the main numbers.

    Parameters
    ----------
    inspection : Inspection
    path : path
        Ending in .png, .svg or .pdf; replaced whole or not at all.

    Raises
    ------
    OutputError
        If matplotlib is missing or it cannot be written there.
    """
    check_plotting(path)
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(cast(Any, STYLE)):
        figure = Figure(figsize=SIZE)
        _lay_out(figure, inspection)
        with atomic_path(path) as place:
            dates = {".png": "Software", ".svg": "Date", ".pdf": "CreationDate"}
            ending = place.suffix.lower()
            # Without the day it was made the same numbers give the same file.
            figure.savefig(place, dpi=DPI, format=ending[1:], metadata={dates[ending]: None})


def _lay_out(figure: Any, found: Inspection) -> None:
    """Place all panels: what leaves on the left, what arrives on the right, motion between."""
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
    for place, picture, title in ((0, source, "Source"), (2, target, "Target")):
        axes = figure.add_subplot(grid[0, place])
        axes.set_title(title)
        show(axes, picture)
        _frame(axes, picture.shape)
    axes = figure.add_subplot(grid[0, 1])
    count = _arrow_count(found)
    axes.set_title(f"Displacement of every {ordinal(step_of(found.source.shape, count))} pixel")
    arrows = draw_field(axes, source, moved, moved.max, count=count)
    axes.set_xlim(-0.5, w - 0.5)
    axes.set_ylim(h - 0.5, -0.5)
    _frame(axes, found.source.shape)
    _bar(figure, axes, arrows, "pixels")
    shares = _shares(found.source, moved.destroyed), _shares(found.target, moved.created)
    largest = max(0.01, *(float(share.max()) for share in shares))  # one scale for both
    for place, picture, share, name, total, colors in (
        (0, source, shares[0], "Destroyed", found.destroyed, "Reds"),
        (2, target, shares[1], "Created", found.created, "Greens"),
    ):
        axes = figure.add_subplot(grid[1, place])
        axes.set_title(f"{name}: {percent(total)} of the mass")
        _draw_mass(figure, axes, picture, share, largest, colors)
    # Room for the numbers along their axes.
    middle = grid[1, 1].subgridspec(2, 2, width_ratios=(0.11, 1), hspace=0.7, wspace=0)
    _draw_lengths(figure.add_subplot(middle[0, 1]), moved)
    _draw_residuals(figure.add_subplot(middle[1, 1]), found)
    _write_numbers(figure.add_subplot(grid[:, 3]), found)


def _arrow_count(found: Inspection) -> int:
    """Return how many arrows stand along a side: fewer where they are long, or they tangle."""
    length = max(found.displacement.mass_weighted_mean, 1e-9)
    return int(np.clip(LONGEST * max(found.source.shape) / length, FEWEST, ARROWS))


def _picture(measure: Measure) -> NDArray[np.float64]:
    """Return the image of a measure; a chessboard where it is transparent."""
    height, width = measure.shape
    image = measure.colors.reshape(height, width, 3)
    if measure.alpha is None:
        return image
    alpha = measure.alpha.reshape(height, width, 1)
    side = max(1, round(max(height, width) / 24))
    y, x = np.mgrid[:height, :width] // side
    return np.asarray(image * alpha + np.choose((x + y) % 2, CHECKS)[..., None] * (1 - alpha))


def _frame(axes: Any, shape: tuple[int, ...]) -> None:
    """Draw a thin line around a picture, so that white ones have an edge."""
    from matplotlib.patches import Rectangle

    size = shape[1], shape[0]
    axes.add_patch(Rectangle((-0.5, -0.5), *size, fill=False, edgecolor="#bbbbbb", linewidth=0.8))


def _bar(figure: Any, axes: Any, drawn: Any, label: str, **options: Any) -> None:
    """Add a slim color bar under a picture, as wide as it is."""
    place = axes.inset_axes((0.0, -0.07, 1.0, 0.03))
    bar = figure.colorbar(drawn, cax=place, orientation="horizontal", **options)
    bar.set_label(label, labelpad=1, fontsize=8)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7.5, length=2)


def _shares(measure: Measure, mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return which share of each pixel's own mass this is; 0 where there is none."""
    own = measure.weights.reshape(measure.shape)
    return np.divide(mass, own, out=np.zeros_like(mass), where=own > 0)


def _draw_mass(
    figure: Any,
    axes: Any,
    picture: NDArray[np.float64],
    share: NDArray[np.float64],
    largest: float,
    colors: str,
) -> None:
    """Draw which share of each pixel's mass dies or is born, on the picture in pale gray."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import PercentFormatter

    shades = ScalarMappable(Normalize(0, largest), colormaps[colors])
    gray = pale(picture.mean(axis=2), MASS_PALE)[..., None]
    # As ink on a photograph: the color stays what the bar says, darker where the picture is.
    show(axes, gray * shades.to_rgba(share)[..., :3])
    _frame(axes, share.shape)
    _bar(figure, axes, shades, "share of a pixel's mass", format=PercentFormatter(1.0, symbol=" %"))


def _draw_lengths(axes: Any, moved: Displacement) -> None:
    """Draw how much mass travels how far."""
    mean = moved.mass_weighted_mean
    axes.set_title(f"How far mass travels: {mean:.3g} pixels on average")
    mass = np.where(moved.moves, moved.source_mass, 0.0).ravel()
    total = mass.sum()
    longest = max(moved.max, 1e-3)
    weights = 100 * mass / total if total > 0 else mass
    axes.hist(
        moved.length.ravel(), bins=np.linspace(0, longest, BINS + 1), weights=weights, color=SKY
    )
    axes.axvline(mean, color=RED)
    axes.set_xlabel("pixels", labelpad=1)
    axes.set_ylabel("% of mass")
    axes.set_xlim(0, longest)


def _draw_residuals(axes: Any, found: Inspection) -> None:
    """Draw the residual over the iterations."""
    axes.set_title("Residual of the solver")
    residuals = np.maximum(found.potentials.residuals, 1e-16)
    axes.semilogy(np.arange(1, len(residuals) + 1), residuals, color=BLUE, marker=".")
    axes.semilogy([len(residuals)], [max(found.potentials.residual, 1e-16)], "o", color=RED)
    axes.set_xlabel("iteration", labelpad=1)
    axes.set_ylabel("in ε")


def _write_numbers(axes: Any, found: Inspection) -> None:
    """Write the main numbers in a column."""
    axes.set_axis_off()
    moved, potentials, memory = found.displacement, found.potentials, found.memory
    groups: list[tuple[str, list[tuple[str, str]]]] = [
        (
            "Mass",
            [
                ("transported", percent(found.transported)),
                ("destroyed", percent(found.destroyed)),
                ("created", percent(found.created)),
            ],
        ),
        (
            "Displacement, pixels",
            [
                ("mean by mass", f"{moved.mass_weighted_mean:.4g}"),
                ("mean of pixels", f"{moved.mean:.4g}"),
                ("largest", f"{moved.max:.4g}"),
            ],
        ),
        ("Divergence", _divergence_rows(found)),
        (
            "Solver",
            [
                ("ended", potentials.status.replace("_", " ")),
                ("iterations", f"{potentials.n_iter}"),
                ("residual", f"{potentials.residual:.1e} ε"),
                ("optimal value", f"{potentials.dual:.5g}"),
                ("gap", f"{potentials.gap:.2g}")
                if potentials.reach is not None
                else ("marginals off by", f"{potentials.marginal_error:.2g}"),
            ],
        ),
        (
            "A morph by it",
            [
                ("pairs", f"{found.pairs:,}".replace(",", "\u202f")),
                ("their size", size_text(found.pair_bytes)),
                ("particles' size", size_text(found.particle_bytes)),
                ("memory" if memory.shared else "memory, host", size_text(memory.ram)),
                *([] if memory.shared else [("memory, device", size_text(memory.device))]),
            ],
        ),
        (
            "Time",
            [
                ("transport", time_text(found.seconds.transport)),
                ("plan", ("" if found.plan else "about ") + time_text(found.seconds.plan)),
                (f"{found.n_frames} frames", "about " + time_text(found.seconds.frames)),
            ],
        ),
    ]
    lines = sum(len(rows) + 1.9 for _, rows in groups)
    step, y = 1.0 / lines, 1.0
    for title, rows in groups:
        axes.text(0.06, y, title, weight="bold", color=INK, va="top", fontsize=9.5)
        y -= 0.35 * step
        axes.plot([0.06, 1], [y - 0.62 * step] * 2, color="#cccccc", linewidth=0.8, clip_on=False)
        for label, text in rows:
            y -= step
            axes.text(0.06, y, label, color=GRAY, va="top")
            axes.text(1.0, y, text, color=INK, va="top", ha="right")
        y -= 1.55 * step
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.figure.text(
        0.985, 0.018, _short(found.device), fontsize=7.5, color=GRAY, ha="right", va="bottom"
    )


def _divergence_rows(found: Inspection) -> list[tuple[str, str]]:
    if found.divergence is None:
        return [("none:", ""), (found.no_divergence, "")]
    low, high = found.divergence.interval
    return [
        ("value", f"{found.divergence.value:.5g}"),
        ("certainly from", f"{low:.5g}"),
        ("to", f"{high:.5g}"),
    ]


def _short(text: str, most: int = 80) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
