"""Draw the transport between two images as one picture, with matplotlib."""

import importlib
import logging
from io import BytesIO
from os import PathLike
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from clmorph._shared.files import atomic_path, check_named_place
from clmorph._shared.printable import percent, reason_of, size_text, time_text
from clmorph._shared.typing import Array
from clmorph.analysis.report import Marks, Report
from clmorph.errors import OutputError
from clmorph.measures.measure import Measure
from clmorph.transport.displacement import Displacement

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
#: Endings of file names for the formats of pictures.
ENDINGS = (".png", ".svg", ".pdf")
#: The two grays behind transparent pixels.
CHECKS = 0.80, 0.92
#: Size of the figure in inches, and its resolution in dots per inch.
SIZE, DPI = (14.0, 8.0), 130
#: The least number of arrows along a side, and the limit of their mean length as a multiple of
#: their spacing.
FEWEST, LONGEST = 14, 2.0
#: The share of white that is mixed into pictures under shares of mass.
MASS_PALE = 0.6
#: Largest number of landmarks that have numbers.
MOST_NUMBERED = 12
#: Number of bins of the histogram.
BINS = 40


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
    step = step_of(found.source.shape, count)
    ordinal = {1: "single", 2: "second", 3: "third"}.get(step, f"{step}th")
    axes.set_title(f"Displacement of every {ordinal} pixel")
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


def _picture(measure: Measure) -> Array:
    """Return the image of a measure, with a chessboard behind transparent pixels."""
    height, width = measure.shape
    image = measure.colors.reshape(height, width, 3)
    if measure.alpha is None:
        return image
    alpha = measure.alpha.reshape(height, width, 1)
    side = max(1, round(max(height, width) / 24))
    y, x = np.mgrid[:height, :width] // side
    return np.asarray(image * alpha + np.choose((x + y) % 2, CHECKS)[..., None] * (1 - alpha))


def show(axes: Any, image: ArrayLike) -> Any:
    """Draw an image with sharp pixels of equal size, without axes."""
    pixels = np.clip(np.asarray(image, float), 0, 1)
    height, width = pixels.shape[:2]
    factor = max(1, ENLARGED // max(height, width))
    axes.set_axis_off()
    return axes.imshow(
        pixels.repeat(factor, axis=0).repeat(factor, axis=1),
        extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="hanning",
    )  # fmt: skip


def pale(image: ArrayLike, share: float = PALE) -> Array:
    """Return an image mixed with white, so that a drawing over it is visible."""
    return np.asarray(1 - (1 - share) * (1 - np.asarray(image, float)))


def step_of(shape: tuple[int, ...], count: int = ARROWS) -> int:
    """Return the spacing of arrows in pixels at which at most `count` stand along a side."""
    return max(1, -(-max(shape[:2]) // count))


def draw_field(
    axes: Any, image: ArrayLike, moved: Displacement, longest: float, *, count: int = ARROWS
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
        headaxislength=3.6, minlength=0.5, width=0.0045,
    )  # fmt: skip


def outline(axes: Any, shape: tuple[int, ...]) -> None:
    """Draw a thin line around a picture, so that white pictures have an edge."""
    from matplotlib.patches import Rectangle

    size = shape[1], shape[0]
    axes.add_patch(Rectangle((-0.5, -0.5), *size, fill=False, edgecolor="#bbbbbb", linewidth=0.8))


def draw_marks(axes: Any, marks: Marks, side: int, shape: tuple[int, ...]) -> None:
    """Draw the landmarks of one picture, which is shown with this shape; a few have numbers."""
    if not len(marks.pairs):
        return
    points = np.array(marks.pairs, float)[:, side]
    points = (points + 0.5) / marks.shapes[side][::-1] * (shape[1], shape[0]) - 0.5
    axes.plot(*points.T, "o", markersize=3, markerfacecolor=SKY, markeredgecolor="white",
              markeredgewidth=0.6)  # fmt: skip
    if len(points) <= MOST_NUMBERED:
        for number, point in enumerate(points):
            axes.annotate(str(number + 1), point, xytext=(3, 2), textcoords="offset points",
                          fontsize=7, color="white", clip_on=True)  # fmt: skip


def color_bar(figure: Any, axes: Any, drawn: Any, label: str, **options: Any) -> None:
    """Add a slim color bar under a picture, of the same width."""
    place = axes.inset_axes((0.0, -0.07, 1.0, 0.03))
    bar = figure.colorbar(drawn, cax=place, orientation="horizontal", **options)
    bar.set_label(label, labelpad=1, fontsize=8)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7.5, length=2)


def mass_shares(measure: Measure, mass: Array) -> Array:
    """Return `mass` as a share of each pixel's own mass; 0 where a pixel has none."""
    own = measure.weights.reshape(measure.shape)
    return np.divide(mass, own, out=np.zeros_like(mass), where=own > 0)


def draw_mass(
    figure: Any, axes: Any, picture: Array, share: Array, largest: float, colors: str
) -> None:
    """Draw the share of each pixel's mass that dies or is born, over the picture in pale gray."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import PercentFormatter

    shades = ScalarMappable(Normalize(0, largest), colormaps[colors])
    gray = pale(picture.mean(axis=2), MASS_PALE)[..., None]
    # Colors are multiplied like ink on a photograph: the hue stays that of the color bar, and dark
    # parts of the picture make it darker.
    show(axes, gray * shades.to_rgba(share)[..., :3])
    outline(axes, share.shape)
    color_bar(
        figure, axes, shades, "share of a pixel's mass", format=PercentFormatter(1.0, symbol=" %")
    )


def draw_lengths(axes: Any, moved: Displacement) -> None:
    """Draw the histogram of the distances that mass travels."""
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


def draw_residuals(axes: Any, found: Report) -> None:
    """Draw the residual over the iterations."""
    axes.set_title("Residual of the solver")
    residuals = np.maximum(found.potentials.residuals, 1e-16)
    axes.semilogy(np.arange(1, len(residuals) + 1), residuals, color=BLUE, marker=".")
    axes.semilogy([len(residuals)], [max(found.potentials.residual, 1e-16)], "o", color=RED)
    axes.set_xlabel("iteration", labelpad=1)
    axes.set_ylabel("in ε")


def write_numbers(axes: Any, found: Report) -> None:
    """Write the main numbers in a column."""
    axes.set_axis_off()
    moved, potentials, memory = found.displacement, found.potentials, found.memory
    groups: dict[str, list[tuple[str, str]]] = {
        "Mass": [
            ("transported", percent(found.transported)),
            ("destroyed", percent(found.destroyed)),
            ("created", percent(found.created)),
        ],
        "Displacement, pixels": [
            ("mean by mass", f"{moved.mass_weighted_mean:.4g}"),
            ("mean of pixels", f"{moved.mean:.4g}"),
            ("largest", f"{moved.max:.4g}"),
        ],
        "Divergence": _divergence_rows(found),
        "Solver": [
            ("ended", potentials.status.replace("_", " ")),
            ("iterations", f"{potentials.n_iter}"),
            ("residual", f"{potentials.residual:.1e} ε"),
            ("optimal value", f"{potentials.dual:.5g}"),
            ("gap", f"{potentials.gap:.2g}")
            if potentials.reach is not None
            else ("marginals off by", f"{potentials.marginal_error:.2g}"),
        ],
        "A morph by it": [
            ("pairs", f"{found.pairs:,}".replace(",", "\u202f")),
            ("their size", size_text(found.pair_bytes)),
            ("particles' size", size_text(found.particle_bytes)),
            ("memory" if memory.shared else "memory, host", size_text(memory.ram)),
            *([] if memory.shared else [("memory, device", size_text(memory.device))]),
        ],
        "Time": [
            ("transport", time_text(found.seconds.transport)),
            ("plan", ("" if found.plan else "about ") + time_text(found.seconds.plan)),
            (f"{found.n_frames} frames", "about " + time_text(found.seconds.frames)),
        ],
    }
    lines = sum(len(rows) + 1.9 for rows in groups.values())
    step, y = 1.0 / lines, 1.0
    for title, rows in groups.items():
        axes.text(0.06, y, title, weight="bold", color=INK, va="top", fontsize=9.5)
        y -= 0.35 * step
        axes.plot([0.06, 1], [y - 0.62 * step] * 2, color="#cccccc", linewidth=0.8, clip_on=False)
        for label, text in rows:
            y -= step
            axes.text(0.06, y, label, color=GRAY, va="top")
            axes.text(1.0, y, text, color=INK, va="top", ha="right")
        y -= 1.55 * step
    axes.set(xlim=(0, 1), ylim=(0, 1))
    device = found.device if len(found.device) <= 80 else found.device[:79] + "…"
    axes.figure.text(0.985, 0.018, device, fontsize=7.5, color=GRAY, ha="right", va="bottom")


def _divergence_rows(found: Report) -> list[tuple[str, str]]:
    if found.divergence is None:
        return [("none:", ""), (found.no_divergence, "")]
    low, high = found.divergence.interval
    return [
        ("value", f"{found.divergence.value:.5g}"),
        ("certainly from", f"{low:.5g}"),
        ("to", f"{high:.5g}"),
    ]
