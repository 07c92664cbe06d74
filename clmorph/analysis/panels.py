"""The panels of the figure of a transport: shares of mass, lengths, residuals, numbers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import percent, size_text, time_text
from clmorph.analysis.drawing import BLUE, GRAY, INK, RED, SKY, pale, show
from clmorph.analysis.report import Marks, Report
from clmorph.measures.measure import Measure
from clmorph.transport.displacement import Displacement

#: The share of white that is mixed into pictures under shares of mass.
MASS_PALE = 0.6
#: Largest number of landmarks that have numbers.
MOST_NUMBERED = 12
#: Number of bins of the histogram.
BINS = 40


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


def mass_shares(measure: Measure, mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `mass` as a share of each pixel's own mass; 0 where a pixel has none."""
    own = measure.weights.reshape(measure.shape)
    return np.divide(mass, own, out=np.zeros_like(mass), where=own > 0)


def draw_mass(
    figure: Any,
    axes: Any,
    picture: NDArray[np.float64],
    share: NDArray[np.float64],
    largest: float,
    colors: str,
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
