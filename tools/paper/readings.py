"""The meaning of the printed "epsilon = 0.05, rho = 0.3": Table 1 by each interpretation."""

import numpy as np

from paper import drawing
from paper.recognition import LAST_DIGIT, difference
from paper.report import html_table
from paper.setting import (
    BLUR,
    COLOR_WEIGHT,
    PUBLISHED_DISPLACEMENTS,
    Section,
    Setting,
    listed,
    reach_name,
)
from paper.table1 import REACHES, lifted, masked_displacement, recognized

#: Each turns a printed number into the blur or the reach of the cost |X - Y|^2 / 2. Without the
#: factor 1/2 every term of the problem is twice as large for the same plan, so that epsilon and rho
#: are halved here.
READINGS = {
    "blur and reach, cost ½d²": lambda printed: printed,
    "blur and reach, cost d²": lambda printed: printed / np.sqrt(2),
    "ε and ρ, cost ½d²": lambda printed: np.sqrt(printed),
    "ε and ρ, cost d²": lambda printed: np.sqrt(printed / 2),
}
#: Lines of the picture.
STYLES = (
    ("o-", drawing.BLUE), ("s--", drawing.GREEN), ("^-", drawing.RED), ("v--", drawing.ORANGE),
)  # fmt: skip


def readings(setting: Setting) -> list[Section]:
    """Make Table 1 by GeomLoss's schedule for every reading of the printed parameters."""
    source, target = lifted(setting)
    keys = [(name, reach) for name in READINGS for reach in REACHES]
    found: dict[str, dict[float | None, tuple[float, float]]] = {name: {} for name in READINGS}
    for name, printed in setting.each("Readings", keys):
        read = READINGS[name]
        moved = masked_displacement(
            setting, source, target, float(read(BLUR)),
            None if printed is None else float(read(printed)),
        )  # fmt: skip
        found[name][printed] = moved.max, moved.mean
    _draw(setting, found)
    header = ["printed ρ"]
    header += [f"{column} px ({name})" for name in READINGS for column in ("max", "mean")]
    groups = [("", 1), *((name, 2) for name in READINGS)]
    if setting.published:
        header += ["max px (published)", "mean px (published)"]
        groups.append(("published", 2))
    rows = []
    for reach in REACHES:
        row = [reach_name(reach)]
        for name in READINGS:
            row += found[name][reach]
        row += PUBLISHED_DISPLACEMENTS[reach] if setting.published else []
        rows.append(row)
    cells = [[row[0], *(f"{value:.2f}" for value in row[1:])] for row in rows]
    return [
        Section(
            "readings",
            "Section 4: what the printed ε and ρ stand for",
            f"The paper prints ε = {BLUR:g} and a list of ρ, and a cost without the factor ½. "
            "Shown is Table 1 for each way to read them: as GeomLoss's blur and reach (ε = blur², "
            "ρ = reach²) or as ε and ρ themselves, with the cost ½d² of GeomLoss or with d² as "
            "printed (d is the distance of lifted points).",
            f"λ {COLOR_WEIGHT:g}, {setting.size} × {setting.size} pixels and GeomLoss's schedule "
            "as for Table 1. A cost d² is that of ½d² with half of ε and of ρ.",
            _says(setting, found),
            header,
            rows,
            html_table([name.split(" (")[0] for name in header], cells, groups),
        )
    ]


def _says(setting: Setting, found: dict[str, dict[float | None, tuple[float, float]]]) -> str:
    if recognized(setting).same:
        fitting = [name for name in READINGS if difference(found[name])[0] <= LAST_DIGIT]
        rest = [
            f"{difference(found[name])[0]:.2f} px by {name}"
            for name in READINGS
            if name not in fitting
        ]
        return (
            f"The published Table 1 comes out to its last digit by {listed(fitting)}; it is missed "
            f"by up to {listed(rest)}."
        )
    last = REACHES[-1]
    means = [f"{found[name][last][1]:.2f} px by {name}" for name in READINGS]
    return (
        f"The published table ends with {PUBLISHED_DISPLACEMENTS[last][1]:.2f} px at ρ = {last:g}. "
        f"The mean displacement there is {listed(means)}. Which cost it is, Table 1 of the "
        "authors' pair decides."
    )


def _draw(setting: Setting, found: dict[str, dict[float | None, tuple[float, float]]]) -> None:
    figure, panels = drawing.panels(1, 2, height=3.1)
    for axes, index, title in zip(panels[0], (0, 1), ("largest", "mean"), strict=True):
        for (name, values), (style, color) in zip(found.items(), STYLES, strict=True):
            heights = [values[reach][index] for reach in REACHES[::-1]]
            axes.plot(heights, style, color=color, label=name)
        if setting.published:
            heights = [PUBLISHED_DISPLACEMENTS[reach][index] for reach in REACHES[::-1]]
            label = recognized(setting).published
            axes.plot(heights, "x:", color=drawing.GRAY, label=label, zorder=5)
        axes.set_xticks(range(len(REACHES)), [reach_name(reach) for reach in REACHES[::-1]])
        axes.set(xlabel="printed ρ", title=f"{title} displacement")
        axes.set_ylim(bottom=0)
    panels[0][0].set_ylabel("pixels")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    drawing.save(figure, setting.folder / "readings.png")
