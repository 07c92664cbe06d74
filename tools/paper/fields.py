"""Figures 2 and 6: the displacement of pixels as arrows, and the mass destroyed and created."""

from typing import Any

import numpy as np

import clmorph
from clmorph.analysis.drawing import draw_field, ordinal, step_of
from clmorph.transport.displacement import Displacement
from paper import drawing
from paper.setting import (
    AS_PAPER,
    BLUR,
    COLOR_WEIGHT,
    REACH,
    TOL,
    Section,
    Setting,
    listed,
    reach_name,
)
from paper.table1 import MASK, REACHES, entries

#: Arrows along the longer side: in the large figure, and in each of the small ones.
MANY, FEW = 24, 16
#: Width of the small ones, as a share of the axes'.
FEW_WIDTH = 0.0065
#: The reaches at which creation and destruction are drawn: the paper's, and a middle one.
MIDDLE = (REACH, 0.1)
STAGE = "Displacement"


def figures_2_and_6(setting: Setting) -> list[Section]:
    """Draw the fields of Table 1's converged plans."""
    image = setting.pair.as_published(setting.size)[0]
    found = {reach: entries(setting)["certified", reach].masked for reach in REACHES}
    figure, ((axes,),) = drawing.panels(1, 1, height=5.0)
    arrows = draw_field(axes, image, found[REACH], found[REACH].max, count=MANY)
    figure.colorbar(arrows, ax=axes, label="displacement, pixels", shrink=0.8)
    drawing.save(figure, setting.folder / "figure-2.png")

    longest = max(field.max for field in found.values())
    figure, grid = drawing.panels(2, 3, height=4.2)
    for axes, reach in setting.each(STAGE, list(zip(grid.ravel(), REACHES, strict=True))):
        arrows = draw_field(axes, image, found[reach], longest, count=FEW, width=FEW_WIDTH)
        name = reach_name(reach)
        axes.set_title("balanced" if reach is None else f"reach {name}")
    bar = figure.colorbar(arrows, ax=grid, label="displacement, pixels", shrink=0.8, pad=0.02)
    bar.ax.tick_params(labelsize=8)
    drawing.save(figure, setting.folder / "figure-6.png")

    parameters = (
        f"λ {COLOR_WEIGHT:g}, blur {BLUR:g}, {setting.size} × {setting.size} pixels as for "
        f"Table 1, converged. Arrows are at true length, from every "
        f"{{}} pixel on; rows of at most {MASK:g} of the mass have none."
    )
    own = found[REACH]
    lengths = own.length.ravel()
    names = ["balanced" if reach is None else f"at reach {reach:g}" for reach in REACHES]
    return [
        Section(
            "figure-2",
            "Figure 2: displacement field",
            "Where each source pixel goes on average, T(x) − x, drawn over the source. The field "
            "does not depend on how particles are drawn; kernels only fill what it tears apart.",
            f"Reach {REACH:g}, " + parameters.format(ordinal(step_of(image.shape, MANY))),
            f"Half of the pixels move by more than {np.median(lengths):.2f} px, the farthest by "
            f"{own.max:.2f} px; the field widens areas by up to {_expansion(own):.1f} times, which "
            "is where frames tear.",
            ["row", "column", "dx px", "dy px", "mass"],
            _field_rows(own),
        ),
        Section(
            "figure-6",
            "Figure 6: displacement fields by reach",
            "The same field for every reach of Table 1, in one scale.",
            parameters.format(ordinal(step_of(image.shape, FEW))),
            "Pixels that move by more than one: "
            + listed(
                [
                    f"{100 * np.mean(found[reach].length > 1):.0f} % {name}"
                    for reach, name in zip(REACHES, names, strict=True)
                ]
            )
            + ".",
            ["reach", "row", "column", "dx px", "dy px", "mass"],
            [[reach_name(reach), *row] for reach in REACHES for row in _field_rows(found[reach])],
        ),
    ]


def mass_images(setting: Setting) -> list[Section]:
    """Draw what leaves no trace and what appears from nothing."""
    images = setting.pair.fitted(setting.size)
    source, target = (
        clmorph.lift(image, COLOR_WEIGHT, extent=AS_PAPER["extent"]) for image in images
    )
    figure, grid = drawing.panels(len(MIDDLE), 4, height=1.6 * len(MIDDLE))
    rows: list[list[Any]] = []
    told = []
    for panels, reach in setting.each("Mass", list(zip(grid, MIDDLE, strict=True))):
        potentials = clmorph.sinkhorn(source, target, BLUR, reach, TOL, backend=setting.operations)
        plan = clmorph.transport_plan(source, target, potentials, backend=setting.operations)
        moved = clmorph.displacement_statistics(source, target, plan)
        shares = {}
        for name, mass, measure in (
            ("destroyed", moved.destroyed, source), ("created", moved.created, target),
        ):  # fmt: skip
            shares[name] = mass / measure.weights.reshape(measure.shape)
            rows += [
                [reach, name, *map(int, place), float(share)]
                for place, share in np.ndenumerate(shares[name])
            ]
        pictures = (
            ("source", images[0]), ("destroyed", shares["destroyed"]),
            ("created", shares["created"]), ("target", images[1]),
        )  # fmt: skip
        for axes, (title, picture) in zip(panels, pictures, strict=True):
            options = {"cmap": "magma", "vmin": 0, "vmax": 1} if picture.ndim == 2 else {}
            drawn = drawing.show(axes, picture, **options)
            if picture.ndim == 2:
                shading = drawn
            axes.set_title(f"reach {reach:g}: {title}" if title == "source" else title)
        destroyed, created = float(moved.destroyed.sum()), float(moved.created.sum())
        told.append(
            f"at reach {reach:g}, {100 * destroyed:.1f} % of the source dies and "
            f"{100 * created:.1f} % of the target is born"
        )
    bar = figure.colorbar(shading, ax=grid, shrink=0.75, pad=0.02, ticks=[0, 0.5, 1])
    bar.ax.set_yticklabels(["0", "50 %", "100 %"])
    bar.set_label("share of the pixel's mass")
    drawing.save(figure, setting.folder / "mass.png")
    says = listed(told)
    return [
        Section(
            "mass",
            "Section 4.2: mass destroyed and created",
            "What unbalanced transport does not move: the share of each source pixel that dies "
            "where it is, and of each target pixel that is born there.",
            f"λ {COLOR_WEIGHT:g}, blur {BLUR:g}, {images[0].shape[1]} × {images[0].shape[0]} to "
            f"{images[1].shape[1]} × {images[1].shape[0]} pixels, converged.",
            says[0].upper() + says[1:] + ".",
            ["reach", "what", "row", "column", "share"],
            rows,
        )
    ]


def _expansion(moved: Displacement) -> float:
    """Return the largest |det| of x + T(x) - x, by differences of neighbors."""
    (ydy, xdy), (ydx, xdx) = (np.gradient(moved.field[..., axis]) for axis in (1, 0))
    return float(np.abs((1 + xdx) * (1 + ydy) - ydx * xdy).max())


def _field_rows(moved: Displacement) -> list[list[Any]]:
    return [
        [row, column, *map(float, moved.field[row, column]), float(moved.source_mass[row, column])]
        for row, column in np.ndindex(*moved.length.shape)
    ]
